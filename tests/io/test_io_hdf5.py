"""What the canonical format promises beyond the contract of all formats, and refuses."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor

import h5py
import numpy as np
import pytest
from io_clips import assert_same, small_clip

from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.io import hdf5, load
from kt3dmoseg.types import Clip, Labels, Trajectories


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "clip.h5"
    hdf5.write(small_clip(), path)
    return path


def test_it_describes_itself(file):
    with h5py.File(file) as stream:
        assert stream.attrs["format"] == b"kt3dmoseg clip"
        assert stream.attrs["version"] == 1
        names = []
        stream.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
        assert sorted(names) == sorted(hdf5.DESCRIPTIONS)
        for name in names:
            assert stream[name].attrs["description"].decode() == hdf5.DESCRIPTIONS[name]
            assert stream[name].compression == "gzip"
            assert stream[name].fletcher32


def test_any_hdf5_reader_gets_the_arrays(file):
    clip = small_clip()
    with h5py.File(file) as stream:
        np.testing.assert_array_equal(stream["dense/xy"][()], clip.dense.xy)
        assert stream["evaluated"][()].tolist() == clip.evaluated.tolist()
        assert stream["dense"].attrs["image_size"].tolist() == [64, 48]


def test_a_writer_of_our_layout_need_not_be_us(tmp_path):
    path = tmp_path / "theirs.h5"
    with h5py.File(path, "w") as stream:
        stream.attrs.update({"format": "kt3dmoseg clip", "version": 1, "name": "theirs"})
        stream["dense/xy"] = np.zeros((2, 3, 2))
        stream["dense/visible"] = np.ones((2, 3), dtype=np.uint8)
        stream["dense/track_id"] = np.array([4, 9])
        stream["evaluated"] = np.array([1])
        stream["labels/label"] = np.array([2])
        stream["frames/number"] = np.arange(3)
    clip = hdf5.read(path)
    assert clip.name == "theirs"
    assert clip.dense.track_id.tolist() == [4, 9]
    assert dict(clip.provenance) == {}


@pytest.mark.parametrize("n", [0, 3])
def test_a_clip_without_anything_evaluated(n, tmp_path):
    tracks = Trajectories(np.full((n, 4, 2), np.nan), np.zeros((n, 4), dtype=bool))
    none = np.zeros(0, dtype=np.int64)
    clip = Clip("empty", tracks, none, Labels(none))
    hdf5.write(clip, tmp_path / "clip.h5")
    assert_same(clip, hdf5.read(tmp_path / "clip.h5"))


def test_provenance_of_any_length(tmp_path):
    clip = small_clip()
    long = Clip(clip.name, clip.dense, clip.evaluated, clip.labels, provenance={"ü": "x" * 200_000})
    hdf5.write(long, tmp_path / "clip.h5")
    assert hdf5.provenance(tmp_path / "clip.h5") == {"ü": "x" * 200_000}


def test_provenance_must_be_json(tmp_path):
    clip = small_clip()
    odd = Clip(clip.name, clip.dense, clip.evaluated, clip.labels, provenance={"path": tmp_path})
    with pytest.raises(InvalidValueError, match=r"provenance.*JSON"):
        hdf5.write(odd, tmp_path / "clip.h5")
    assert not (tmp_path / "clip.h5").exists()


def test_a_newer_version_is_refused(file):
    with h5py.File(file, "r+") as stream:
        stream.attrs["version"] = 2
    with pytest.raises(FileFormatError, match=r"version: expected at most 1, found 2;.*newer"):
        hdf5.read(file)


def test_another_hdf5_file_is_refused(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as stream:
        stream["data"] = np.eye(2)
    with pytest.raises(FileFormatError, match="expected a kt3dmoseg clip, found another HDF5 file"):
        hdf5.read(tmp_path / "a.h5")


def _replace(file, name, value, **options):
    with h5py.File(file, "r+") as stream:
        del stream[name]
        if isinstance(value, (h5py.SoftLink, h5py.ExternalLink)):
            stream[name] = value
        else:
            stream.create_dataset(name, data=value, **options)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("dense/xy", np.zeros((6, 5)), "xy: expected shape"),
        ("dense/xy", np.zeros((6, 4, 2)), "visible: expected shape"),
        ("dense/track_id", np.zeros(6, dtype=np.int64), "unique ids"),
        ("evaluated", np.array([0, 1, 2, 99]), "evaluated: expected rows in 0..5"),
        ("labels/label", np.array([1.0, 1, 1, 1]), "label: expected whole numbers, found float64"),
        ("frames/number", np.arange(3), "frame_numbers"),
        ("dense/visible", h5py.SoftLink("/evaluated"), "data in this file, found a link"),
        ("dense/visible", h5py.ExternalLink("other.h5", "/x"), "data in this file, found a link"),
    ],
)
def test_wrong_content_is_named(name, value, words, file):
    _replace(file, name, value)
    with pytest.raises(FileFormatError, match=words) as caught:
        load(file)
    assert str(file) in str(caught.value)


@pytest.mark.parametrize(
    ("group", "name", "value", "words"),
    [
        ("dense", "image_size", np.int64(5), "image_size: expected .width, height."),
        ("dense", "image_size", np.array([5]), "image_size: expected .width, height."),
        ("dense", "image_size", np.array([0, 4]), "image_size: expected .width, height."),
        ("dense", "image_size", np.array([4, 1 << 40]), "image_size: expected .width, height."),
        ("dense", "image_size", np.array([np.nan, 4]), "image_size: expected .width, height."),
        ("labels", "names", '{"van": "2"}', "names: expected numbers of motions, found 'van'"),
        ("labels", "names", "[1]", "names: expected a JSON object, found list"),
        ("/", "provenance", "{", "provenance: expected JSON"),
        ("/", "name", 5, "name: expected a text, found int64"),
        ("/", "version", 1.5, "version: expected whole numbers"),
        ("/", "version", 0, "version: expected whole numbers 1.*found 0"),
    ],
)
def test_wrong_attributes_are_named(group, name, value, words, file):
    with h5py.File(file, "r+") as stream:
        stream[group].attrs[name] = value
    with pytest.raises(FileFormatError, match=words) as caught:
        load(file)
    assert str(file) in str(caught.value)


def test_a_missing_name_and_a_group_for_an_array_are_named(file):
    with h5py.File(file, "r+") as stream:
        del stream["evaluated"]
        stream.create_group("evaluated")
    with pytest.raises(FileFormatError, match=r"evaluated: expected a dataset of numbers, found .*group"):
        hdf5.read(file)
    hdf5.write(small_clip(), file)
    with h5py.File(file, "r+") as stream:
        del stream.attrs["name"]
    with pytest.raises(FileFormatError, match="name: expected a text, found only K, background"):
        hdf5.read(file)


def test_a_huge_attribute_is_not_read(file):
    with h5py.File(file, "r+", libver="latest") as stream:
        del stream.attrs["provenance"]
        space, text = h5py.h5s.create_simple((1 << 20,)), h5py.h5t.C_S1.copy()
        text.set_size(128)
        h5py.h5a.create(stream.id, b"provenance", text, space)
    with pytest.raises(FileFormatError, match="provenance: expected at most 67108864 bytes"):
        hdf5.read(file)


def test_a_missing_array_is_named(file):
    with h5py.File(file, "r+") as stream:
        del stream["evaluated"]
    with pytest.raises(FileFormatError, match="evaluated: expected whole numbers, found only K, background"):
        hdf5.read(file)


def test_data_outside_the_file_is_not_followed(file, tmp_path):
    (tmp_path / "secret").write_bytes(bytes(48))
    with h5py.File(file, "r+") as stream:
        del stream["dense/track_id"]
        external = [(str(tmp_path / "secret"), 0, 48)]
        stream.create_dataset("dense/track_id", (6,), "i8", external=external)
    with pytest.raises(FileFormatError, match="a reference to another file"):
        hdf5.read(file)


@pytest.mark.parametrize(
    "options",
    [
        {"shape": (1 << 40, 5, 2), "chunks": (64, 5, 2), "compression": "gzip"},
        {"shape": (6, 5, 2), "chunks": (1 << 25, 5, 2), "maxshape": (None, 5, 2), "compression": "gzip"},
        {"shape": (6, 5, 2), "chunks": (6, 5, 2), "compression": "lzf"},
    ],
)
def test_bombs_and_strange_filters_are_refused(options, file):
    with h5py.File(file, "r+") as stream:
        del stream["dense/xy"]
        stream.create_dataset("dense/xy", dtype="f8", **options)
    with pytest.raises(FileFormatError, match=r"expected (at most|chunks|gzip)"):
        hdf5.read(file)


def test_the_bytes_do_not_depend_on_when_python_frees_what_it_wrote(file, tmp_path):
    held = []
    before = sys.getprofile()
    sys.setprofile(lambda frame, *_: held.append(frame))  # as the profiler of Dask holds variables
    try:
        hdf5.write(small_clip(), tmp_path / "profiled.h5")
    finally:
        sys.setprofile(before)
    assert (tmp_path / "profiled.h5").read_bytes() == file.read_bytes()
    assert held


def test_two_threads_write_at_once(file, tmp_path):
    paths = [tmp_path / f"{k}.h5" for k in range(40)]
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda path: hdf5.write(small_clip(), path), paths))
    assert {path.read_bytes() for path in paths} == {file.read_bytes()}


def test_flipped_data_is_noticed_by_its_checksum(file):
    content = bytearray(file.read_bytes())
    with h5py.File(file) as stream:
        at = stream["dense/xy"].id.get_chunk_info(0).byte_offset
    content[at + 10] ^= 1
    file.write_bytes(content)
    with pytest.raises(FileFormatError, match="damage"):
        hdf5.read(file)


def test_a_missing_file_is_missing(tmp_path):
    with pytest.raises(InputFileError, match="No such file"):
        hdf5.read(tmp_path / "a.h5")
