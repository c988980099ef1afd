"""A KITTI raw drive on disk, read by frame number.

pykitti parses calibration and GPS/IMU packets here. What it does by position in a sorted list, cuts to
microseconds or takes from another sensor's clock is read directly: frames and packets by their number,
the camera's own timestamps to the nanosecond.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kt3dmoseg.catalog.entries import Drive, check_camera, format_numbers
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.files import read_bytes
from kt3dmoseg.kitti import layout
from kt3dmoseg.kitti.calibration import Calibration
from kt3dmoseg.kitti.frames import read_frame
from kt3dmoseg.kitti.tracklets import Tracklet, TrackletBox, project_box, read_tracklets
from kt3dmoseg.types import ByteArray, FloatArray, IntArray

_FIX = "fetch it with kt3dmoseg pull, or give the folder that holds the day's folder"
_LARGEST_TEXT = 64 << 20
_TIME = re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d(\.\d{1,9})?")


class RawDrive:
    """One camera of a synchronised, rectified KITTI raw drive; nothing is read before it is asked for.

    Parameters
    ----------
    root : path
        The KITTI raw root: the folder that holds ``2011_09_26/2011_09_26_drive_0005_sync``.
    date : str
        Day of the recording, ``"2011_09_26"``.
    drive : int or str
        Number of the drive, 5 or ``"0005"``.
    camera : int
        0 gray left, 1 gray right, 2 colour left, 3 colour right.

    Raises
    ------
    InvalidValueError
        When date, drive or camera is not of KITTI's form.
    InputFileError
        When the drive's folder is missing; and from every reader, when its file is missing.
    FileFormatError
        From every reader, when its file does not hold what it promises.

    Notes
    -----
    A drive may be on disk in part: the frames of one clip are enough. Numbers are those of KITTI's
    file names, whatever else is there.
    """

    def __init__(
        self, root: str | os.PathLike[str], date: str, drive: int | str, camera: int | str = 0
    ) -> None:
        self.root = Path(root)
        self.drive = Drive(date, drive)  # type: ignore[arg-type]  # it converts "0005"
        self.camera = check_camera(camera)
        self.calibration = Calibration(self.root / date, self.camera)
        if not (self.root / layout.drive_folder(self.drive)).is_dir():
            raise InputFileError(f"{self.root / layout.drive_folder(self.drive)}: no such folder", fix=_FIX)

    def __repr__(self) -> str:
        """Name root, drive and camera."""
        return f"RawDrive({str(self.root)!r}, {self.drive.date!r}, {self.drive.number}, camera={self.camera})"

    @property
    def numbers(self) -> IntArray:
        """Numbers of the frames on disk, ascending, (n,) int64."""
        folder = self.root / layout.camera_folder(self.drive, self.camera) / "data"
        try:
            names = [entry.name for entry in os.scandir(folder)]
        except OSError as error:
            raise InputFileError(f"{folder}: {error.strerror or error}", fix=_FIX) from None
        return np.array(sorted(n for n in map(layout.frame_number, names) if n is not None), dtype=np.int64)

    def frame_path(self, number: int) -> Path:
        """Return the path of one frame.

        Raises
        ------
        InputFileError
            When that frame is not on disk; the message says which are.
        """
        path = self.root / layout.frame_file(self.drive, self.camera, number)
        if not path.is_file():
            raise InputFileError(
                f"{path}: no such frame",
                expected=f"a number on disk ({format_numbers(self.numbers) or 'none'})",
                found=str(number),
                fix="fetch it with kt3dmoseg pull",
            )
        return path

    def frame(self, number: int) -> ByteArray:
        """Read one frame: (H, W) uint8 for the gray cameras 0 and 1, (H, W, 3) uint8 RGB for 2 and 3."""
        return read_frame(self.frame_path(number))

    def datetimes(self, numbers: npt.ArrayLike) -> npt.NDArray[np.datetime64]:
        """Time at which the camera took each frame, (n,) datetime64[ns], KITTI's local clock.

        Parameters
        ----------
        numbers : (n,) int
            Frame numbers; line k of the camera's ``timestamps.txt`` (from 0) belongs to frame k.
        """
        return self._times(self._timestamp_lines(), _numbers(numbers))

    def timestamps(self, numbers: npt.ArrayLike) -> FloatArray:
        """Time at which the camera took each frame, (n,) float64 seconds since the drive's first.

        The origin is the first frame of the whole drive, also when it is not on disk, so that clips of
        one drive share a clock. Nanoseconds survive: a drive lasts minutes, float64 then resolves 1e-13 s.
        """
        lines = self._timestamp_lines()
        first = next((k for k, line in enumerate(lines) if line), 0)
        times = self._times(lines, np.concatenate([[first], _numbers(numbers)]))
        return np.asarray((times[1:] - times[0]).astype(np.int64) / 1e9)

    @property
    def K(self) -> FloatArray:
        """Intrinsics of the rectified camera in pixels, (3, 3) float64."""
        return self.calibration.K

    @property
    def T_cam_velo(self) -> FloatArray:
        """Laser scanner to rectified camera coordinates, metres, (4, 4) float64."""
        return self.calibration.T_cam_velo

    @property
    def T_cam_imu(self) -> FloatArray:
        """GPS/IMU to rectified camera coordinates, metres, (4, 4) float64."""
        return self.calibration.T_cam_imu

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height of the frames in pixels, from the calibration."""
        return self.calibration.image_size

    def poses(self, numbers: npt.ArrayLike) -> FloatArray:
        """Poses of the GPS/IMU unit, T_world_imu, (n, 4, 4) float64, metres.

        The world is east-north-up with its origin where the *first of* `numbers` was taken (pykitti's
        convention for the packets that it is given; Mercator scale of that packet's latitude).
        Camera poses are ``drive.poses(numbers) @ np.linalg.inv(drive.T_cam_imu)``.
        """
        from pykitti.utils import load_oxts_packets_and_poses

        paths = [self.root / layout.oxts_file(self.drive, int(k)) for k in _numbers(numbers)]
        for path in paths:
            if not path.is_file():
                raise InputFileError(f"{path}: no such file", fix=_FIX)
        try:
            packets = load_oxts_packets_and_poses(paths)
        except (TypeError, ValueError) as error:
            raise FileFormatError(
                str(paths[0].parent), expected="packets of 30 numbers", found=str(error)
            ) from None
        if len(packets) != len(paths):
            raise FileFormatError(
                str(paths[0].parent), expected=f"{len(paths)} packets, one per file", found=f"{len(packets)}"
            )
        return np.array([packet.T_w_imu for packet in packets], dtype=np.float64).reshape(-1, 4, 4)

    @property
    def has_tracklets(self) -> bool:
        """Whether the drive's tracklet labels are on disk; KITTI has none for many drives."""
        return (self.root / layout.tracklet_file(self.drive)).is_file()

    def tracklets(self) -> list[Tracklet]:
        """Read the labelled 3D boxes of the drive."""
        path = self.root / layout.tracklet_file(self.drive)
        if not self.has_tracklets:
            raise InputFileError(f"{path}: no such file", fix="KITTI has tracklets for some drives only")
        return read_tracklets(path)

    def tracklet_boxes(self, number: int, tracklets: Iterable[Tracklet] | None = None) -> list[TrackletBox]:
        """Project the tracklets of one frame to boxes in the camera's image.

        Parameters
        ----------
        number : int
            Frame number.
        tracklets : iterable of Tracklet, optional
            What `tracklets` returned, to read the file once for many frames.

        Returns
        -------
        list of TrackletBox
            Only boxes with a part in view, nearest first.
        """
        K, T, size = self.K, self.T_cam_velo, self.image_size
        boxes = []
        for index, tracklet in enumerate(self.tracklets() if tracklets is None else tracklets):
            if number not in tracklet.numbers:
                continue
            row, corners = tracklet.row(number), tracklet.corners(number)
            box = project_box(corners, K, T, size)
            if box is not None:
                depth = float((T[:3, :3] @ corners.mean(axis=0) + T[:3, 3])[2])
                flags = int(tracklet.occlusion[row]), int(tracklet.truncation[row])
                boxes.append(TrackletBox(index, tracklet.kind, box, depth, *flags))
        return sorted(boxes, key=lambda box: box.depth)

    @property
    def _timestamp_file(self) -> Path:
        return self.root / layout.camera_folder(self.drive, self.camera) / layout.TIMESTAMP_FILE

    def _timestamp_lines(self) -> list[str]:
        text = read_bytes(self._timestamp_file, _LARGEST_TEXT).decode(errors="replace")
        return [line.strip() for line in text.splitlines()]

    def _times(self, lines: list[str], numbers: IntArray) -> npt.NDArray[np.datetime64]:
        path = self._timestamp_file
        if numbers.size and numbers.max() >= len(lines):
            raise InvalidValueError(
                f"{path}: frame {numbers.max()}",
                expected=f"one of the file's {len(lines)} lines, counted from 0",
                found=str(numbers.max()),
            )
        return np.array([_time(lines[k], f"{path}: line {k + 1}") for k in numbers], dtype="datetime64[ns]")


def _time(line: str, where: str) -> np.datetime64:
    if not _TIME.fullmatch(line):
        raise FileFormatError(where, expected="a time like 2011-09-26 13:02:25.964389445", found=repr(line))
    try:
        return np.datetime64(line.replace(" ", "T"), "ns")
    except ValueError as error:
        raise FileFormatError(where, found=str(error)) from None


def _numbers(numbers: npt.ArrayLike) -> IntArray:
    wanted = np.atleast_1d(np.asarray(numbers))
    if wanted.size and not (np.issubdtype(wanted.dtype, np.integer) and wanted.min() >= 0):
        raise InvalidValueError("numbers", expected="frame numbers >= 0", found=str(wanted.tolist())[:80])
    return wanted.astype(np.int64).ravel()
