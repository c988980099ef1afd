"""Every registered flow backend keeps the contract of `kt3dmoseg.flow.Flow`."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from kt3dmoseg import flow
from kt3dmoseg.errors import InputFileError, InvalidValueError, UnknownNameError
from kt3dmoseg.flow import Flow
from kt3dmoseg.io.flow_files import write_flow
from kt3dmoseg.io.images import frame_paths, read_frame, write_png

SHIFT = (3.0, -2.0)
INSIDE = (slice(16, -16), slice(16, -16))


def texture(height=96, width=128, seed=0):
    noise = np.random.default_rng(seed).normal(size=(height, width))
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return cv2.normalize(smooth, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


def shifted(frame, shift=SHIFT):
    return np.roll(frame, (round(shift[1]), round(shift[0])), axis=(0, 1))


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    """Frames a, a, b on disk with their exact flow, for the backend that reads files."""
    root = tmp_path_factory.mktemp("clip")
    a = texture()
    frames = [a, a, shifted(a)]
    for folder in ("frames", "forward", "backward"):
        (root / folder).mkdir()
    for number, frame in enumerate(frames):
        cv2.imwrite(str(root / "frames" / f"{number:06d}.png"), frame)
    for number, motion in enumerate([(0.0, 0.0), SHIFT]):
        field = np.broadcast_to(np.float32(motion), (*a.shape, 2))
        write_flow(root / "forward" / f"{number:06d}.flo", field)
        write_flow(root / "backward" / f"{number:06d}.flo", -field)
    return root


@pytest.fixture(params=flow.list())
def backend(request, clip) -> Flow:
    if request.param == "raft":
        pytest.skip("needs weights; tested apart")
    folders = ("frames", "forward", "backward") if request.param == "files" else ()
    return flow.create(request.param, **{name: str(clip / name) for name in folders})


def test_shape_and_type(backend):
    a = texture()
    field = backend(a, shifted(a))
    assert field.shape == (*a.shape, 2)
    assert field.dtype == np.float32
    assert isinstance(backend, Flow)


def test_identical_frames_do_not_move(backend):
    a = texture()
    assert np.abs(backend(a, a.copy())[INSIDE]).max() < 0.05


def test_translation_is_found(backend):
    a = texture()
    field = backend(a, shifted(a))[INSIDE]
    np.testing.assert_allclose(np.median(field, axis=(0, 1)), SHIFT, atol=0.05)
    assert np.percentile(np.linalg.norm(field - SHIFT, axis=2), 95) < 0.25


def test_backward_is_the_opposite(backend):
    a = texture()
    field = backend(shifted(a), a)[INSIDE]
    np.testing.assert_allclose(np.median(field, axis=(0, 1)), np.negative(SHIFT), atol=0.05)


def test_frames_stay_untouched_and_result_is_repeatable(backend):
    a, b = texture(), shifted(texture())
    before = a.copy(), b.copy()
    first, second = backend(a, b), backend(a, b)
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(a, before[0])
    np.testing.assert_array_equal(b, before[1])


@pytest.mark.parametrize(
    ("a", "b", "message"),
    [
        (np.zeros((8, 64), np.uint8), np.zeros((8, 64), np.uint8), "at least 32"),
        (np.zeros((64, 31), np.uint8), np.zeros((64, 31), np.uint8), "found 31x64"),
        (np.zeros((64, 64), np.uint8), np.zeros((64, 65), np.uint8), "64x64 pixels like the first"),
        (np.zeros((64, 64, 3), np.uint8), np.zeros((64, 64, 3), np.uint8), "gray frame"),
        (np.zeros((64, 64), np.float32), np.zeros((64, 64), np.float32), "gray frame"),
    ],
)
def test_bad_frames_are_refused(backend, a, b, message):
    with pytest.raises(InvalidValueError, match=message):
        backend(a, b)


def test_names():
    assert flow.list()[:5] == ["dis", "dis_medium", "farneback", "files", "raft"]
    with pytest.raises(UnknownNameError, match="did you mean 'farneback'"):
        flow.create("farnback")
    with pytest.raises(UnknownNameError, match="did you mean 'levels'"):
        flow.create("farneback", level=3)
    with pytest.raises(InvalidValueError, match="levels"):
        flow.create("farneback", levels="0")


def test_files_need_folders_and_one_field_per_pair(clip, tmp_path):
    a = texture()
    with pytest.raises(InvalidValueError, match="give frames="):
        flow.create("files")(a, a)
    names = {"frames": str(clip / "frames"), "backward": str(clip / "backward")}
    with pytest.raises(InputFileError, match="2 flow files"):
        flow.create("files", forward=str(tmp_path), **names)(a, a)


def test_files_are_sorted_by_their_numbers_without_hidden_ones(clip, tmp_path):
    folders = {name: str(clip / name) for name in ("frames", "forward", "backward")}
    for number, source in ((9, "000000.flo"), (10, "000001.flo")):  # "10" sorts before "9"
        (tmp_path / f"flow_{number}_fwd.flo").write_bytes((clip / "forward" / source).read_bytes())
    (tmp_path / "._flow_9_fwd.flo").write_bytes(b"left by macOS")
    field = flow.create("files", **folders | {"forward": str(tmp_path)})(texture(), shifted(texture()))
    np.testing.assert_array_equal(field[0, 0], np.float32(SHIFT))


def test_files_take_frames_in_colour_as_luma(clip, tmp_path):
    folders = {name: str(clip / name) for name in ("forward", "backward")}
    pictures = [read_frame(path) for path in frame_paths(clip / "frames")]
    for number, picture in enumerate(pictures):
        tinted = np.stack([picture, np.minimum(picture, 250) + 5, picture], axis=2).astype(np.uint8)
        write_png(tmp_path / f"{number:06d}.png", tinted)
    a, b = [read_frame(path, "luma") for path in frame_paths(tmp_path)][1:]
    field = flow.create("files", frames=str(tmp_path), **folders)(a, b)
    np.testing.assert_array_equal(field[0, 0], np.float32(SHIFT))


def test_files_refuse_other_frames_and_other_sizes(clip, tmp_path):
    folders = {name: str(clip / name) for name in ("frames", "forward", "backward")}
    with pytest.raises(InvalidValueError, match="two neighbours"):
        flow.create("files", **folders)(texture(seed=1), texture(seed=2))
    for number in range(2):
        write_flow(tmp_path / f"{number}.npy", np.zeros((40, 40, 2), np.float32))
    with pytest.raises(InvalidValueError, match="expected a field of 128x96, found 40x40"):
        flow.create("files", **folders | {"forward": str(tmp_path)})(texture(), texture())
