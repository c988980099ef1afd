"""Damaged and hostile files of every format: one line, no traceback, within bounds of time and memory."""

from __future__ import annotations

import io
import json
import signal
import tracemalloc
import warnings
import zipfile
from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from io_clips import small_clip

from kt3dmoseg import catalog
from kt3dmoseg.errors import KT3DMoSegError
from kt3dmoseg.files import SafeZip, ZipLimits
from kt3dmoseg.frames import check_frames
from kt3dmoseg.io import load, save
from kt3dmoseg.io.fields import clip_values
from kt3dmoseg.io.flow_files import FLOW_SUFFIXES, read_flow, write_flow
from kt3dmoseg.io.formats import FORMATS
from kt3dmoseg.io.images import decode_indices, read_frame
from kt3dmoseg.io.info import info
from kt3dmoseg.io.predictions import read_prediction

_MEMORY = 1 << 27
_SECONDS = 3  # of processor time, for one file
_ENDS = [b"\0", b"\xff", b"\x7f", b"9", b"-", b" "]
thorough = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@st.composite
def damage(draw: st.DrawFn, content: bytes) -> bytes:
    """Flip bytes, put large numbers where sizes may be, cut, repeat, append."""
    out = bytearray(content)
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, max(0, len(out) - 1)))
        match draw(st.sampled_from(["flip", "size", "cut", "insert", "append"])):
            case "flip" if out:
                out[at] = draw(st.integers(0, 255))
            case "size":
                out[at : at + 4] = draw(st.sampled_from(_ENDS)) * 4
            case "cut":
                del out[at : at + draw(st.integers(1, 64))]
            case "insert":
                out[at:at] = draw(st.binary(max_size=8))
            case _:
                out += draw(st.binary(max_size=32))
    return bytes(out)


def survives(read, path, content):
    """Read the damaged file within the bounds: it may well be intact still, else it is a single line."""
    path.write_bytes(content)
    tracemalloc.start()
    signal.setitimer(signal.ITIMER_PROF, _SECONDS)  # counts processor time only, then `too_long` raises
    try:
        read(path)
    except KT3DMoSegError as error:
        assert "\n" not in str(error)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < _MEMORY


class TooLongError(BaseException):
    """Not an Exception, so that no reader takes it for damage."""


@pytest.fixture(autouse=True)
def too_long():
    def stop(number, frame):
        raise TooLongError(f"more than {_SECONDS} s of processor time")

    before = signal.signal(signal.SIGPROF, stop)
    yield
    signal.signal(signal.SIGPROF, before)


@pytest.fixture(scope="module")
def originals(tmp_path_factory):
    folder = tmp_path_factory.mktemp("originals")
    for format in FORMATS:
        save(small_clip(), folder / f"clip{format.suffix}")
    field = np.random.default_rng(0).normal(size=(3, 4, 2)).astype(np.float32)
    for suffix in FLOW_SUFFIXES:
        write_flow(folder / f"flow{suffix}", field)
    cv2.imwrite(str(folder / "frame.png"), np.arange(48, dtype=np.uint8).reshape(6, 8))
    tracks = np.random.default_rng(0).random((1, 3, 4, 2))
    np.savez(folder / "cotracker.npz", pred_tracks=tracks, pred_visibility=np.ones((1, 3, 4), bool))
    video = np.zeros((3, 4, 5, 3), np.uint8)
    np.savez(folder / "tapvid.npz", points=tracks[0], occluded=np.zeros((3, 4)), video=video)
    ids = small_clip().dense.track_id
    np.savez(folder / "prediction.npz", track=ids, label=ids)
    (folder / "prediction.csv").write_text("track,label\n" + "".join(f"{t},1\n" for t in ids))
    return {path.name: path.read_bytes() for path in folder.iterdir()}


CLIPS = [f"clip{f.suffix}" for f in FORMATS] + ["cotracker.npz", "tapvid.npz"]


@pytest.mark.parametrize("name", CLIPS)
@given(data=st.data())
@thorough
def test_damaged_clips(name, originals, tmp_path, data):
    survives(load, tmp_path / name, data.draw(damage(originals[name])))


@pytest.mark.parametrize("suffix", FLOW_SUFFIXES)
@given(data=st.data())
@thorough
def test_damaged_flow(suffix, originals, tmp_path, data):
    survives(read_flow, tmp_path / f"flow{suffix}", data.draw(damage(originals[f"flow{suffix}"])))


