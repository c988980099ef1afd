"""MAT-files: the released ones bit for bit, and the ones that must be refused."""

from __future__ import annotations

import struct
import tracemalloc
import zlib

import numpy as np
import pytest
import scipy.io
from io_clips import small_clip

from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.io import hdf5, load, save
from kt3dmoseg.io.matlab import read_mat

STRUCTS = ["kt3dmoseg/release", "hopkins12", "mtpv62"]


def _struct(path, **options):
    return scipy.io.loadmat(path, **options)["Data"][0, 0]


@pytest.mark.data
@pytest.mark.parametrize("folder", STRUCTS)
def test_released_files_survive_bit_for_bit(folder, data_root, tmp_path):
    files = sorted((data_root / folder).glob("*.mat"))
    assert files
    for file in files:
        clip = load(file)
        save(clip, tmp_path / "copy.mat")
        hdf5.write(clip, tmp_path / "copy.h5")
        save(hdf5.read(tmp_path / "copy.h5"), tmp_path / "through.mat")
        assert (tmp_path / "copy.mat").read_bytes() == (tmp_path / "through.mat").read_bytes()
        # In the classes that MATLAB shows; MATLAB stores whole numbers in fewer bytes.
        before, after = (_struct(path, mat_dtype=True) for path in (file, tmp_path / "copy.mat"))
        assert before.dtype.names == after.dtype.names
        for name in before.dtype.names:
            a, b = before[name], after[name]
            assert (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes()), (file, name)


@pytest.mark.data
def test_what_the_release_holds(data_root):
    clip = load(data_root / "kt3dmoseg/release/Seq059_Clip01_Tracks.mat")
    assert clip.name == "Seq059_Clip01"
    assert clip.labels.background == 1
    assert np.flatnonzero(clip.dense.lengths == 0).tolist() == [clip.evaluated[534]]
    assert len(load(data_root / "kt3dmoseg/release/Seq095_Clip01_Tracks.mat").dense) == 2972
    assert load(data_root / "kt3dmoseg/release/Seq028_clip03_Tracks.mat").name == "Seq028_clip03"


@pytest.mark.data
def test_what_hopkins_holds(data_root):
    path = data_root / "hopkins155/cars1/cars1_truth.mat"
    raw, clip = scipy.io.loadmat(path), load(path)
    homogeneous = np.dstack([clip.dense.xy, np.ones(clip.dense.visible.shape)])
    normalised = homogeneous @ np.linalg.inv(clip.camera.K).T
    np.testing.assert_allclose(np.moveaxis(normalised, 2, 0), raw["x"], atol=1e-12)
    assert clip.dense.image_size == (640, 480)
    assert clip.name == "cars1"
    assert clip.evaluated.tolist() == list(range(307))
    assert clip.labels.label.tolist() == raw["s"].ravel().tolist()


def test_the_mask_of_an_additional_hopkins_sequence(tmp_path):
    y = np.ones((3, 2, 3))
    y[:, 1, 2] = 0.0
    mask = np.array([[1, 1, 1], [1, 1, 0]])
    content = {"y": y, "s": np.array([[1], [0]]), "m": mask, "K": np.eye(3), "width": 4, "height": 3}
    scipy.io.savemat(tmp_path / "oc1R2RC_truth.mat", content)
    clip = load(tmp_path / "oc1R2RC_truth.mat")
    assert clip.dense.visible.tolist() == mask.astype(bool).tolist()
    assert np.isnan(clip.dense.xy[1, 2]).all()
    assert clip.labels.label.tolist() == [1, 0]
    scipy.io.savemat(tmp_path / "bad_truth.mat", content | {"m": mask[:1]})
    with pytest.raises(FileFormatError, match="m: expected 2 x 3, found 1 x 3"):
        load(tmp_path / "bad_truth.mat")


@pytest.mark.data
def test_hopkins12_and_mtpv(data_root):
    complete = load(data_root / "hopkins12/oc1R2RC_Tracks.mat")
    assert complete.dense.visible.all()
    assert "no mask" in complete.provenance["visibility"]
    gaps = load(data_root / "mtpv62/MTPV_data_Boat_Tracks.mat")
    assert 0.3 < gaps.dense.visible.mean() < 0.91
    assert (gaps.labels.label == 0).sum() == 12
    assert gaps.name == "MTPV_data_Boat"


