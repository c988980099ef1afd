"""Tiny KITTI raw drives written by the tests, with numbers that can be checked by hand."""

from __future__ import annotations

import zipfile
from pathlib import Path

import cv2
import numpy as np

DATE, DRIVE = "2011_09_26", 5
NAME = f"{DATE}_drive_{DRIVE:04d}"
FOCAL, CX, CY, SIZE = 100.0, 31.5, 23.5, (64, 48)

_R = "0 -1 0 0 0 -1 1 0 0"  # x forward, y left, z up to x right, y down, z forward
CALIBRATION = {
    "calib_cam_to_cam.txt": "calib_time: 09-Jan-2012 13:57:47\ncorner_dist: 9.950000e-02\n"
    + "".join(
        f"S_rect_0{c}: {SIZE[0]} {SIZE[1]}\nR_rect_0{c}: 1 0 0 0 1 0 0 0 1\n"
        f"P_rect_0{c}: {FOCAL} 0 {CX} {-FOCAL * 0.5 * (c % 2)} 0 {FOCAL} {CY} 0 0 0 1 0\n"
        for c in range(4)
    ),
    "calib_velo_to_cam.txt": f"calib_time: 15-Mar-2012 11:37:16\nR: {_R}\nT: 0 -0.25 -0.5\n",
    "calib_imu_to_velo.txt": "calib_time: 25-May-2012 16:47:16\nR: 1 0 0 0 1 0 0 0 1\nT: -1 0.5 -0.75\n",
}
TRACKLETS = """<?xml version="1.0" encoding="UTF-8" standalone="yes" ?>
<!DOCTYPE boost_serialization>
<boost_serialization signature="serialization::archive" version="9">
<tracklets class_id="0" tracking_level="0" version="0">
<count>1</count><item_version>1</item_version>
<item class_id="1" tracking_level="0" version="1">
<objectType>Car</objectType><h>1.5</h><w>2.0</w><l>4.0</l><first_frame>{first}</first_frame>
<poses class_id="2" tracking_level="0" version="0"><count>{n}</count><item_version>2</item_version>
{poses}</poses>
<finished>1</finished></item></tracklets></boost_serialization>
"""
POSE = (
    "<item><tx>{x}</tx><ty>{y}</ty><tz>-1.0</tz><rx>0</rx><ry>0</ry><rz>{rz}</rz><state>2</state>"
    "<occlusion>0</occlusion><occlusion_kf>0</occlusion_kf><truncation>1</truncation></item>"
)


def picture(number: int, *, size: tuple[int, int] = SIZE, seed: int = 0) -> np.ndarray:
    """A noise picture that no other number has; noise, so that PNG cannot shrink it."""
    rng = np.random.default_rng([seed, number])
    return rng.integers(0, 256, (size[1], size[0]), dtype=np.uint8)


def encode(image: np.ndarray, level: int = 3) -> bytes:
    return cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, level])[1].tobytes()


def timestamps(n: int) -> str:
    return "".join(f"2011-09-26 13:02:{25 + k // 10:02d}.{k % 10}00000{k:03d}\n" for k in range(n))


def packet(number: int) -> str:
    latitude, longitude = 49.0, 8.4 + number * 1e-5
    return f"{latitude} {longitude} 112.5 0.0 0.0 0.0 " + " ".join(["0.5"] * 19) + " 4 9 4 4 0\n"


def tracklets(first: int, positions: list[tuple[float, float, float]]) -> str:
    poses = "".join(POSE.format(x=x, y=y, rz=rz) for x, y, rz in positions)
    return TRACKLETS.format(first=first, n=len(positions), poses=poses)


def drive_files(
    frames: dict[int, bytes], n: int, camera: int = 0, drive: int = DRIVE, date: str = DATE
) -> dict[str, bytes]:
    """Return the files of a `_sync.zip`: the frames of one camera, timestamps and oxts of `n` frames."""
    folder = f"{date}/{date}_drive_{drive:04d}_sync"
    files = {f"{folder}/image_0{camera}/timestamps.txt": timestamps(n).encode()}
    for number, content in sorted(frames.items()):
        files[f"{folder}/image_0{camera}/data/{number:010d}.png"] = content
    files[f"{folder}/oxts/timestamps.txt"] = timestamps(n).encode()
    files |= {f"{folder}/oxts/data/{k:010d}.txt": packet(k).encode() for k in range(n)}
    return files


def calibration_files(date: str = DATE) -> dict[str, bytes]:
    return {f"{date}/{name}": text.encode() for name, text in CALIBRATION.items()}


def write_files(root: Path, files: dict[str, bytes]) -> Path:
    for name, content in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return root


def write_zip(path: Path, files: dict[str, bytes], *, method: int = zipfile.ZIP_DEFLATED) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w", method, compresslevel=1) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path
