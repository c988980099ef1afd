"""Folders of clips, `info` and `convert`."""

from __future__ import annotations

import dataclasses
import json

import cv2
import numpy as np
import pytest
from io_clips import small_clip

from kt3dmoseg.cli import main
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.io import dataset_paths, load, load_dataset, save
from kt3dmoseg.io.fields import check_name, clip_name
from kt3dmoseg.io.flow_files import read_flow, write_flow
from kt3dmoseg.io.formats import convert
from kt3dmoseg.io.images import write_moving
from kt3dmoseg.io.info import info


@pytest.mark.data
@pytest.mark.parametrize(
    ("folder", "count", "first"),
    [
        ("kt3dmoseg", 14, "Seq005_Clip01"),
        ("kt3dmoseg/release", 14, "Seq005_Clip01"),
        ("hopkins155", 100, "1R2RC"),
        ("hopkins12", 8, "oc1R2RC"),
        ("mtpv62", 7, "MTPV_data_Boat"),
    ],
)
def test_every_layout_of_the_real_data(folder, count, first, data_root):
    paths = dataset_paths(data_root / folder)
    assert len(paths) == count
    assert next(iter(paths)) == first
    assert list(paths) == sorted(paths)
    assert load(paths[first]).name == first


def test_a_dataset_is_sorted_and_skips_what_is_unfinished(tmp_path):
    for name in ("b", "a"):
        save(small_clip(name), tmp_path / f"{name}.h5")
    (tmp_path / ".c.h5.xyz.part").write_bytes(b"half")
    (tmp_path / ".d.h5").write_bytes(b"half")
    (tmp_path / "notes.txt").write_text("-")
    assert list(load_dataset(tmp_path)) == ["a", "b"]


def test_two_files_of_one_clip(tmp_path):
    save(small_clip(), tmp_path / "a.h5")
    save(small_clip(), tmp_path / "a_Tracks.mat")
    with pytest.raises(FileFormatError, match=r"clip a: expected one file, found a\.h5 and a_Tracks\.mat"):
        dataset_paths(tmp_path)


def test_nothing_there(tmp_path):
    with pytest.raises(InputFileError, match="expected clips"):
        dataset_paths(tmp_path)
    with pytest.raises(InputFileError, match="no such folder"):
        dataset_paths(tmp_path / "none")


HOPKINS = ["1R2RC", "1R2RC_g12", "cars1"]


@pytest.fixture
def benchmarks(tmp_path):
    """Two benchmarks as their archives unpack."""
    for name in HOPKINS:
        save(small_clip(name), tmp_path / "all" / "Hopkins155" / name / f"{name}_truth.mat")
        (tmp_path / "all" / "__MACOSX" / name).mkdir(parents=True)
        (tmp_path / "all" / "__MACOSX" / name / f"{name}_truth.mat").write_bytes(b"0")
    for name in ("MTPV_data_Boat", "MTPV_data_Man"):
        save(small_clip(name), tmp_path / "all" / "MTPV62" / f"{name}_Tracks" / f"{name}_Tracks.mat")
    return tmp_path / "all"


def test_clips_are_found_as_archives_unpack_and_one_or_two_levels_higher(benchmarks):
    both = [*HOPKINS, "MTPV_data_Boat", "MTPV_data_Man"]
    assert list(load_dataset(benchmarks / "Hopkins155")) == HOPKINS
    assert list(load_dataset(benchmarks)) == sorted(both)
    assert list(load_dataset(benchmarks.parent)) == sorted(both)
    assert list(load_dataset(benchmarks / "Hopkins155" / "cars1")) == ["cars1"]


def test_below_the_clips_or_at_an_archive_the_message_says_where_they_are(benchmarks):
    below = benchmarks / "Hopkins155" / "cars1" / "images"
    below.mkdir()
    with pytest.raises(
        InputFileError, match=rf"found none, .*; give {below.parent}, which has cars1_truth\.mat"
    ):
        dataset_paths(below)
    deep = benchmarks.parent / "a" / "b" / "c"
    deep.mkdir(parents=True)
    benchmarks.rename(deep / "all")
    with pytest.raises(
        InputFileError, match=r"give .*/a/b/c/all, which has Hopkins155/1R2RC/1R2RC_truth\.mat"
    ):
        dataset_paths(benchmarks.parent)
    (deep / "all").rename(benchmarks)
    (benchmarks / "Hopkins12.zip").write_bytes(b"PK")
    with pytest.raises(
        InputFileError, match=r"Hopkins12\.zip: expected a folder of clips, found a file; .*unpack"
    ):
        dataset_paths(benchmarks / "Hopkins12.zip")