def _release(**changes):
    """Return a valid struct of two of three tracks in two frames, with changed fields."""
    y = np.zeros((3, 3, 2))
    y[:, 0] = [[1.0, 2.0], [3.0, 4.0], [1.0, 1.0]]
    y[:, 2, 1] = [5.5, 6.5, 1.0]
    visible = y[2] == 1
    rows = np.array([1, 3])
    data = {
        "yAll": y,
        "visibleAll": visible,
        "ySparse": y[:, rows - 1],
        "visibleSparse": visible[rows - 1],
        "SparseIndex": rows[:, None].astype(float),
        "GtLabel": np.array([[1.0], [2.0]]),
        "nFrames": 2.0,
        "nAllPoints": 3.0,
        "nSparsePoints": 2.0,
    }
    return {key: value for key, value in (data | changes).items() if value is not None}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"K": None}, "K: expected numbers 3 x 3, found only height, s, width, y"),
        ({"K": np.eye(2)}, "K: expected 3 x 3, found 2 x 2"),
        ({"s": np.array([[1], [2], [1]])}, "s: expected a vector of 2, found 3 x 1"),
        ({"s": np.array([[1], [1.5]])}, "s: expected whole numbers"),
        ({"y": np.zeros((3, 2, 4))}, r"y: expected finite \(x, y, 1\)"),
        ({"width": "wide"}, "width: expected numbers 1 x 1, found a text"),
        ({"K": np.full((1, 2), {}, dtype=object)}, r"K: expected numbers 3 x 3, found cells"),
        ({"width": np.nan}, "image_size: expected .width, height.*found .nan, 9"),
        ({"height": np.inf}, "image_size: expected .width, height"),
        ({"height": -9.0}, "image_size: expected .width, height"),
    ],
)
def test_bad_hopkins_files(changes, words, tmp_path):
    good = {"y": np.ones((3, 2, 4)), "s": np.array([[1], [2]]), "K": np.eye(3), "width": 9, "height": 9}
    content = {key: value for key, value in (good | changes).items() if value is not None}
    scipy.io.savemat(tmp_path / "a_truth.mat", content)
    with pytest.raises(FileFormatError, match=words):
        load(tmp_path / "a_truth.mat")


@pytest.mark.parametrize("compressed", [True, False])
def test_files_of_other_writers_are_read(compressed, tmp_path):
    path = tmp_path / "clip_Tracks.mat"
    scipy.io.savemat(path, {"Data": _release(), "other": np.eye(2)}, do_compression=compressed)
    clip = load(path)
    assert clip.evaluated.tolist() == [0, 2]
    assert clip.labels.label.tolist() == [1, 2]
    np.testing.assert_array_equal(clip.dense.xy[2], [[np.nan, np.nan], [5.5, 6.5]])


_COUNTED_FROM_0 = {
    "SparseIndex": np.array([[1.0], [2.0], [3.0]]),
    "ySparse": _release()["yAll"],
    "visibleSparse": _release()["visibleAll"],
    "GtLabel": np.array([[0.0], [1.0], [0.0]]),
    "nSparsePoints": 3.0,
}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"GtLabel": None}, "struct Data with ySparse and GtLabel.*fields"),
        ({"GtLabel": np.array([[1.0], [2.5]])}, r"Data\.GtLabel: expected whole numbers"),
        ({"GtLabel": np.array([[1.0]])}, r"Data\.GtLabel: expected a vector of 2, found 1 x 1"),
        (_COUNTED_FROM_0, r"GtLabel: expected motions from 1, 0 for outliers, found 0 in 2 of 3.*from 1"),
        ({"SparseIndex": np.array([[0.0], [3.0]])}, r"Data\.SparseIndex: expected whole numbers 1\.\.3"),
        ({"SparseIndex": np.array([[1.0], [4.0]])}, r"Data\.SparseIndex"),
        ({"SparseIndex": np.array([[1.0], [2.0]])}, r"Data\.ySparse: expected the rows SparseIndex"),
        ({"nFrames": 7.0}, r"Data\.nFrames: expected 2"),
        ({"visibleSparse": np.full((2, 2), 2.0)}, r"Data\.visibleSparse: expected 0 or 1"),
        (
            {
                "SparseIndex": np.array([[1.0], [1.0]]),
                "ySparse": _release()["yAll"][:, [0, 0]],
                "visibleSparse": np.ones((2, 2)),
            },
            "evaluated: expected unique rows, found a row given twice",
        ),
        ({"visibleAll": np.ones((3, 2), dtype=bool)}, r"Data\.yAll: expected finite"),
        ({"yAll": np.zeros((2, 3, 2))}, r"Data\.yAll: expected 3 x any x 2, found 2 x 3 x 2"),
        ({"ySparse": "text"}, r"Data\.ySparse: expected numbers"),
    ],
)
def test_contradictions_are_named(changes, words, tmp_path):
    path = tmp_path / "clip.mat"
    scipy.io.savemat(path, {"Data": _release(**changes)})
    with pytest.raises(FileFormatError, match=words) as caught:
        load(path)
    assert str(path) in str(caught.value)


