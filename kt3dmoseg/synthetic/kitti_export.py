"""A synthetic scene on disk, in the layout of KITTI raw: frames, GPS/IMU packets, tracklets, calibration."""

import os
import tempfile
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from kt3dmoseg.catalog import Drive
from kt3dmoseg.errors import InputFileError
from kt3dmoseg.files import PathLike, check_writable, write_text
from kt3dmoseg.io.images import write_png
from kt3dmoseg.synthetic.scene import FRAMES_PER_SECOND, Scene
from kt3dmoseg.types import FloatArray

_BASELINE = 0.54  # metres from camera 0 to camera 1
_EARTH_RADIUS = 6378137.0
_ORIGIN = 49.0, 8.4, 115.0  # latitude, longitude (degrees), altitude (metres) of the world's origin
_SCALE = np.cos(np.radians(_ORIGIN[0]))
_LAST = 0.0, 0.0, 0.0, 1.0
# Velodyne and IMU: x forward, y left, z up. Distances are those of KITTI's car, angles are exact.
T_CAM_VELO = np.array([(0.0, -1.0, 0.0, 0.0), (0.0, 0.0, -1.0, -0.08), (1.0, 0.0, 0.0, -0.27), _LAST])
T_VELO_IMU = np.array([(1.0, 0.0, 0.0, -0.81), (0.0, 1.0, 0.0, 0.32), (0.0, 0.0, 1.0, -0.80), _LAST])
# East, north, up from the scene's world (x right, y down, z forward): the street runs north.
_ENU_WORLD = np.array([(1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, -1.0, 0.0, 0.0), _LAST])
# A tracklet's box has its origin on the ground: x is the vehicle's forward (z), y its left (-x), z up (-y).
_BODY_BOX = np.array([(0.0, -1.0, 0.0, 0.0), (0.0, 0.0, -1.0, 0.0), (1.0, 0.0, 0.0, 0.0), _LAST])

_XML = """<?xml version="1.0" encoding="UTF-8" standalone="yes" ?>
<!DOCTYPE boost_serialization>
<boost_serialization signature="serialization::archive" version="9">
<tracklets class_id="0" tracking_level="0" version="0">
<count>{}</count><item_version>1</item_version>
{}</tracklets>
</boost_serialization>
"""
_TRACKLET = """<item class_id="1" tracking_level="0" version="1">
<objectType>{}</objectType>
<h>{}</h><w>{}</w><l>{}</l>
<first_frame>0</first_frame>
<poses class_id="2" tracking_level="0" version="0">
<count>{}</count><item_version>2</item_version>
{}</poses>
<finished>1</finished>
</item>
"""
_POSE = (
    '<item class_id="3" tracking_level="0" version="2">'
    "<tx>{:.6f}</tx><ty>{:.6f}</ty><tz>{:.6f}</tz><rx>0</rx><ry>0</ry><rz>{:.6f}</rz>"
    "<state>2</state><occlusion>0</occlusion><occlusion_kf>0</occlusion_kf><truncation>0</truncation>"
    "<amt_occlusion>-1</amt_occlusion><amt_occlusion_kf>-1</amt_occlusion_kf>"
    "<amt_border_l>-1</amt_border_l><amt_border_r>-1</amt_border_r><amt_border_kf>-1</amt_border_kf></item>\n"
)


def write_drive(scene: Scene, root: PathLike, *, date: str = "2011_09_26", drive: int = 1) -> Path:
    """Render a scene into a drive of KITTI raw: camera 0, timestamps, poses, calibration and tracklets.

    Below `root` it writes ``{date}/{date}_drive_{drive:04d}_sync/`` with ``image_00/data/%010d.png``,
    ``oxts/`` and ``tracklet_labels.xml``, and ``{date}/calib_*.txt``. The drive's folder, which is returned,
    appears complete or not at all. InputFileError when it exists, nothing can be written, or the day has
    another calibration, InvalidValueError when `date`, YYYY_MM_DD, or `drive`, 0 to 9999, is malformed.
    """
    target = Path(root) / Drive(date, drive).folder
    start = datetime.strptime(f"{date} 09", "%Y_%m_%d %H")
    if target.exists():
        raise InputFileError(f"{target}: exists already", fix="remove it, or write another drive number")
    calibration = {target.parent / name: text for name, text in _calibration(scene, start).items()}
    for path, text in calibration.items():
        if path.exists() and path.read_text() != text:  # by which the other drives of the day are read
            expected, fix = "the calibration of this scene", "write another date, or to another folder"
            raise InputFileError(f"{path}", expected=expected, found="another", fix=fix)
    check_writable(target.parent)
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{target.name}.", suffix=".part", dir=target.parent) as work:
        _write_files(scene, Path(work, "new"), start)
        for path, text in calibration.items():
            write_text(path, text)
        os.replace(Path(work, "new"), target)
    return target


def _write_files(scene: Scene, folder: Path, start: datetime) -> None:
    for frame in range(scene.n_frames):
        write_png(folder / "image_00" / "data" / f"{frame:010d}.png", scene.frame(frame))
        write_text(folder / "oxts" / "data" / f"{frame:010d}.txt", _oxts_line(scene, frame))
    times = [start + timedelta(seconds=frame / FRAMES_PER_SECOND) for frame in range(scene.n_frames)]
    for sensor in ("image_00", "oxts"):
        lines = [f"{time:%Y-%m-%d %H:%M:%S.%f}000\n" for time in times]
        write_text(folder / sensor / "timestamps.txt", "".join(lines))
    write_text(folder / "tracklet_labels.xml", _tracklet_xml(scene))


