"""RawDrive: frames, times, calibration, poses and tracklets by frame number."""

from __future__ import annotations

import importlib
from pathlib import Path

import cv2
import kitti_drives as drives
import numpy as np
import pytest

from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.kitti import RawDrive
from kt3dmoseg.kitti.tracklets import read_tracklets

NUMBERS = [*range(4, 9), 12]


@pytest.fixture
def root(tmp_path: Path) -> Path:
    frames = {k: drives.encode(drives.picture(k)) for k in NUMBERS}
    files = drives.drive_files(frames, 20) | drives.calibration_files()
    # A car 20 m ahead, then one next to the laser scanner, half of it behind the camera.
    text = drives.tracklets(6, [(20.0, 0.0, 0.0), (0.0, 4.0, 0.0)])
    files[f"{drives.DATE}/{drives.NAME}_sync/tracklet_labels.xml"] = text.encode()
    return drives.write_files(tmp_path, files)


@pytest.fixture
def drive(root: Path) -> RawDrive:
    return RawDrive(root, drives.DATE, drives.DRIVE)


def test_frames_come_by_number_not_by_position(drive: RawDrive) -> None:
    assert drive.numbers.tolist() == NUMBERS
    assert drive.numbers.dtype == np.int64
    for number in NUMBERS:
        np.testing.assert_array_equal(drive.frame(number), drives.picture(number))


def test_pykitti_would_give_other_frames(root: Path, drive: RawDrive) -> None:
    pykitti = importlib.import_module("pykitti")
    theirs = pykitti.raw(str(root), drives.DATE, "0005", frames=range(4, 6))
    first = np.asarray(theirs.get_cam0(0))
    np.testing.assert_array_equal(first, drives.picture(8))  # the trap: the fifth file, not frame 4
    np.testing.assert_array_equal(drive.frame(4), drives.picture(4))


@pytest.mark.parametrize("spelling", [5, "5", "0005", np.int64(5)])
def test_drive_may_be_spelt_as_number_or_text(root: Path, spelling: object) -> None:
    assert RawDrive(root, drives.DATE, spelling).frame_path(4).name == "0000000004.png"


def test_colour_cameras_give_rgb(root: Path) -> None:
    image = np.dstack([drives.picture(k) for k in range(3)])
    files = drives.drive_files({0: drives.encode(image[..., ::-1])}, 1, camera=2)
    drives.write_files(root, files)
    np.testing.assert_array_equal(RawDrive(root, drives.DATE, 5, camera=2).frame(0), image)


@pytest.mark.parametrize("number", [3, 9, 10_000])
def test_absent_frame_names_those_on_disk(drive: RawDrive, number: int) -> None:
    with pytest.raises(InputFileError, match=r"no such frame.*4-8,12"):
        drive.frame(number)


def test_broken_frame_is_an_error_not_none(root: Path, drive: RawDrive) -> None:
    drive.frame_path(4).write_bytes(drive.frame_path(4).read_bytes()[:30])
    with pytest.raises(FileFormatError, match=r"0000000004\.png.*expected a picture"):
        drive.frame(4)


@pytest.mark.parametrize(
    ("date", "number", "camera"),
    [
        *[("2011-09-26", 5, 0), ("../../etc", 5, 0), ("2011_09_26", 5, 4)],
        *[("2011_09_26", bad, 0) for bad in (-1, "x", True, "5/..", 10_000)],
    ],
)
def test_impossible_names_are_refused(root: Path, date: str, number: object, camera: int) -> None:
    with pytest.raises(InvalidValueError):
        RawDrive(root, date, number, camera)


def test_missing_drive_gives_what_to_do(root: Path) -> None:
    with pytest.raises(InputFileError, match="drive_0006_sync: no such folder; fetch it"):
        RawDrive(root, drives.DATE, 6)


