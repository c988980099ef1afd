"""A synthetic scene on disk, in the layout of KITTI raw."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime, timedelta
from pathlib import Path

import cv2
import numpy as np

from kt3dmoseg.errors import InputFileError, InvalidValueError
from kt3dmoseg.files import write_bytes, write_text
from kt3dmoseg.synthetic.options import FRAMES_PER_SECOND
from kt3dmoseg.synthetic.oxts import T_CAM_VELO, T_VELO_IMU, oxts_line
from kt3dmoseg.synthetic.scene import Scene
from kt3dmoseg.synthetic.tracklets import tracklet_xml
from kt3dmoseg.types import FloatArray

_START = "09:00:00.000000000"
_BASELINE = 0.54  # metres from camera 0 to camera 1


def write_drive(
    scene: Scene,
    root: str | os.PathLike[str],
    *,
    date: str = "2011_09_26",
    drive: int = 1,
    replace: bool = False,
) -> Path:
    """Render a scene into a drive of KITTI raw: camera 0, timestamps, poses, calibration and tracklets.

    Writes ``{date}/{date}_drive_{drive:04d}_sync/`` with ``image_00/data/%010d.png``, ``oxts/`` and
    ``tracklet_labels.xml``, and ``{date}/calib_*.txt``. The drive's folder appears complete or not at all.

    Parameters
    ----------
    scene : Scene
        What to render.
    root : path
        The KITTI raw root; created when missing.
    date : str
        ``YYYY_MM_DD``.
    drive : int
        0 to 9999.
    replace : bool
        Whether a drive of that name may be replaced.

    Returns
    -------
    Path
        The drive's folder.

    Raises
    ------
    InputFileError
        When the drive exists and may not be replaced, or nothing can be written.
    InvalidValueError
        When `date` or `drive` is malformed.
    """
    start = _start(date, drive)
    day = Path(root) / date
    target = day / f"{date}_drive_{drive:04d}_sync"
    if target.exists() and not replace:
        raise InputFileError(f"{target}: exists already", fix="remove it, or write another drive number")
    with _whole_folder(target) as folder:
        for frame in range(scene.n_frames):
            write_bytes(folder / "image_00" / "data" / f"{frame:010d}.png", _png(scene, frame))
            write_text(folder / "oxts" / "data" / f"{frame:010d}.txt", oxts_line(scene, frame))
        for sensor in ("image_00", "oxts"):
            write_text(folder / sensor / "timestamps.txt", _timestamps(start, scene.n_frames))
        write_text(folder / "tracklet_labels.xml", tracklet_xml(scene))
        _write_calibration(scene, day, start)
    return target


@contextmanager
def _whole_folder(target: Path) -> Iterator[Path]:
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(prefix=f".{target.name}.", suffix=".part", dir=target.parent))
    except OSError as error:
        raise InputFileError(
            f"{target}: {error.strerror or error}", fix="choose a folder you may write"
        ) from error
    try:
        fresh = work / "new"
        fresh.mkdir()
        yield fresh
        if target.exists():
            os.replace(target, work / "old")
        os.replace(fresh, target)
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _start(date: str, drive: int) -> datetime:
    if not 0 <= drive <= 9999:
        raise InvalidValueError("drive", expected="a number in 0..9999", found=str(drive))
    try:
        return datetime.strptime(f"{date} {_START[:-3]}", "%Y_%m_%d %H:%M:%S.%f")
    except ValueError:
        raise InvalidValueError("date", expected="YYYY_MM_DD", found=repr(date)) from None


def _png(scene: Scene, frame: int) -> bytes:
    return bytes(cv2.imencode(".png", scene.frame(frame))[1])


def _timestamps(start: datetime, frames: int) -> str:
    times = [start + timedelta(seconds=frame / FRAMES_PER_SECOND) for frame in range(frames)]
    return "".join(f"{time:%Y-%m-%d %H:%M:%S.%f}000\n" for time in times)


def _write_calibration(scene: Scene, day: Path, start: datetime) -> None:
    """Write the three files; the four cameras differ by their position along the baseline only."""
    stamp = f"calib_time: {start:%d-%b-%Y %H:%M:%S}\n"
    width, height = scene.image_size
    lines = [stamp, f"corner_dist: {_numbers(np.array([0.09950000]))}\n"]
    for camera, offset in enumerate((0.0, _BASELINE, 0.0, _BASELINE)):
        projection = np.hstack([scene.K, np.zeros((3, 1))])
        projection[0, 3] = -scene.K[0, 0] * offset
        shift = np.array([-offset, 0.0, 0.0])
        values = {"S": np.array([width, height]), "K": scene.K, "D": np.zeros(5), "R": np.eye(3), "T": shift}
        rectified = {"S_rect": values["S"], "R_rect": np.eye(3), "P_rect": projection}
        lines += [f"{key}_{camera:02d}: {_numbers(value)}\n" for key, value in (values | rectified).items()]
    write_text(day / "calib_cam_to_cam.txt", "".join(lines))
    for name, pose in (("velo_to_cam", T_CAM_VELO), ("imu_to_velo", T_VELO_IMU)):
        text = f"{stamp}R: {_numbers(pose[:3, :3])}\nT: {_numbers(pose[:3, 3])}\n"
        if name == "velo_to_cam":
            text += f"delta_f: {_numbers(np.zeros(2))}\ndelta_c: {_numbers(np.zeros(2))}\n"
        write_text(day / f"calib_{name}.txt", text)


def _numbers(values: FloatArray) -> str:
    return " ".join(f"{value:.9e}" for value in np.ravel(values))