def _calibration(scene: Scene, start: datetime) -> dict[str, str]:
    """Three files by their names; the four cameras differ by their position along the baseline only."""
    stamp = f"calib_time: {start:%d-%b-%Y %H:%M:%S}\n"
    lines = [stamp, f"corner_dist: {_numbers(0.0995)}\n"]
    for camera, offset in enumerate((0.0, _BASELINE, 0.0, _BASELINE)):
        projection = np.hstack([scene.K, np.zeros((3, 1))])
        projection[0, 3] = -scene.K[0, 0] * offset
        size, shift = np.array(scene.image_size), np.array([-offset, 0.0, 0.0])
        values = {"S": size, "K": scene.K, "D": np.zeros(5), "R": np.eye(3), "T": shift}
        rectified = {"S_rect": size, "R_rect": np.eye(3), "P_rect": projection}
        lines += [f"{key}_{camera:02d}: {_numbers(value)}\n" for key, value in (values | rectified).items()]
    found = {"calib_cam_to_cam.txt": "".join(lines)}
    none = f"delta_f: {_numbers(np.zeros(2))}\ndelta_c: {_numbers(np.zeros(2))}\n"
    for name, T, distortion in (("velo_to_cam", T_CAM_VELO, none), ("imu_to_velo", T_VELO_IMU, "")):
        text = f"{stamp}R: {_numbers(T[:3, :3])}\nT: {_numbers(T[:3, 3])}\n{distortion}"
        found[f"calib_{name}.txt"] = text
    return found


def _numbers(values: FloatArray | float) -> str:
    return " ".join(f"{value:.9e}" for value in np.ravel(values))


def _imu_pose(scene: Scene, frame: int) -> FloatArray:
    """``T_enu_imu`` (4, 4): pose of the IMU in metres east, north and up of the scene's origin."""
    return np.asarray(_ENU_WORLD @ scene.camera_pose(frame) @ T_CAM_VELO @ T_VELO_IMU)


def _oxts_line(scene: Scene, frame: int) -> str:
    """One packet of 30 values, in the order of KITTI's ``dataformat.txt``.

    Latitude and longitude are by the Mercator projection of the development kit, with the scale of the first
    frame's latitude, so that readers get the metres back. Velocities and turn rates are central differences.
    """
    pose, first_north = _imu_pose(scene, frame), _imu_pose(scene, 0)[1, 3]
    # Invert y = s R ln tan(pi (90 + latitude) / 360).
    origin = np.log(np.tan((90 + _ORIGIN[0]) * np.pi / 360))
    north = (pose[1, 3] - first_north) / (_SCALE * _EARTH_RADIUS)
    latitude = float(360 / np.pi * np.arctan(np.exp(origin + north)) - 90)
    longitude = _ORIGIN[1] + np.degrees(pose[0, 3] / (_SCALE * _EARTH_RADIUS))
    ends = max(frame - 1, 0), min(frame + 1, scene.n_frames - 1)
    before, after = (_imu_pose(scene, k) for k in ends)
    seconds = max(ends[1] - ends[0], 1) / FRAMES_PER_SECOND
    angles, rates = _roll_pitch_yaw(pose), _roll_pitch_yaw(np.linalg.inv(before) @ after) / seconds
    to_body = pose[:3, :3].T
    velocity, gravity = to_body @ (after - before)[:3, 3] / seconds, to_body @ [0.0, 0.0, 9.81]
    place, north_east = (latitude, longitude, _ORIGIN[2] + pose[2, 3]), (to_body.T @ velocity)[[1, 0]]
    # Accelerations and turn rates along the body's axes, and forward, leftward, upward: the same here.
    twice = gravity, gravity, rates, rates
    values = np.concatenate([place, angles, north_east, velocity, *twice, (0.05, 0.02)])
    return " ".join(f"{value:.14g}" for value in values) + " 4 9 4 4 0\n"


def _roll_pitch_yaw(pose: FloatArray) -> FloatArray:
    """Angles (3,) with R = Rz(yaw) Ry(pitch) Rx(roll)."""
    return np.asarray(Rotation.from_matrix(pose[:3, :3]).as_euler("ZYX")[::-1])


def _tracklet_xml(scene: Scene) -> str:
    """One tracklet over all frames per moving vehicle: 3D boxes in Velodyne coordinates.

    As in KITTI only the rotation about the vertical is kept; the camera's nod, under half a degree, is lost.
    """
    poses = np.stack([scene.body_poses(frame)[1:] for frame in range(scene.n_frames)], axis=1)
    items = ""
    for vehicle, boxes in zip(scene.vehicles, np.linalg.inv(T_CAM_VELO) @ poses @ _BODY_BOX, strict=True):
        width, height, length = vehicle.size
        lines = [_POSE.format(*box[:3, 3], np.arctan2(box[1, 0], box[0, 0])) for box in boxes]
        kind = vehicle.kind.capitalize()
        items += _TRACKLET.format(kind, height, width, length, len(lines), "".join(lines))
    return _XML.format(len(scene.vehicles), items)