def test_timestamps_are_the_cameras_and_keep_nanoseconds(root: Path, drive: RawDrive) -> None:
    oxts = root / drives.DATE / f"{drives.NAME}_sync/oxts/timestamps.txt"
    oxts.write_text("2000-01-01 00:00:00.000000000\n" * 20)  # another sensor's clock
    assert str(drive.datetimes([7])[0]) == "2011-09-26T13:02:25.700000007"
    # Line k is 0.1 s and 1 ns later than line k - 1; the origin is frame 0, which is not on disk.
    np.testing.assert_allclose(
        drive.timestamps([4, 12]), [4 * 0.100000001, 12 * 0.100000001], rtol=0, atol=1e-12
    )


def test_blank_timestamp_hurts_only_its_own_frame(drive: RawDrive) -> None:
    path = drive.frame_path(4).parents[1] / "timestamps.txt"
    lines = path.read_text().splitlines()
    lines[0] = lines[5] = ""
    path.write_text("\n".join(lines) + "\n")
    assert drive.timestamps([1, 2]).tolist() == pytest.approx([0.0, 0.100000001], abs=1e-12)
    with pytest.raises(FileFormatError, match="line 6"):
        drive.timestamps([4, 5])
    with pytest.raises(InvalidValueError, match="20 lines"):
        drive.timestamps([20])


@pytest.mark.parametrize("bad", ["2011-09-26 13:02:25.1+02:00", "2011-13-26 13:02:25.1", "hello"])
def test_nonsense_timestamp_is_one_error(drive: RawDrive, bad: str) -> None:
    (drive.frame_path(4).parents[1] / "timestamps.txt").write_text(bad + "\n")
    with pytest.raises(FileFormatError, match="line 1"):
        drive.timestamps([0])


@pytest.mark.parametrize("camera", range(4))
def test_calibration_agrees_with_pykitti(root: Path, camera: int) -> None:
    pykitti = importlib.import_module("pykitti")
    theirs = pykitti.raw(str(root), drives.DATE, "0005").calib
    ours = RawDrive(root, drives.DATE, 5, camera)
    np.testing.assert_allclose(ours.K, getattr(theirs, f"K_cam{camera}"))
    np.testing.assert_allclose(ours.T_cam_velo, getattr(theirs, f"T_cam{camera}_velo"), atol=1e-12)
    np.testing.assert_allclose(ours.T_cam_imu, getattr(theirs, f"T_cam{camera}_imu"), atol=1e-12)
    assert ours.image_size == drives.SIZE


def test_camera_offset_keeps_all_of_the_projection_matrix(root: Path) -> None:
    path = root / drives.DATE / "calib_cam_to_cam.txt"
    column = np.array([44.85, 0.21, 0.0027])  # KITTI's colour cameras have an offset in depth as well
    row = [f"{v} {t}" for v, t in zip(("100 0 31.5", "0 100 23.5", "0 0 1"), column, strict=True)]
    lines = [line for line in path.read_text().splitlines() if not line.startswith("P_rect_02")]
    path.write_text("\n".join([*lines, "P_rect_02: " + " ".join(row)]) + "\n")
    drive = RawDrive(root, drives.DATE, 5, camera=2)
    point = np.array([12.0, 1.0, -0.5, 1.0])
    expected = np.column_stack([drive.K, column]) @ RawDrive(root, drives.DATE, 5).T_cam_velo @ point
    np.testing.assert_allclose(drive.K @ (drive.T_cam_velo @ point)[:3], expected)


@pytest.mark.parametrize(
    ("damage", "found"),
    [
        ("", r"\[\]"),
        ("K: 1 2 3\n", r"\[\]"),
        ("P_rect_00: 1 2 3\n", r"\[1\.0, 2\.0, 3\.0\]"),
        ("no colon here\n", "'no colon here'"),
        ("P_rect_00: 1 2,5 3\n", "'2,5'"),
        ("\n", r"\[\]"),
    ],
)
def test_damaged_calibration_is_one_error(root: Path, drive: RawDrive, damage: str, found: str) -> None:
    (root / drives.DATE / "calib_cam_to_cam.txt").write_text(damage)
    with pytest.raises(FileFormatError, match=f"calib_cam_to_cam.*found .*{found}"):
        _ = drive.K


def test_missing_calibration_does_not_hide_the_frames(root: Path, drive: RawDrive) -> None:
    for path in (root / drives.DATE).glob("calib_*.txt"):
        path.unlink()
    assert drive.frame(4).shape == (48, 64)
    with pytest.raises(InputFileError, match=r"calib_velo_to_cam.*kt3dmoseg pull"):
        _ = drive.T_cam_velo


