"""Frames and annotations as people have them: found, or refused by name; never those of another clip."""

from __future__ import annotations

import io
import os
import shutil
import subprocess
import sys

import cv2
import numpy as np
import pytest
from build_scenes import FRAMES, HEIGHT, WIDTH, scene, write_clip
from PIL import Image

import kt3dmoseg
from kt3dmoseg.annotate import AnnotatedObject, Annotation, KeyFrame
from kt3dmoseg.annotate.model import save_annotation
from kt3dmoseg.cli import main
from kt3dmoseg.errors import FileFormatError, InputFileError
from kt3dmoseg.frames import find_clips, find_sources
from kt3dmoseg.io import load
from kt3dmoseg.io.images import frame_paths, read_frame
from kt3dmoseg.io.info import info
from kt3dmoseg.pipeline import build_dataset


@pytest.fixture
def frames(tmp_path):
    write_clip(tmp_path / "frames" / "clip")
    return tmp_path / "frames"


def build(frames, output, **options):
    options = {"flow": "dis_medium", "workers": 1} | options
    return build_dataset(frames, output, **options)


def run(*words):
    return main([*map(str, words)])


# --- names -----------------------------------------------------------------------------------------


def test_what_macos_and_windows_leave_is_no_frame(frames, tmp_path):
    clip = frames / "clip"
    for name in (*(f"._{path.name}" for path in frame_paths(clip)), ".DS_Store", "Thumbs.db", "desktop.ini"):
        (clip / name).write_bytes(b"\0\5\x16\7")
    (frames / "__MACOSX" / "clip").mkdir(parents=True)
    (frames / "__MACOSX" / "clip" / "._000001.png").write_bytes(b"\0\5\x16\7")
    (frames / ".DS_Store").write_bytes(b"x")
    assert [source.name for source in find_sources(frames)] == ["clip"]
    assert build(frames, tmp_path / "out")[0].counts["frames"] == FRAMES


def test_a_link_that_leads_nowhere_is_no_shorter_clip(frames, tmp_path):
    linked = tmp_path / "linked" / "clip"
    linked.mkdir(parents=True)
    for path in frame_paths(frames / "clip"):
        (linked / path.name).symlink_to(path)
    assert build(linked.parent, tmp_path / "out")[0].status == "built"
    (linked / "000006.png").unlink()
    (linked / "000006.png").symlink_to("../../gone/000006.png")
    outcome = build(linked.parent, tmp_path / "out")[0]
    assert outcome.status == "failed"
    assert (
        "000006.png: expected a file or folder, found a link that leads nowhere (../../gone" in outcome.reason
    )
    (linked / "000006.png").unlink()
    (linked / "000006.png").symlink_to("000006.png")  # to itself
    assert "a link that leads nowhere" in build(linked.parent, tmp_path / "out")[0].reason
    (linked.parent / "other").symlink_to(tmp_path / "gone")
    with pytest.raises(InputFileError, match="other: expected a file or folder, found a link"):
        find_sources(linked.parent)


def test_a_pipe_or_folder_named_as_a_frame_is_refused(frames):
    os.mkfifo(frames / "clip" / "000007.png")
    with pytest.raises(FileFormatError, match=r"000007\.png: expected a picture, found a folder or device"):
        frame_paths(frames / "clip")


def test_frames_go_by_number_and_a_gap_or_a_number_given_twice_is_named(tmp_path):
    for number, picture in enumerate(scene(frames=11), start=1):
        (tmp_path / "f").mkdir(exist_ok=True)
        cv2.imwrite(str(tmp_path / "f" / f"frame_{number}.PNG"), picture)
    assert [path.stem for path in frame_paths(tmp_path / "f")] == [f"frame_{n}" for n in range(1, 12)]
    shutil.copy(tmp_path / "f" / "frame_3.PNG", tmp_path / "f" / "frame_003.png")
    with pytest.raises(
        FileFormatError, match=r"frame 3: expected one file, found frame_003\.png and frame_3\.PNG"
    ):
        frame_paths(tmp_path / "f")
    for name in ("frame_003.png", "frame_3.PNG"):
        (tmp_path / "f" / name).unlink()
    with pytest.raises(FileFormatError, match="2 followed by 4"):
        frame_paths(tmp_path / "f")


def test_stray_pictures_next_to_clips_hide_none_of_them(frames):
    for name in ("overview1.png", "overview2.png"):
        cv2.imwrite(str(frames / name), np.zeros((9, 9), np.uint8))
    found = r"one folder of frames per clip, found both: overview1\.png and clip; give"
    for find in (find_sources, info, lambda path: find_clips(path, annotations=path)):
        with pytest.raises(InputFileError, match=found):
            find(frames)


