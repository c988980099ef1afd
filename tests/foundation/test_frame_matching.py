"""Which frame a file is of: by name, then by number, never by position."""

from __future__ import annotations

import pytest

from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.matching import match_frames, number_in

FROM_ONE = [f"{k:06d}.png" for k in range(1, 9)]
KITTI = [f"{k:010d}.png" for k in range(3, 11)]


@pytest.mark.parametrize(
    ("file", "frame"),
    [
        ("000003.png", 2),
        ("000003.json", 2),
        ("masks/left/000003.png", 2),
        (r"C:\masks\000003.png", 2),
        ("000003.png.json", 2),
        ("000003_png.rf.0a1b2c3d4e5f6.jpg", 2),
        ("frame_3.png", 2),
        ("0000000003.png", 2),
        ("000009.png", None),
        ("000000.png", None),
        ("readme.png", None),
        ("left.000003", 2),
        ("000001_3.png", None),
        ("2011_0001_000003.png", 2),
    ],
)
def test_a_file_belongs_to_the_frame_of_its_name_else_its_number(file, frame):
    match = match_frames([file], FROM_ONE)
    assert match.frames == ({} if frame is None else {file: frame})
    assert match.unmatched == ([file] if frame is None else [])


@pytest.mark.parametrize("files", [["00003_1.png"], ["00003_1.png", "00004_2.png"], ["3-1.png", "4-1.png"]])
def test_a_number_behind_that_of_a_frame_is_of_an_object(files):
    match = match_frames(files, FROM_ONE)
    assert (match.frames, match.unmatched) == ({}, files)


def test_a_number_before_all_frames_is_of_the_recording():
    files = ["0005_000003.png", "0005_000004.png"]
    assert match_frames(files, FROM_ONE).frames == dict(zip(files, (2, 3), strict=True))


def test_numbers_of_another_width():
    files = [f"{k:06d}.png" for k in range(3, 8)]
    assert list(match_frames(files, KITTI).frames.values()) == [0, 1, 2, 3, 4]


def test_a_stray_file_moves_no_other():
    files = [f"{k:06d}.png" for k in range(7)]
    match = match_frames(files, FROM_ONE)
    assert match.frames == {f"{k:06d}.png": k - 1 for k in range(1, 7)}
    assert match.doubt == "000000.png belong to no frame of the clip"


def test_files_of_every_frame_and_more_leave_no_doubt():
    match = match_frames([f"{k:06d}.png" for k in range(20)], FROM_ONE)
    assert len(match.frames) == 8
    assert match.doubt == ""


def test_a_complete_count_from_zero_where_no_number_fits():
    frames = [f"{k:06d}.png" for k in range(100, 108)]
    match = match_frames([f"{k:05d}.png" for k in range(8)], frames)
    assert list(match.frames.values()) == list(range(8))
    assert "from 0" in match.note
    assert match_frames([f"{k:05d}.png" for k in range(7)], frames).frames == {}
    assert match_frames([f"{k:05d}.png" for k in range(1, 9)], frames).frames == {}


def test_a_shift_goes_by_number():
    match = match_frames([f"{k:05d}.png" for k in range(8)], FROM_ONE, shift=1)
    assert list(match.frames.values()) == list(range(8))


def test_hidden_files_are_passed_over():
    files = ["000001.png", "._000001.png", "__MACOSX/a/000002.png", ".hidden/000002.png", "./000002.png"]
    assert match_frames(files, FROM_ONE).frames == {"000001.png": 0, "./000002.png": 1}


def test_two_files_of_one_frame():
    with pytest.raises(FileFormatError, match=r"a_3\.png and b_3\.png"):
        match_frames(["a_3.png", "b_3.png"], FROM_ONE)
    assert match_frames(["000003.png", "thumb_3.png"], FROM_ONE).unmatched == ["thumb_3.png"]


def test_of_several_folders_the_clip_s_counts():
    files = [f"{clip}/00000{k}.png" for clip in ("road", "town") for k in (1, 2)]
    match = match_frames(files, FROM_ONE, clip="town")
    assert match.frames == {"town/000001.png": 0, "town/000002.png": 1}
    assert match.others == ["road/000001.png", "road/000002.png"]
    with pytest.raises(FileFormatError, match="road, town"):
        match_frames(files, FROM_ONE, clip="lake")


def test_files_of_another_clip_fill_no_gap():
    match = match_frames(["Town/000001.png", "road/000002.png"], FROM_ONE, clip="town")
    assert (match.frames, match.others) == ({"Town/000001.png": 0}, ["road/000002.png"])


def test_parts_of_a_frame_are_not_answered_with_a_shift():
    match = match_frames(["000003_1.png", "000003_2.png"], FROM_ONE)
    assert (match.frames, match.fix) == ({}, "rename them as the frames")


def test_the_last_number_counts():
    assert number_in("2011_09_26/0000000042.png") == 42
    assert number_in("1403636579763555584.png") == 403636579763555584
    assert number_in("none.png") is None