def test_poses_start_at_the_first_number_asked_for(drive: RawDrive) -> None:
    poses = drive.poses([4, 6])
    np.testing.assert_allclose(poses[0], np.eye(4), atol=1e-9)
    # 2e-5 degrees of longitude at 49 degrees north on a sphere of radius 6378137 m (KITTI's Mercator).
    east = np.radians(2e-5) * 6378137.0 * np.cos(np.radians(49.0))
    np.testing.assert_allclose(poses[1][:3, 3], [east, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(drive.poses([6, 4])[1][0, 3], -east, atol=1e-6)


@pytest.mark.parametrize("damage", ["1 2 3\n", "a " * 30 + "\n", "", drives.packet(4) * 2])
def test_damaged_oxts_is_one_error(root: Path, drive: RawDrive, damage: str) -> None:
    (root / drives.DATE / f"{drives.NAME}_sync/oxts/data/0000000004.txt").write_text(damage)
    with pytest.raises(FileFormatError, match="oxts"):
        drive.poses([4, 5])
    with pytest.raises(InputFileError, match=r"0000000099\.txt"):
        drive.poses([99])


def test_tracklet_in_front_projects_as_computed_by_hand(drive: RawDrive) -> None:
    (tracklet,) = drive.tracklets()
    assert (tracklet.kind, tracklet.numbers.tolist()) == ("Car", [6, 7])
    assert tracklet.size.tolist() == [4.0, 2.0, 1.5]
    (box,) = drive.tracklet_boxes(6)
    # Camera x = -y, y = -z - 0.25, z = x - 0.5. Nearest face at x = 18: depth 17.5; y = -1..1, z = -1..0.5.
    left, right = 31.5 - 100 * 1 / 17.5, 31.5 + 100 * 1 / 17.5
    top, bottom = 23.5 + 100 * -0.75 / 17.5, 23.5 + 100 * 0.75 / 17.5
    np.testing.assert_allclose(box.box, [left, top, right, bottom])
    assert box.depth == pytest.approx(19.5)
    assert (box.occlusion, box.truncation) == (0, 1)


def test_box_that_reaches_behind_the_camera_stays_on_its_side(drive: RawDrive) -> None:
    # Its near part lies at the left border; projecting the corners behind would throw it to the right.
    assert drive.tracklet_boxes(7) == []
    assert drive.tracklet_boxes(5) == []


def test_drive_without_tracklets_is_reported(root: Path, drive: RawDrive) -> None:
    assert drive.has_tracklets
    (root / drives.DATE / f"{drives.NAME}_sync/tracklet_labels.xml").unlink()
    assert not drive.has_tracklets
    with pytest.raises(InputFileError, match="some drives only"):
        drive.tracklets()


@pytest.mark.parametrize(
    "text",
    ["", "<a>", '<!DOCTYPE a [<!ENTITY x "y">]><a>&x;</a>']
    + [
        drives.tracklets(0, [(1, 1, 0)]).replace("<tx>1</tx>", new)
        for new in ("", "<tx>nan</tx>", "<tx>q</tx>")
    ],
)
def test_damaged_tracklets_are_one_error(root: Path, drive: RawDrive, text: str) -> None:
    (root / drives.DATE / f"{drives.NAME}_sync/tracklet_labels.xml").write_text(text)
    with pytest.raises(FileFormatError, match="tracklet_labels"):
        drive.tracklets()


def test_reading_does_not_change_what_opencv_decodes(drive: RawDrive) -> None:
    path = drive.frame_path(8)
    np.testing.assert_array_equal(drive.frame(8), cv2.imread(str(path), cv2.IMREAD_UNCHANGED))


def test_tracklets_with_more_tags_than_memory_are_refused(tmp_path: Path) -> None:
    (tmp_path / "tracklet_labels.xml").write_bytes(b"<a>" * 700_001)
    with pytest.raises(FileFormatError, match="at most 700000 tags, found 700001"):
        read_tracklets(tmp_path / "tracklet_labels.xml")