# --- pixels ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "WEBP"])
def test_a_picture_that_browsers_would_turn_is_refused_with_its_orientation(tmp_path, kind):
    picture, path = Image.fromarray(next(scene())), tmp_path / f"1.{kind.lower()}"
    for orientation in range(10):
        exif = Image.Exif()
        exif[0x0112] = orientation
        picture.save(path, kind, exif=exif, lossless=True)
        if orientation in range(2, 9):
            with pytest.raises(
                FileFormatError, match=f"stored upright, found EXIF orientation {orientation}; turn"
            ):
                read_frame(path)
        else:
            assert read_frame(path).shape == (HEIGHT, WIDTH)


@pytest.mark.filterwarnings("ignore:Corrupt EXIF")
def test_damaged_exif_is_passed_over_as_browsers_do(tmp_path):
    buffer = io.BytesIO()
    Image.fromarray(next(scene())).save(buffer, "JPEG", exif=b"Exif\0\0MM\0*\xff\xff\xff\xff\xff")
    (tmp_path / "1.jpg").write_bytes(buffer.getvalue())
    assert read_frame(tmp_path / "1.jpg").shape == (HEIGHT, WIDTH)


def test_turned_frames_fail_to_build_and_to_open_with_their_orientation(tmp_path, capsys):
    exif = Image.Exif()
    exif[0x0112] = 6
    (tmp_path / "frames" / "clip").mkdir(parents=True)
    for number, picture in enumerate(scene()):
        Image.fromarray(picture).save(tmp_path / "frames" / "clip" / f"{number}.jpg", exif=exif)
    assert run("build", tmp_path / "frames", "-o", tmp_path / "out", "--annotations", "none") == 2
    assert "EXIF orientation 6" in capsys.readouterr().err
    assert run("label", tmp_path / "frames", "--no-browser", "--annotations", tmp_path / "drawn") == 2
    assert "EXIF orientation 6" in capsys.readouterr().err


# --- the clip's own frames -------------------------------------------------------------------------


@pytest.fixture
def built(frames, tmp_path):
    build(frames, tmp_path / "built")
    return tmp_path / "built" / "clip.h5"


def test_frames_of_another_clip_are_neither_drawn_on_nor_labelled(built, frames, tmp_path, capsys):
    other = write_clip(tmp_path / "other" / "clip", seed=1)
    for given in (other, tmp_path / "other"):
        assert run("show", built, "--frames", given, "-o", tmp_path / "pictures") == 2
        expected = "expected the frames that clip was made from, found pictures with other contents"
        assert expected in capsys.readouterr().err
        assert not (tmp_path / "pictures").exists()
        assert (
            run("label", built, "--frames", given, "--no-browser", "--annotations", tmp_path / "drawn") == 2
        )
        assert expected in capsys.readouterr().err
    assert run("label", other, "--tracks", built, "--no-browser", "--annotations", tmp_path / "drawn") == 2
    assert expected in capsys.readouterr().err
    assert run("show", built, "--frames", frames, "-o", tmp_path / "pictures") == 0


@pytest.mark.parametrize("suffix", [".h5", ".npz"])
def test_tracked_clips_know_their_frames_too(frames, tmp_path, capsys, suffix):
    tracked = tmp_path / f"clip{suffix}"
    assert run("track", frames / "clip", "-o", tmp_path / "clip.h5", "--flow", "dis_medium") == 0
    kt3dmoseg.save(load(tmp_path / "clip.h5"), tracked)
    other = write_clip(tmp_path / "other" / "clip", seed=1)
    assert run("show", tracked, "--frames", other, "-o", tmp_path / "p", "--at", 0) == 2
    assert "other contents" in capsys.readouterr().err
    assert run("show", tracked, "--frames", frames, "-o", tmp_path / "p", "--at", 0) == 0


def test_tracks_of_other_clips_are_not_left_out_quietly(frames, built, tmp_path):
    tracks = shutil.copy(built, tmp_path / "Clip.h5")
    with pytest.raises(InputFileError, match=r"Clip\.h5: expected tracks of clip, found Clip"):
        find_clips(frames / "clip", annotations=tmp_path, tracks=tracks)


# --- annotations -----------------------------------------------------------------------------------


def annotate(path, clip="clip", *objects):
    path.parent.mkdir(exist_ok=True)
    save_annotation(path, Annotation(clip, (WIDTH, HEIGHT), FRAMES, objects))