def test_mostly_unlabelled_clips_of_ours_come_back(tmp_path):
    scipy.io.savemat(tmp_path / "theirs.mat", {"Data": _release(**_COUNTED_FROM_0) | {"Background": 1.0}})
    save(load(tmp_path / "theirs.mat"), tmp_path / "ours.mat")
    assert load(tmp_path / "ours.mat").labels.label.tolist() == [0, 1, 0]


def test_another_struct_is_refused_with_what_it_holds(tmp_path):
    path = tmp_path / "clip.mat"
    scipy.io.savemat(path, {"images": np.eye(3)})
    with pytest.raises(FileFormatError, match=r"found variables images; give a KT3DMoSeg"):
        load(path)


def test_version_7_3_is_refused_with_the_way_to_save_it_again(tmp_path):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "clip.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["Data"] = np.zeros(3)
    text = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    path.write_bytes(text + path.read_bytes()[len(text) :])
    with pytest.raises(FileFormatError, match=r"version 7\.3.*'-v7'"):
        load(path)
    path.write_bytes(path.read_bytes()[512:])  # without MATLAB's text in front
    with pytest.raises(FileFormatError):
        load(path)


def _header(element):
    return b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H2s", 0x100, b"IM") + element


def _matrix(shape, payload):
    flags = struct.pack("<IIII", 6, 8, 6, 0)
    dims = struct.pack(f"<II{len(shape)}i", 5, 4 * len(shape), *shape) + bytes(-4 * len(shape) % 8)
    body = flags + dims + struct.pack("<HH4s", 1, 1, b"x") + payload
    return struct.pack("<II", 14, len(body)) + body


