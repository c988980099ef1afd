"""Damaged and hostile files of every format: one line, no traceback, no blow-up."""

from __future__ import annotations

import tracemalloc

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from io_clips import small_clip

from kt3dmoseg.errors import KT3DMoSegError
from kt3dmoseg.io import load, save
from kt3dmoseg.io.flow_files import FLOW_SUFFIXES, read_flow, write_flow
from kt3dmoseg.io.formats import FORMATS
from kt3dmoseg.io.images import decode_indices, read_frame
from kt3dmoseg.io.info import info
from kt3dmoseg.io.predictions import read_prediction

_MEMORY = 1 << 27
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
    """Read the damaged file: it may well be intact still, else it is a single line."""
    path.write_bytes(content)
    tracemalloc.start()
    try:
        read(path)
    except KT3DMoSegError as error:
        assert "\n" not in str(error)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < _MEMORY


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


@given(content=st.binary(max_size=300), suffix=st.sampled_from([*CLIPS, "a.flo", "a.png", "a.npy"]))
@thorough
def test_anything_else(content, suffix, tmp_path):
    survives(info, tmp_path / suffix, content)