def test_annotations_of_no_clip_are_refused(frames, tmp_path, capsys):
    folder = tmp_path / "annotations"
    folder.mkdir()
    command = ("build", frames, "-o", tmp_path / "out", "--annotations", folder)
    assert run(*command) == 2
    assert "annotations: expected clip.json, found no annotation" in capsys.readouterr().err
    annotate(folder / "Clip.json", "Clip")
    assert run(*command) == 2
    assert "annotations: expected clip.json, found Clip.json; rename it" in capsys.readouterr().err
    annotate(folder / "clip.json", "Clip")
    assert run(*command) == 2
    assert "clip.json: clip: expected 'clip', found 'Clip'" in capsys.readouterr().err
    annotate(folder / "clip.json")
    assert run(*command) == 0
    assert "warning" not in capsys.readouterr().err
    drawn = KeyFrame(0, polygons=(((0, 0), (WIDTH, 0), (0, HEIGHT)),))
    cars = (AnnotatedObject(motion, f"car {motion}", "car", motion, (drawn,)) for motion in (1, 2))
    annotate(folder / "clip.json", "clip", *cars)
    assert run(*command) == 0  # where two motions are drawn in one place, every trajectory is in conflict
    assert "warning: clip: nothing is labelled as car 1, car 2\n" in capsys.readouterr().err


def test_an_annotation_of_another_size_or_length_is_refused_by_its_file(frames, tmp_path, capsys):
    path = tmp_path / "annotations" / "clip.json"
    for field, size, count in (("image_size", (WIDTH, 2 * HEIGHT), FRAMES), ("n_frames", (WIDTH, HEIGHT), 3)):
        path.parent.mkdir(exist_ok=True)
        save_annotation(path, Annotation("clip", size, count))
        for command in (("build", frames, "-o", tmp_path / "out"), ("label", frames, "--no-browser")):
            assert run(*command, "--annotations", path.parent) == 2
            assert f"{path}: {field}: expected" in capsys.readouterr().err


def test_clips_without_an_annotation_among_others_are_listed(frames, tmp_path, capsys, monkeypatch):
    write_clip(frames / "other", 1)
    annotate(tmp_path / "annotations" / "clip.json")
    assert run("build", frames, "-o", tmp_path / "out", "--annotations", tmp_path / "annotations") == 0
    assert "warning: nothing in " in (shown := capsys.readouterr().err)
    assert "labels other\n" in shown
    outcomes = build(frames, tmp_path / "out2", annotations=tmp_path / "annotations")
    assert {outcome.name: outcome.labels for outcome in outcomes} == {"clip": "annotation", "other": ""}
    monkeypatch.chdir(tmp_path)  # where annotations/ is the default
    assert run("build", frames / "other", "-o", tmp_path / "out3") == 0
    assert run("build", frames / "clip", "-o", tmp_path / "out4") == 0
    assert capsys.readouterr().err == ""
    (tmp_path / "annotations" / "clip.json").rename(tmp_path / "annotations" / "CLIP.json")
    assert run("build", frames / "clip", "-o", tmp_path / "out5") == 2
    assert "found CLIP.json; rename it" in capsys.readouterr().err


# --- what was built --------------------------------------------------------------------------------


def test_a_damaged_byte_anywhere_in_a_built_file_means_it_is_built_again(frames, built):
    content = built.read_bytes()
    assert build(frames, built.parent)[0].status == "up to date"
    used = [at for at, byte in enumerate(content) if byte]  # where nothing is kept there are zeros
    for part in (0.2, 0.5, 0.8):
        damaged = bytearray(content)
        damaged[used[int(part * len(used))]] ^= 4
        built.write_bytes(damaged)
        outcome = build(frames, built.parent)[0]
        assert (outcome.status, built.read_bytes()) == ("built", content)
        assert "no intact clip" in outcome.reason


# --- KITTI -----------------------------------------------------------------------------------------


@pytest.fixture
def raw(tmp_path):
    day = tmp_path / "raw" / "2011_09_26"
    camera = day / "2011_09_26_drive_0009_sync" / "image_00"
    (camera / "data").mkdir(parents=True)
    for number, picture in enumerate(scene()):
        cv2.imwrite(str(camera / "data" / f"{number:010d}.png"), picture)
    stamps = (f"2011-09-26 13:02:{25 + k / 10:012.9f}\n" for k in range(FRAMES))
    (camera / "timestamps.txt").write_text("".join(stamps))
    calibrate(day, WIDTH, HEIGHT)
    return tmp_path / "raw"