HOSTILE = {
    "element larger than the file": struct.pack("<II", 14, 1 << 31) + bytes(64),
    "array larger than its bytes": _matrix((1 << 30, 1 << 30), struct.pack("<II", 9, 8) + bytes(8)),
    "empty array of huge dimensions": _matrix((0, 2**31 - 1, 2**31 - 1, 2**31 - 1), struct.pack("<II", 9, 0)),
    "negative dimension": _matrix((-1, 4), struct.pack("<II", 9, 8) + bytes(8)),
    "too many dimensions": _matrix((1,) * 40, struct.pack("<II", 9, 8) + bytes(8)),
    "zlib bomb": (lambda packed: struct.pack("<II", 15, len(packed)) + packed)(
        zlib.compress(struct.pack("<II", 14, 1 << 29) + bytes(1 << 25))
    ),
    "tag inside a tag": struct.pack("<II", 15, 4) + b"abcd",
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_sizes_cost_nothing(name, tmp_path):
    path = tmp_path / "clip.mat"
    path.write_bytes(_header(HOSTILE[name]))
    tracemalloc.start()
    try:
        with pytest.raises(FileFormatError):
            load(path)
        assert tracemalloc.get_traced_memory()[1] < 1 << 26
    finally:
        tracemalloc.stop()


BODY = _matrix((1, 1), struct.pack("<IId", 9, 8, 1.5))
DAMAGED = {
    "empty file": (b"", "found 0 bytes"),
    "less than a header": (b"MATLAB 5.0 MAT-file", "found 19 bytes, a file that starts with"),
    "version 4": (struct.pack("<5i", 0, 2, 3, 0, 2) + bytes(200), "a file that starts with"),
    "text": (b"% MATLAB script" * 20, "a file that starts with b'% MATLAB"),
    "tag cut short": (_header(b"\x0e\0\0\0"), "the file is damaged or truncated"),
    "matrix cut short": (_header(BODY[:-4]), "an element of 56 bytes where 52 are left"),
    "no matrix": (_header(struct.pack("<IId", 9, 8, 1.5)), "an element of type 9 for a variable"),
    "no data": (_header(_matrix((1, 1), b"")), "an element is missing"),
    "text as numbers": (_header(_matrix((1, 1), struct.pack("<IId", 16, 8, 1.5))), "type 16 for one of"),
    "other size": (_header(_matrix((1, 3), struct.pack("<IId", 9, 8, 1.5))), "cannot reshape"),
    "no flags": (_header(struct.pack("<IIII", 14, 8, 9, 0)), "an element of type 9 for one of"),
    "bad zlib": (_header(struct.pack("<II", 15, 9) + b"123456789"), "Error -3"),
    "cut zlib": (
        _header(struct.pack("<II", 15, 4) + zlib.compress(BODY)[:4]),
        "damaged or truncated",
    ),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_damage_is_named(name, tmp_path):
    content, words = DAMAGED[name]
    (tmp_path / "clip.mat").write_bytes(content)
    with pytest.raises(FileFormatError, match=words):
        read_mat(tmp_path / "clip.mat")


def test_structs_inside_structs_end_somewhere(tmp_path):
    value: object = np.eye(2)
    for _ in range(50):
        value = {"inner": value}
    path = tmp_path / "deep.mat"
    scipy.io.savemat(path, {"Data": value})
    with pytest.raises(FileFormatError, match="inside each other"):
        load(path)


@pytest.mark.parametrize("compressed", [True, False])
def test_values_come_back_with_type_and_shape(compressed, tmp_path):
    values = {
        "double": np.array([[0.5, -1e300], [np.nan, np.inf]]),
        "whole": np.array([[1.0, 300.0, 70000.0]]),
        "zero": np.array([[-0.0, 1.0]]),
        "flag": np.array([[True, False]]),
        "byte": np.arange(24, dtype=np.uint8).reshape(2, 3, 4),
        "single": np.array([[1.5]], dtype=np.float32),
        "long": np.array([[2**62]], dtype=np.int64),
        "empty": np.zeros((0, 3)),
        "text": "Boat",
        "nothing": "",
    }
    path = tmp_path / "values.mat"
    scipy.io.savemat(path, {"outer": values} | values, do_compression=compressed)
    read = read_mat(path)
    for got in (read, read["outer"]):
        for name, value in values.items():
            if isinstance(value, str):
                assert got[name] == value
            else:
                assert got[name].dtype == value.dtype
                assert got[name].shape == value.shape
                assert got[name].tobytes() == value.tobytes()


def test_what_is_not_decoded_is_named(tmp_path):
    path = tmp_path / "cells.mat"
    cells = np.empty((1, 2), dtype=object)
    cells[:] = [np.eye(2), "a"]
    scipy.io.savemat(path, {"c": cells, "z": np.array([[1j]]), "s": scipy.sparse.eye(3)})
    read = read_mat(path)
    assert read["c"][0].tolist() == np.eye(2).tolist()
    assert read["c"][1] == "a"
    assert read["z"] == ("complex", (1, 1))
    assert read["s"] == ("sparse", (3, 3))


def test_text_of_two_bytes_a_character_is_read_as_it_was_stored(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"name": "\u0414\u043e\u0440\u043e\u0433\u0430", "plain": "road"})
    found = read_mat(tmp_path / "a.mat")
    assert (found["name"], found["plain"]) == ("\u0414\u043e\u0440\u043e\u0433\u0430", "road")


def test_a_big_endian_file_is_read(tmp_path):
    body = (
        struct.pack(">IIII", 6, 8, 6, 0)
        + struct.pack(">IIii", 5, 8, 1, 2)
        + struct.pack(">HH4s", 1, 1, b"x")
        + struct.pack(">IIdd", 9, 16, 1.5, -2.0)
    )
    header = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack(">H", 0x100) + b"MI"
    path = tmp_path / "big.mat"
    path.write_bytes(header + struct.pack(">II", 14, len(body)) + body)
    np.testing.assert_array_equal(read_mat(path)["x"], [[1.5, -2.0]])


def test_a_built_clip_gets_all_fields_of_the_schema(tmp_path):
    save(small_clip(), tmp_path / "clip.mat")
    fields = _struct(tmp_path / "clip.mat")
    assert fields["SparseIndex"].ravel().tolist() == [1, 3, 6, 4]
    assert fields["yAll"].shape == (3, 6, 5)
    assert (fields["yAll"][:, fields["visibleAll"] == 0] == 0).all()
    assert (fields["yAll"][2] == fields["visibleAll"]).all()
