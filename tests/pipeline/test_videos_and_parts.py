"""Videos as frames, and parts of any frames: by range, step and size."""

from __future__ import annotations

import struct

import cv2
import numpy as np
import pytest
from build_scenes import HEIGHT, WIDTH, scene, write_clip

from kt3dmoseg import load, show, track
from kt3dmoseg.cli import main
from kt3dmoseg.errors import InputFileError, InvalidValueError
from kt3dmoseg.frames import VideoFile, choose_sources, find_clips
from kt3dmoseg.io import images
from kt3dmoseg.io.images import read_frames

FLOW = ["--flow", "dis_medium", "--min-length", "3"]


def write_video(path, frames=12, seed=0):
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 10, (WIDTH, HEIGHT))
    for picture in scene(seed, frames):
        writer.write(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR))
    writer.release()
    return path


@pytest.fixture
def video(tmp_path):
    return write_video(tmp_path / "a long trip, 1970.mp4")


def test_a_part_of_a_folder_is_tracked_as_its_frames_alone(tmp_path):
    folder = write_clip(tmp_path / "clip", frames=12)
    command = ["track", str(folder), "-o", str(tmp_path / "a.h5"), *FLOW]
    assert main([*command, "--range", "3-9", "--step", "2", "--size", "80x48"]) == 0
    found = load(tmp_path / "a.h5")
    assert found.name == "clip_000003-000009"
    assert found.frame_numbers.tolist() == [3, 5, 7, 9]
    pictures = read_frames([folder / f"{number:06d}.png" for number in (3, 5, 7, 9)])
    alone = track([images.resized(p, (80, 48)) for p in pictures], flow="dis_medium", min_length=3)
    np.testing.assert_array_equal(found.dense.xy, alone.xy)
    assert found.dense.image_size == (80, 48)
    assert len(show(tmp_path / "a.h5", folder, output=tmp_path / "shown")) == 4


def test_track_build_and_show_take_a_video_and_keep_its_times(video, tmp_path, capsys):
    part = ["--range", "2-8", *FLOW]
    assert main(["track", str(video), "-o", str(tmp_path / "a.h5"), *part]) == 0
    assert main(["build", str(video), "-o", str(tmp_path / "out"), "--annotations", "none", *part]) == 0
    built = load(tmp_path / "out" / f"{video.stem}_000002-000008.h5")
    np.testing.assert_array_equal(load(tmp_path / "a.h5").dense.xy, built.dense.xy)
    np.testing.assert_allclose(built.timestamps, np.arange(2, 9) / 10, atol=1e-6)
    assert len(show(tmp_path / "a.h5", video, output=tmp_path / "shown")) == 7
    other = write_video(tmp_path / "other.mp4", seed=1)
    with pytest.raises(InputFileError, match="found pictures with other contents"):
        show(tmp_path / "a.h5", other, output=tmp_path / "shown")
    assert "warning" not in capsys.readouterr().err


@pytest.mark.parametrize(("there", "part"), [("", ["--range", "0-5"]), ("_000000-000005", [])])
def test_an_annotation_of_other_frames_is_not_to_be_renamed(video, tmp_path, capsys, there, part):
    name = f"{video.stem}{there}.json"
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / name).write_text("{}")
    command = ["build", str(video), "-o", str(tmp_path / "out"), "--annotations", str(tmp_path / "notes")]
    assert main([*command, *part]) == 2
    printed = capsys.readouterr().err
    assert f"found {name}; {name} is of other frames of the source: build those, or label these" in printed
    assert "rename" not in printed


@pytest.mark.parametrize("asked", [{"camera": 1}, {"drive": 9}, {"date": "2011_10_03"}])
def test_a_drive_is_not_asked_for_next_to_a_catalog(asked, tmp_path):
    with pytest.raises(InvalidValueError, match="catalogs: expected no date, drive or camera"):
        choose_sources(tmp_path, catalogs=[tmp_path / "located.toml"], **asked)


def test_python_tracks_a_video(video):
    tracks = track(video, flow="dis_medium")
    frames = list(VideoFile(video).frames("luma"))
    np.testing.assert_array_equal(tracks.xy, track(frames, flow="dis_medium").xy)


def test_the_labelling_page_gets_the_frames_of_a_video(video, tmp_path):
    [clip] = find_clips(video, annotations=tmp_path / "notes").values()
    assert clip.name == video.stem
    assert clip.annotation == tmp_path / "notes" / f"{video.stem}.json"
    for path, frame in zip(clip.frames, VideoFile(video).frames("luma"), strict=True):
        np.testing.assert_array_equal(images.read_frame(path), frame)