def calibrate(day, width, height):
    text = f"S_rect_00: {width} {height}\nP_rect_00: 50 0 {width / 2} 0 0 50 {height / 2} 0 0 0 1 0\n"
    (day / "calib_cam_to_cam.txt").write_text("calib_time: x\n" + text)


def test_a_calibration_of_another_size_is_refused(raw, tmp_path):
    assert build(raw, tmp_path / "out")[0].status == "built"
    calibrate(raw / "2011_09_26", 300, 200)
    outcome = build(raw, tmp_path / "out")[0]
    assert outcome.status == "failed"
    assert "calibration of camera 0: expected 96x64 px, as the frames, found 300x200" in outcome.reason


def test_a_folder_next_to_the_raw_root_is_answered_with_the_root(raw, tmp_path):
    day = raw / "2011_09_26"
    for given in (tmp_path, day, day / "2011_09_26_drive_0009_sync"):
        with pytest.raises(InputFileError, match=f"expected a KITTI raw root, found .*; give {raw}$"):
            find_sources(given)


def test_jpeg_frames_of_a_drive_are_named(raw, tmp_path):
    data = raw / "2011_09_26" / "2011_09_26_drive_0009_sync" / "image_00" / "data"
    for path in sorted(data.iterdir()):
        cv2.imwrite(str(path.with_suffix(".jpg")), cv2.imread(str(path)))
        path.unlink()
    outcome = build(raw, tmp_path / "out")[0]
    assert "expected KITTI's frames, 0000000000.png, found 0000000000.jpg" in outcome.reason


# --- several clips on the labelling page -----------------------------------------------------------


def test_label_warns_of_what_does_not_fit_several_clips(frames, built, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(
        "kt3dmoseg.annotate.server.app.serve", lambda routes, **_: print(sorted(routes.sessions))
    )
    for name in ("clip", "other"):
        write_clip(tmp_path / "others" / name, seed=5)
    annotate(tmp_path / "drawn" / "Clip.json", "Clip")
    kt3dmoseg.label(tmp_path / "others", tracks=built, annotations=tmp_path / "drawn")
    shown = capsys.readouterr()
    assert shown.out == "['clip', 'other']\n"
    assert "warning: clip: " in shown.err
    assert "expected the frames that clip was made from" in shown.err
    assert "Clip.json is of none of the clips by its case" in shown.err


def test_label_without_its_extra_names_it(frames, tmp_path):
    (tmp_path / "path" / "starlette").mkdir(parents=True)
    missing = "raise ModuleNotFoundError(\"No module named 'starlette'\", name='starlette')"
    (tmp_path / "path" / "starlette" / "__init__.py").write_text(missing)
    code = "import sys; from kt3dmoseg.cli import main; sys.exit(main())"
    command = [
        sys.executable,
        "-c",
        code,
        "label",
        str(frames),
        "--no-browser",
        "--annotations",
        str(tmp_path),
    ]
    paths = os.pathsep.join([str(tmp_path / "path"), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = os.environ | {"PYTHONPATH": paths}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
    wanted = "kt3dmoseg: starlette is not installed; pip install 'kt3dmoseg[label]'\n"
    assert (done.returncode, done.stderr) == (2, wanted)


def test_show_is_a_function_with_the_options_of_the_command(frames, built, tmp_path):
    lines = []
    written = kt3dmoseg.show(built, frames, output=tmp_path / "p", at=2, trail=3, report=lines.append)
    assert written == [tmp_path / "p" / "clip_000003.png"]
    assert lines == [f"{tmp_path / 'p'}: clip, 1 picture"]
    for target in ("a.png", "b.gif"):
        assert kt3dmoseg.show(built, output=tmp_path / target, report=len) == [tmp_path / target]
    os.mkfifo(tmp_path / "c.png")
    with pytest.raises(InputFileError, match="found a FIFO"):
        kt3dmoseg.show(built, output=tmp_path / "c.png")


def test_commands_refuse_a_pipe_before_the_work(frames, tmp_path, capsys):
    os.mkfifo(tmp_path / "clip.h5")
    os.mkfifo(tmp_path / "mine.toml")
    where = ("--catalog", tmp_path / "mine.toml", "--date", "2011_09_26", "--drive", "5", "--numbers", "1-9")
    for command in (
        ("track", frames / "nothing", "-o", tmp_path / "clip.h5"),
        ("catalog", "add", "A", *where),
    ):
        assert run(*command) == 2
        assert "expected a regular file or a new name, found a FIFO" in capsys.readouterr().err
