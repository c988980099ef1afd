"""Damaged and hostile files of every format: one line, no traceback, within the bounds of `bounded`."""

from __future__ import annotations

import io
import json
import warnings
import zipfile
from functools import cache

import cv2
import numpy as np
import pytest
from bounds import bounded, survives
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from io_clips import small_clip

from kt3dmoseg import catalog
from kt3dmoseg.files import SafeZip, ZipLimits
from kt3dmoseg.frames import check_frames
from kt3dmoseg.io import load, save
from kt3dmoseg.io.fields import clip_values
from kt3dmoseg.io.flow_files import FLOW_SUFFIXES, read_flow, write_flow
from kt3dmoseg.io.formats import FORMATS
from kt3dmoseg.io.images import decode_indices, read_frame
from kt3dmoseg.io.info import info
from kt3dmoseg.io.predictions import read_prediction

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


def reads(read, path, content):
    """Read a damaged file, which stays there when the process is killed."""
    path.write_bytes(content)
    survives(read, path)


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
@bounded
@given(data=st.data())
@thorough
def test_damaged_clips(name, originals, tmp_path, data):
    reads(load, tmp_path / name, data.draw(damage(originals[name])))


_ELEMENTS = 1 << 17  # of an array: what is bounded is what reads it, not what makes it
SIZES = st.sampled_from([0, 1, 2, 3, 4, 5, 8, 2000])
VALUES = st.sampled_from([0, 0.5, 1, -1, 2, 300, 1e9, 1e308, -1e308, np.nan, np.inf, 2**63])
TYPES = st.sampled_from(["f8", "f4", "f2", "i8", "u1", "u8", "?", "c8", "U3", "S2", ">f8", "O"])


@st.composite
def arrays(draw: st.DrawFn, shape: tuple[int, ...]) -> np.ndarray:
    """An array of about this shape: axes in another order, cut, of another size, type or value."""
    axes = list(draw(st.permutations(shape)) if draw(st.booleans()) else shape)
    for _ in range(draw(st.integers(0, 1))):
        axis = draw(st.integers(0, len(axes) - 1))
        axes[axis] = min(draw(SIZES), _ELEMENTS // int(np.prod(axes[:axis] + axes[axis + 1 :])))
    axes = axes[draw(st.integers(0, 1)) * draw(st.integers(0, 1)) :]
    values = np.random.default_rng(draw(st.integers(0, 9))).random(axes) * draw(
        st.sampled_from([0, 1, 1, 200])
    )
    for _ in range(draw(st.integers(0, 2)) if values.size else 0):
        values.flat[draw(st.integers(0, values.size - 1))] = draw(VALUES)
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        made = values.astype(draw(st.just("f8") | TYPES))
    return np.asarray(made, order=draw(st.sampled_from("CF")))


POINTS = {"pred_tracks": (1, 4, 30, 2), "pred_visibility": (1, 4, 30)}
TAPVID = {"points": (30, 4, 2), "occluded": (30, 4), "video": (4, 24, 32, 3)}


@pytest.mark.parametrize("shapes", [POINTS, TAPVID], ids=["cotracker", "tapvid"])
@bounded
@given(data=st.data())
@thorough
def test_arrays_of_other_shapes_types_and_values(shapes, tmp_path, data):
    made = {name: data.draw(arrays(shape)) for name, shape in shapes.items()}
    np.savez(tmp_path / "a.npz", **made)
    survives(load, tmp_path / "a.npz")


TOKENS = [
    "-1",
    "0",
    "1",
    "4",
    "99999999",
    "9" * 400,
    "1e300",
    "-1e999",
    "nan",
    "0x1",
    "1_0",
    "\0",
    "1 1 " * 500,
    "",
]


@bounded
@given(data=st.data())
@thorough
def test_brox_files_with_other_numbers(originals, tmp_path, data):
    words = originals["clip.dat"].decode().split()
    for _ in range(data.draw(st.integers(1, 3))):
        words[data.draw(st.integers(0, min(len(words) - 1, 12)))] = data.draw(st.sampled_from(TOKENS))
    reads(load, tmp_path / "a.dat", " ".join(words).encode())


@pytest.mark.parametrize("suffix", FLOW_SUFFIXES)
@bounded
@given(data=st.data())
@thorough
def test_damaged_flow(suffix, originals, tmp_path, data):
    reads(read_flow, tmp_path / f"flow{suffix}", data.draw(damage(originals[f"flow{suffix}"])))


@bounded
@given(data=st.data())
@thorough
def test_damaged_frames(originals, tmp_path, data):
    content = data.draw(damage(originals["frame.png"]))
    reads(read_frame, tmp_path / "frame.png", content)
    reads(lambda path: decode_indices(path.read_bytes(), str(path)), tmp_path / "mask.png", content)


@pytest.mark.parametrize("name", ["prediction.csv", "prediction.npz"])
@bounded
@given(data=st.data())
@thorough
def test_damaged_predictions(name, originals, tmp_path, data):
    content = data.draw(damage(originals[name]))
    reads(lambda path: read_prediction(path, small_clip()), tmp_path / name, content)


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


@bounded
@given(data=st.data())
@thorough
def test_damaged_and_hostile_zips(tmp_path, data):
    content = data.draw(archives())
    reads(listing, tmp_path / "a.zip", data.draw(st.one_of(st.just(content), damage(content))))


@bounded
@given(data=st.data())
@thorough
def test_damaged_catalogs(tmp_path, data):
    mark = '{ crc32 = "89abcdef", bytes = 294096, pixels = "' + "0" * 64 + '" }'
    text = f'[clips.A]\ndate = "2011_09_26"\ndrive = 5\ncamera = 0\nlength = 1\nframes = [\n {mark},\n]\n'
    pieces = ["[" * 99, "{a=" * 99, ".a" * 99, "9" * 400, '"""', "'", "\0", "\ud7ff", "nan", "\\u0000"]
    at, piece = data.draw(st.integers(0, len(text))), data.draw(st.sampled_from(pieces))
    content = data.draw(damage((text[:at] + piece + text[at:]).encode()))
    reads(catalog.parse, tmp_path / "mine.toml", content)


@bounded
@given(data=st.data())
@thorough
def test_provenance_of_strangers(tmp_path, data):
    """What a clip's file says about itself is any JSON."""
    values = st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(max_size=5) | st.integers(-(10**400), 10**400),
        lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=9), inner, max_size=4),
        max_leaves=9,
    )
    keys = ("inputs", "source", "frames", "kind", "sha256")
    stated = data.draw(st.dictionaries(st.sampled_from(keys), values, max_size=4))
    with np.load(io.BytesIO(data.draw(st.just(clip_npz())))) as arrays:
        changed = dict(arrays) | {"provenance": np.array(json.dumps(stated))}
    buffer = io.BytesIO()
    np.savez(buffer, **changed)

    def read(path):
        check_frames(load(path).provenance, info(path)[:4], [path])

    reads(read, tmp_path / "clip.npz", buffer.getvalue())


@cache
def clip_npz():
    buffer = io.BytesIO()
    clip = small_clip()
    values = {"name": clip.name, "xy": clip.dense.xy, "visible": clip.dense.visible} | clip_values(clip)
    np.savez(buffer, **values)
    return buffer.getvalue()


@bounded
@given(content=st.binary(max_size=300), suffix=st.sampled_from([*CLIPS, "a.flo", "a.png", "a.npy"]))
@thorough
def test_anything_else(content, suffix, tmp_path):
    reads(info, tmp_path / suffix, content)