def test_the_labelling_page_gets_the_part_that_build_takes(video, tmp_path):
    folder = write_clip(tmp_path / "clip", frames=12)
    for given, size in ((folder, ""), (folder, "80x48"), (video, "80x48")):
        part = {"step": 2, "size": size}
        [source] = choose_sources(given, frames="3-9", **part)
        [clip] = find_clips(given, annotations=tmp_path / "notes", range_="3-9", **part).values()
        assert clip.name == source.name
        assert [images.frame_number(path) for path in clip.frames] == [3, 5, 7, 9]
        for path, frame in zip(clip.frames, source.frames("luma"), strict=True):
            np.testing.assert_array_equal(images.read_frame(path), frame)


def test_a_turned_video_is_turned_upright_and_that_is_said(video, tmp_path, capsys):
    content = bytearray(video.read_bytes())
    header = content.find(b"tkhd")
    matrix = header + 28 + 16 + (12 if content[header + 4] else 0)  # ISO/IEC 14496-12, 8.3.2
    turn = struct.pack(">9i", 0, 1 << 16, 0, -(1 << 16), 0, 0, HEIGHT << 16, 0, 1 << 30)
    content[matrix : matrix + 36] = turn
    (tmp_path / "turned.mp4").write_bytes(content)
    command = ["track", str(tmp_path / "turned.mp4"), "-o", str(tmp_path / "a.h5"), *FLOW]
    assert main(command) == 0
    assert "turned.mp4: turned upright by 90 degrees" in capsys.readouterr().err
    assert load(tmp_path / "a.h5").dense.image_size == (HEIGHT, WIDTH)


def test_a_part_has_the_same_pictures_where_opencv_cannot_go_to_it(video, monkeypatch):
    whole, known = list(images.read_video(video)), images.video_facts(video)[0]
    for times in (known, 0 * known):
        monkeypatch.setattr(images, "video_facts", lambda path, times=times: (times, 0))
        part = list(images.read_video(video, 5, 2, 11))
        np.testing.assert_array_equal(part, whole[5:11:2])


def test_a_variable_rate_is_said_and_times_are_kept(video, tmp_path, monkeypatch, capsys):
    times = np.cumsum([0.0, *[0.03, 0.07] * 5, 0.03])
    monkeypatch.setattr(images, "video_facts", lambda path: (times, 0))
    command = ["build", str(video), "-o", str(tmp_path), "--annotations", "none", "--workers", "1", *FLOW]
    assert main(command) == 0
    assert "frames are 30 to 70 ms apart; their times are kept" in capsys.readouterr().err
    np.testing.assert_array_equal(load(tmp_path / f"{video.stem}.h5").timestamps, times)


@pytest.mark.parametrize(
    ("part", "message"),
    [
        ({"frames": "2-40"}, "range: expected at least two frames of 0-11, found 2-40"),
        ({"frames": "4-5", "step": 3}, "found 4-5 in steps of 3"),
        ({"frames": "5"}, "range: expected FIRST-LAST"),
        ({"size": "640"}, "size: expected WIDTHxHEIGHT, as 640x192, found '640'"),
        ({"size": "0x9"}, "step and size: expected at least 1"),
    ],
)
def test_parts_that_are_not_there_are_refused(video, part, message):
    with pytest.raises(InvalidValueError, match=message):
        choose_sources(video, **part)[0].inspect()


def test_a_link_to_a_folder_has_its_own_name(tmp_path):
    write_clip(tmp_path / "data" / "a" / "frames")
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "Street").symlink_to(tmp_path / "data" / "a" / "frames")
    assert [source.name for source in choose_sources(tmp_path / "in")] == ["Street"]


def test_a_size_that_no_picture_may_have_is_refused(video):
    with pytest.raises(
        InvalidValueError, match="size: expected at most 67108864 pixels, found 100000x100000"
    ):
        choose_sources(video, size="100000x100000")


def test_building_into_the_folder_of_frames_can_be_repeated(tmp_path, capsys):
    write_clip(tmp_path / "in" / "street")
    for status in ("1 built", "1 up to date"):
        assert (
            main(["build", str(tmp_path / "in"), "-o", str(tmp_path / "in" / "out"), "--min-length", "3"])
            == 0
        )
        assert status in capsys.readouterr().out


def test_a_clip_may_be_built_into_the_folder_of_another(tmp_path, capsys):
    for seed, name in enumerate("ab"):
        write_clip(tmp_path / "in" / name, seed)
    assert main(["build", str(tmp_path / "in"), "-o", str(tmp_path / "in" / "a"), "--min-length", "3"]) == 0
    assert "2 built" in capsys.readouterr().out


def test_a_shift_without_masks_is_refused(tmp_path, capsys):
    write_clip(tmp_path / "in" / "street")
    assert main(["build", str(tmp_path / "in"), "-o", str(tmp_path / "out"), "--shift", "3"]) == 2
    assert "--shift: expected masks" in capsys.readouterr().err