def test_label_files_next_to_an_empty_folder_are_not_taken_for_its_clips(tmp_path):
    (tmp_path / "data").mkdir()
    for name in ("labels.npz", "labels.dat"):
        (tmp_path / name).write_bytes(b"PK")
    with pytest.raises(InputFileError, match=r"found none, nor in folders up to 3 below$"):
        dataset_paths(tmp_path / "data")


def test_clips_next_to_folders_of_other_clips_are_not_all_there_is(benchmarks):
    save(small_clip(), benchmarks / "a.h5")
    with pytest.raises(
        InputFileError, match=r"found a\.h5 there, and Hopkins155/1R2RC/.*\(5 in folders\); move"
    ):
        load_dataset(benchmarks)


def test_predictions_copies_and_caches_below_clips_are_no_other_clips(tmp_path):
    for name in ("a", "b"):
        save(small_clip(name), tmp_path / f"{name}.h5")
        save(small_clip(name), tmp_path / "mine" / f"{name}.h5")
        save(small_clip(name), tmp_path / "cache" / f"{name}0123.npz")
    assert list(dataset_paths(tmp_path).values()) == [tmp_path / "a.h5", tmp_path / "b.h5"]


def test_a_link_back_to_the_folder_gives_no_clip_twice(benchmarks):
    (benchmarks / "MTPV62" / "all").symlink_to(benchmarks / "MTPV62", target_is_directory=True)
    assert list(dataset_paths(benchmarks / "MTPV62")) == ["MTPV_data_Boat", "MTPV_data_Man"]


def test_names_come_from_files():
    assert clip_name("x/Seq028_clip03_Tracks.mat") == "Seq028_clip03"
    assert clip_name("oc1R2RC_g12_Tracks.mat") == "oc1R2RC_g12"
    assert clip_name("built.v2.h5") == "built.v2"


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "a\\b", "a\nb", "x" * 201])
def test_a_name_that_could_not_be_a_file_is_refused(name):
    check_name("Seq005_Clip01", "--name")
    with pytest.raises(InvalidValueError, match="--name: expected a clip's name"):
        check_name(name, "--name")


def test_info_of_a_clip(tmp_path, capsys):
    save(small_clip(), tmp_path / "tiny.h5")
    assert main(["info", str(tmp_path / "tiny.h5")]) == 0
    words = capsys.readouterr().out.split()
    for expected in ("tiny", "hdf5", "64x48", "7..11", "car", "background", "provenance", "0.400"):
        assert expected in words


def test_info_lists_the_motions_before_the_provenance(tmp_path):
    options = {f"option_{k}": k for k in range(30)}
    origin = {"format": "build", "inputs": {"options": options, "labels": {}, "code": "e72f"}}
    save(dataclasses.replace(small_clip(), provenance=origin), tmp_path / "tiny.h5")
    lines = info(tmp_path / "tiny.h5").splitlines()
    starts = [line.partition("  ")[0] for line in lines]
    assert starts.index("motions") < starts.index("motion") < starts.index("provenance inputs code")
    assert sum("options" in line for line in lines) == 1
    assert "option_0 0, option_1 1, " in " ".join(lines)
    assert [line.split()[-1] for line in lines if "labels" in line] == ["none"]
    assert max(map(len, lines)) <= 110


def test_info_of_a_folder_counts(tmp_path):
    for name in ("a", "b"):
        save(small_clip(name), tmp_path / f"{name}.npz")
    lines = info(tmp_path).splitlines()
    assert lines[1].split()[:7] == ["a", "5", "6", "4", "2", "2", "1"]
    assert lines[-1].split() == ["2", "clips", "10", "12", "8"]


def test_info_of_frames_flow_and_pictures(tmp_path):
    clips = tmp_path / "frames"
    for clip, numbers in (("good", (1, 2)), ("gap", (1, 3))):
        (clips / clip).mkdir(parents=True)
        for number in numbers:
            cv2.imwrite(str(clips / clip / f"{number:06d}.png"), np.zeros((48, 64), np.uint8))
    text = info(clips)
    assert "without a gap" in text
    assert text.splitlines()[2].split() == ["good", "2", "1..2", "64x48", "8-bit", "gray"]
    assert info(clips / "good").split()[-5:-2] == ["2", "1..2", "64x48"]
    write_flow(tmp_path / "a.flo", np.full((4, 6, 2), 3.0))
    assert "optical flow of 6x4, 100.0% known, mean 4.24 px" in info(tmp_path / "a.flo")
    write_flow(tmp_path / "a.png", np.full((4, 6, 2), np.nan))
    assert "nowhere known" in info(tmp_path / "a.png")
    np.save(tmp_path / "a.npy", np.full((4, 6, 2), 3e38, np.float32))  # its length is beyond float32
    assert "100.0% known, mean 4242640" in info(tmp_path / "a.npy")
    assert "a picture of 64x48, 8-bit gray" in info(clips / "good/000001.png")


