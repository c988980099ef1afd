"""Paths inside KITTI raw: one place that knows how the data set spells its folders, files and zips."""

from __future__ import annotations

import re
from pathlib import PurePosixPath

from kt3dmoseg.catalog.entries import Drive, check_camera, whole

CALIBRATION_FILES = ("calib_cam_to_cam.txt", "calib_imu_to_velo.txt", "calib_velo_to_cam.txt")
TRACKLET_FILE = "tracklet_labels.xml"
TIMESTAMP_FILE = "timestamps.txt"

_FRAME = re.compile(r"(\d{10})\.png")
_LAST_FRAME = 10**10 - 1


def drive_folder(drive: Drive) -> PurePosixPath:
    """Folder of the synchronised and rectified drive, relative to the KITTI raw root."""
    return PurePosixPath(drive.date) / f"{drive.name}_sync"


def camera_folder(drive: Drive, camera: int) -> PurePosixPath:
    """Folder of one camera, relative to the root; holds ``timestamps.txt`` and ``data/``."""
    return drive_folder(drive) / f"image_{check_camera(camera):02d}"


def frame_file(drive: Drive, camera: int, number: int) -> PurePosixPath:
    """Path of one frame, relative to the root."""
    return camera_folder(drive, camera) / "data" / f"{whole(number, 'frame number', _LAST_FRAME):010d}.png"


def frame_number(file_name: str) -> int | None:
    """Return the number of the frame that a file of this name holds; None for other files."""
    match = _FRAME.fullmatch(file_name)
    return int(match[1]) if match else None


def oxts_folder(drive: Drive) -> PurePosixPath:
    """Folder of the GPS/IMU unit, relative to the root."""
    return drive_folder(drive) / "oxts"


def oxts_file(drive: Drive, number: int) -> PurePosixPath:
    """Path of the GPS/IMU packet of one frame, relative to the root."""
    return oxts_folder(drive) / "data" / f"{whole(number, 'frame number', _LAST_FRAME):010d}.txt"


def tracklet_file(drive: Drive) -> PurePosixPath:
    """Path of the tracklet labels, relative to the root."""
    return drive_folder(drive) / TRACKLET_FILE


def calibration_files(date: str) -> list[PurePosixPath]:
    """Paths of a day's three calibration files, relative to the root."""
    return [PurePosixPath(date) / name for name in CALIBRATION_FILES]


def sync_zip(drive: Drive) -> str:
    """Address of the drive's frames below the data set's base address."""
    return f"{drive.name}/{drive.name}_sync.zip"


def tracklet_zip(drive: Drive) -> str:
    """Address of the drive's tracklets below the data set's base address; absent for many drives."""
    return f"{drive.name}/{drive.name}_tracklets.zip"


def calibration_zip(date: str) -> str:
    """Address of a day's calibration below the data set's base address."""
    return f"{date}_calib.zip"