@given(data=st.data())
@thorough
def test_damaged_frames(originals, tmp_path, data):
    content = data.draw(damage(originals["frame.png"]))
    survives(read_frame, tmp_path / "frame.png", content)
    survives(lambda path: decode_indices(path.read_bytes(), str(path)), tmp_path / "mask.png", content)


@pytest.mark.parametrize("name", ["prediction.csv", "prediction.npz"])
@given(data=st.data())
@thorough
def test_damaged_predictions(name, originals, tmp_path, data):
    content = data.draw(damage(originals[name]))
    survives(lambda path: read_prediction(path, small_clip()), tmp_path / name, content)


def listing(path):
    """Read a zip archive as the readers of submissions and downloads do."""
    with SafeZip(path, ZipLimits(1000, 1 << 24, 1 << 26), path.name) as archive:
        return {name: archive.read(name) for name in archive.sizes}


@st.composite
def archives(draw: st.DrawFn) -> bytes:
    """Zip archives of odd names, sizes and methods: bombs, duplicates, links, paths that lead out."""
    buffer = io.BytesIO()
    names = st.text(st.sampled_from("a./\\:.0é\n"), min_size=1, max_size=12)
    with warnings.catch_warnings(), zipfile.ZipFile(buffer, "w") as archive:
        warnings.simplefilter("ignore", UserWarning)  # a duplicate name
        for name in draw(st.lists(names, max_size=6)):
            info = zipfile.ZipInfo("placeholder")
            info.filename, info.external_attr = name, draw(st.sampled_from([0, 0o120777 << 16]))
            size = draw(st.sampled_from([0, 5, 1 << 16, 1 << 23]))
            method = draw(st.sampled_from([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2]))
            archive.writestr(
                info, bytes(min(size, 1 << 16) if method == zipfile.ZIP_STORED else size), method
            )
    return buffer.getvalue()


@given(data=st.data())
@thorough
def test_damaged_and_hostile_zips(tmp_path, data):
    content = data.draw(archives())
    survives(listing, tmp_path / "a.zip", data.draw(st.one_of(st.just(content), damage(content))))


@given(data=st.data())
@thorough
def test_damaged_catalogs(tmp_path, data):
    mark = '{ crc32 = "89abcdef", bytes = 294096, pixels = "' + "0" * 64 + '" }'
    text = f'[clips.A]\ndate = "2011_09_26"\ndrive = 5\ncamera = 0\nlength = 1\nframes = [\n {mark},\n]\n'
    pieces = ["[" * 99, "{a=" * 99, ".a" * 99, "9" * 400, '"""', "'", "\0", "\ud7ff", "nan", "\\u0000"]
    at, piece = data.draw(st.integers(0, len(text))), data.draw(st.sampled_from(pieces))
    content = data.draw(damage((text[:at] + piece + text[at:]).encode()))
    survives(catalog.parse, tmp_path / "mine.toml", content)


@given(data=st.data())
@thorough
def test_provenance_of_strangers(tmp_path, data):
    """What a clip's file says about itself is any JSON."""
    values = st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(max_size=5) | st.integers(-(10**400), 10**400),
        lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=9), inner, max_size=4),
        max_leaves=9,
    )
    keys = ("inputs", "fingerprint", "source", "frames", "kind", "sha256")
    stated = data.draw(st.dictionaries(st.sampled_from(keys), values, max_size=4))
    with np.load(io.BytesIO(data.draw(st.just(clip_npz())))) as arrays:
        changed = dict(arrays) | {"provenance": np.array(json.dumps(stated))}
    buffer = io.BytesIO()
    np.savez(buffer, **changed)

    def read(path):
        check_frames(load(path).provenance, info(path)[:4], [path])

    survives(read, tmp_path / "clip.npz", buffer.getvalue())


@cache
def clip_npz():
    buffer = io.BytesIO()
    clip = small_clip()
    values = {"name": clip.name, "xy": clip.dense.xy, "visible": clip.dense.visible} | clip_values(clip)
    np.savez(buffer, **values)
    return buffer.getvalue()


@given(content=st.binary(max_size=300), suffix=st.sampled_from([*CLIPS, "a.flo", "a.png", "a.npy"]))
@thorough
def test_anything_else(content, suffix, tmp_path):
    survives(info, tmp_path / suffix, content)