@pytest.mark.parametrize("picture", [np.zeros((40, 64), np.uint8), np.zeros((48, 64), np.uint16), None])
def test_info_of_one_folder_reads_every_frame(picture, tmp_path):
    for number in (1, 2, 3):
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.zeros((48, 64), np.uint8))
    assert "64x48" in info(tmp_path)
    third = tmp_path / "3.png"
    if picture is None:
        third.write_bytes(third.read_bytes()[:60])
    else:
        cv2.imwrite(str(third), picture)
    with pytest.raises(FileFormatError, match=r"3\.png: expected"):
        info(tmp_path)


def test_info_of_a_video(tmp_path, capfd):
    write_moving(tmp_path / "a.avi", [np.zeros((48, 64, 3), np.uint8)] * 3, 5)
    assert info(tmp_path / "a.avi") == "a.avi: a video of 3 frames, 64x48"
    (tmp_path / "b.mp4").write_bytes(b"text")
    with pytest.raises(FileFormatError, match=r"b\.mp4: expected a video"):
        info(tmp_path / "b.mp4")
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    "name", ["tiny.h5", "frames", "frames/clip", "clips", "a.flo", "a.avi", "frames/clip/1.png"]
)
def test_info_as_json(name, tmp_path, capsys):
    for folder in (tmp_path, tmp_path / "clips"):
        save(small_clip(), folder / "tiny.h5")
    (tmp_path / "frames/clip").mkdir(parents=True)
    for number in (1, 2):
        cv2.imwrite(str(tmp_path / f"frames/clip/{number}.png"), np.zeros((48, 64), np.uint8))
    write_flow(tmp_path / "a.flo", np.full((48, 64, 2), 3.0))
    write_moving(tmp_path / "a.avi", [np.zeros((48, 64, 3), np.uint8)] * 3, 5)
    assert main(["info", str(tmp_path / name), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    parts = facts.get("folders") or facts.get("clips") or [facts]
    assert [part["image_size"] for part in parts] == [[64, 48]]
    if facts["kind"] == "clip":
        assert [motion["share"] for motion in facts["motions"]] == [0.25, 0.5, 0.25]
        assert facts["camera"] == {"name": "image_00", "has_K": True}
        assert facts["provenance"] == {"made": "by a test", "numbers": [1, 2.5, None]}


def test_info_of_nothing(tmp_path, capsys):
    assert main(["info", str(tmp_path / "none")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_convert_reports_what_is_lost(tmp_path, capsys):
    save(small_clip(), tmp_path / "tiny.h5")
    assert main(["convert", str(tmp_path / "tiny.h5"), str(tmp_path / "tiny.npz")]) == 0
    assert capsys.readouterr().err.strip().endswith("written")
    assert main(["convert", str(tmp_path / "tiny.npz"), str(tmp_path / "tiny.mat")]) == 0
    lost = capsys.readouterr().err.split(": ")[-1].strip().split(", ")
    assert {"image size", "names of the motions", "camera", "timestamps", "provenance"} <= set(lost)
    assert not {"coordinates", "labels", "name", "which label is the background"} & set(lost)


def test_convert_flow(tmp_path):
    field = np.array([[[0.5, 1 / 3]]])
    write_flow(tmp_path / "a.flo", field)
    assert convert(tmp_path / "a.flo", tmp_path / "a.npy") == []
    assert convert(tmp_path / "a.flo", tmp_path / "a.png") == ["displacements are rounded by up to 0.0052 px"]
    assert read_flow(tmp_path / "a.npy")[0, 0, 0] == 0.5


def test_convert_refuses(tmp_path):
    save(small_clip(), tmp_path / "tiny.h5")
    with pytest.raises(InvalidValueError, match="another file than the source"):
        convert(tmp_path / "tiny.h5", tmp_path / "tiny.h5")
    with pytest.raises(InvalidValueError, match="expected a suffix of"):
        convert(tmp_path / "tiny.h5", tmp_path / "tiny.xls")
    with pytest.raises(FileFormatError):
        convert(tmp_path / "tiny.h5", tmp_path / "tiny.flo")
