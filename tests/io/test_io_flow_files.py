"""Flow fields on disk."""

from __future__ import annotations

import struct

import cv2
import numpy as np
import pytest

from kt3dmoseg.errors import FileFormatError, InvalidValueError
from kt3dmoseg.io.flow_files import FLOW_SUFFIXES, read_flow, write_flow
from kt3dmoseg.io.formats import convert


@pytest.fixture
def field(rng):
    flow = rng.normal(scale=30, size=(5, 7, 2)).astype(np.float32)
    flow[1, 2] = np.nan
    return flow


@pytest.mark.parametrize("suffix", FLOW_SUFFIXES)
def test_fields_survive(suffix, field, tmp_path):
    write_flow(tmp_path / f"a{suffix}", field)
    back = read_flow(tmp_path / f"a{suffix}")
    assert back.dtype == np.float32
    np.testing.assert_allclose(back, field, atol=1 / 128 if suffix == ".png" else 0)
    assert np.isnan(back[1, 2]).all()


def test_convert_writes_every_format(rng, tmp_path):
    field = rng.normal(size=(6, 8, 2)).astype(np.float32)
    write_flow(tmp_path / "a.flo", field)
    for suffix in FLOW_SUFFIXES:
        convert(tmp_path / "a.flo", tmp_path / f"b{suffix}")
        np.testing.assert_allclose(read_flow(tmp_path / f"b{suffix}"), field, atol=0.01)


def test_flo_is_what_opencv_writes(rng, tmp_path):
    field = rng.normal(size=(5, 7, 2)).astype(np.float32)
    cv2.writeOpticalFlow(str(tmp_path / "theirs.flo"), field)
    write_flow(tmp_path / "ours.flo", field)
    assert (tmp_path / "ours.flo").read_bytes() == (tmp_path / "theirs.flo").read_bytes()
    np.testing.assert_array_equal(read_flow(tmp_path / "theirs.flo"), field)


def test_flo_marks_unknown_pixels_by_huge_values(tmp_path):
    values = struct.pack("<4f", 1.5, 2e9, 3.0, 4.0)
    (tmp_path / "a.flo").write_bytes(struct.pack("<fii", 202021.25, 2, 1) + values)
    flow = read_flow(tmp_path / "a.flo")
    assert np.isnan(flow[0, 0]).all()
    assert flow[0, 1].tolist() == [3.0, 4.0]


def test_kitti_png_is_red_u_green_v_blue_valid(tmp_path):
    pixel = np.zeros((1, 2, 3), dtype=np.uint16)
    pixel[0, 0] = [1, 2**15 - 64 * 3, 2**15 + 64 * 2]  # OpenCV's order: blue, green, red
    cv2.imwrite(str(tmp_path / "a.png"), pixel)
    flow = read_flow(tmp_path / "a.png")
    assert flow[0, 0].tolist() == [2.0, -3.0]
    assert np.isnan(flow[0, 1]).all()


def test_arrays_of_either_order(rng, tmp_path):
    field = rng.normal(size=(5, 7, 2))
    np.save(tmp_path / "last.npy", field)
    np.save(tmp_path / "first.npy", np.moveaxis(field, 2, 0))
    np.savez(tmp_path / "named.npz", flow=field, other=field[0])
    for name in ("last.npy", "first.npy", "named.npz"):
        np.testing.assert_array_equal(read_flow(tmp_path / name), field.astype(np.float32))


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        (
            "a.flo",
            struct.pack("<fii", 202021.25, 100_000, 100_000),
            "100000x100000",
        ),
        ("a.flo", struct.pack("<fii", 202021.25, -1, 4), r"-1x4"),
        ("a.flo", struct.pack("<f", 202021.25), ".flo of 0x0: expected 20 bytes, found 4"),
        ("a.flo", b"", "empty"),
        ("a.flo", b"GIF89a", "starts with"),
    ],
)
def test_bad_files(name, content, words, tmp_path):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FileFormatError, match=words):
        read_flow(tmp_path / name)


def test_a_picture_is_no_flow(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((4, 4), np.uint8))
    with pytest.raises(FileFormatError, match="16-bit RGB PNG"):
        read_flow(tmp_path / "a.png")


def test_arrays_of_other_shapes_and_objects(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((4, 4)))
    np.save(tmp_path / "b.npy", np.array([{}, 1], dtype=object), allow_pickle=True)
    np.savez(tmp_path / "c.npz", u=np.zeros((4, 4)), v=np.zeros((4, 4)))
    for name, words in (("a.npy", "H, W, 2"), ("b.npy", "pickle, which is never read"), ("c.npz", "'flow'")):
        with pytest.raises(FileFormatError, match=words):
            read_flow(tmp_path / name)


@pytest.mark.parametrize("shape", ["(4, 600000000, 2)", "(-4, 6, 2)", "(4, 6.0, 2)", "[[[[[[[["])
def test_a_header_with_wrong_sizes(shape, tmp_path):
    header = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    content = b"\x93NUMPY\1\0" + struct.pack("<H", len(header)) + header + bytes(192)
    (tmp_path / "a.npy").write_bytes(content)
    with pytest.raises(FileFormatError):
        read_flow(tmp_path / "a.npy")


def test_writing_refuses_what_does_not_fit(tmp_path):
    with pytest.raises(InvalidValueError, match=r"shape \(H, W, 2\)"):
        write_flow(tmp_path / "a.flo", np.zeros((4, 4)))
    with pytest.raises(InvalidValueError, match=r"suffix of \.flo"):
        write_flow(tmp_path / "a.txt", np.zeros((4, 4, 2)))
    with pytest.raises(InvalidValueError, match="within -512"):
        write_flow(tmp_path / "a.png", np.full((4, 4, 2), 600.0))
    assert list(tmp_path.iterdir()) == []
