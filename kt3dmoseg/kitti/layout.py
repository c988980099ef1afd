"""Names inside KITTI raw: one place that knows how the data set spells its folders, files and zips."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import PurePosixPath

from kt3dmoseg.errors import InvalidValueError

CAMERAS = (0, 1, 2, 3)
CALIBRATION_FILES = ("calib_cam_to_cam.txt", "calib_imu_to_velo.txt", "calib_velo_to_cam.txt")
TRACKLET_FILE = "tracklet_labels.xml"
TIMESTAMP_FILE = "timestamps.txt"

_DATE = re.compile(r"\d{4}_\d{2}_\d{2}")
_FRAME = re.compile(r"(\d{10})\.png")
_LAST_DRIVE = 9999
_LAST_FRAME = 10**10 - 1


@dataclass(frozen=True, order=True)
class Drive:
    """One recording of KITTI raw.

    Parameters
    ----------
    date : str
        Day of the recording, ``"2011_09_26"``.
    number : int or str
        Number of the drive on that day: 5, ``"5"`` and ``"0005"`` are the same.

    Raises
    ------
    InvalidValueError
        When either is not of that form.
    """

    date: str
    number: int

    def __post_init__(self) -> None:
        if not isinstance(self.date, str) or not _DATE.fullmatch(self.date):
            raise InvalidValueError("date", expected="the form 2011_09_26", found=repr(self.date))
        object.__setattr__(self, "number", _whole(self.number, "drive", _LAST_DRIVE))

    @property
    def name(self) -> str:
        """For instance ``"2011_09_26_drive_0005"``."""
        return f"{self.date}_drive_{self.number:04d}"

    @property
    def folder(self) -> PurePosixPath:
        """Folder of the synchronised and rectified drive, relative to the KITTI raw root."""
        return PurePosixPath(self.date) / f"{self.name}_sync"

    def camera_folder(self, camera: int) -> PurePosixPath:
        """Folder of one camera, relative to the root; holds ``timestamps.txt`` and ``data/``."""
        return self.folder / f"image_{check_camera(camera):02d}"

    def frame_file(self, camera: int, number: int) -> PurePosixPath:
        """Path of one frame, relative to the root."""
        return self.camera_folder(camera) / "data" / f"{_whole(number, 'frame number', _LAST_FRAME):010d}.png"

    def oxts_file(self, number: int) -> PurePosixPath:
        """Path of the GPS/IMU packet of one frame, relative to the root."""
        return self.folder / "oxts" / "data" / f"{_whole(number, 'frame number', _LAST_FRAME):010d}.txt"

    @property
    def tracklet_file(self) -> PurePosixPath:
        """Path of the tracklet labels, relative to the root."""
        return self.folder / TRACKLET_FILE


def check_camera(camera: int | str) -> int:
    """Return the camera's number: 0 gray left, 1 gray right, 2 colour left, 3 colour right.

    Raises
    ------
    InvalidValueError
        For anything else.
    """
    number = _whole(camera, "camera", CAMERAS[-1])
    return CAMERAS[number]


def frame_number(file_name: str) -> int | None:
    """Return the number of the frame that a file of this name holds; None for other files."""
    match = _FRAME.fullmatch(file_name)
    return int(match[1]) if match else None


def _whole(value: object, what: str, last: int) -> int:
    digits = str(value) if not isinstance(value, bool) else ""
    if not re.fullmatch(r"[0-9]{1,10}", digits) or int(digits) > last:
        raise InvalidValueError(what, expected=f"a whole number from 0 to {last}", found=repr(value))
    return int(digits)
