"""Poses of the car as KITTI's GPS/IMU packets, and the rigid transforms between its sensors."""

from __future__ import annotations

import numpy as np

from kt3dmoseg.synthetic.options import FRAMES_PER_SECOND
from kt3dmoseg.synthetic.scene import Scene
from kt3dmoseg.types import FloatArray

_EARTH_RADIUS = 6378137.0
_ORIGIN = 49.0, 8.4, 115.0  # latitude, longitude (degrees), altitude (metres) of the world's origin
_SCALE = np.cos(np.radians(_ORIGIN[0]))

# Velodyne and IMU: x forward, y left, z up. Distances are those of KITTI's car, angles are exact.
T_CAM_VELO = np.array(
    [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, -0.08], [1.0, 0.0, 0.0, -0.27], [0.0, 0.0, 0.0, 1.0]]
)
T_VELO_IMU = np.array(
    [[1.0, 0.0, 0.0, -0.81], [0.0, 1.0, 0.0, 0.32], [0.0, 0.0, 1.0, -0.80], [0.0, 0.0, 0.0, 1.0]]
)
# East, north, up from the scene's world (x right, y down, z forward): the street runs north.
_ENU_WORLD = np.array(
    [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)


def imu_pose(scene: Scene, frame: int) -> FloatArray:
    """``T_enu_imu`` (4, 4): pose of the IMU in metres east, north and up of the scene's origin."""
    pose: FloatArray = _ENU_WORLD @ scene.camera_pose(frame) @ T_CAM_VELO @ T_VELO_IMU
    return pose


def oxts_line(scene: Scene, frame: int) -> str:
    """One packet of 30 values, in the order of KITTI's ``dataformat.txt``.

    Position and attitude are exact; latitude and longitude by the Mercator projection of the development
    kit, with the scale of the first frame's latitude, so that readers get the metres back. Velocities and
    turn rates are central differences; of the accelerations only gravity is filled in.
    """
    pose = imu_pose(scene, frame)
    first_north = imu_pose(scene, 0)[1, 3]
    latitude = _latitude(pose[1, 3] - first_north, _ORIGIN[0])
    longitude = _ORIGIN[1] + np.degrees(pose[0, 3] / (_SCALE * _EARTH_RADIUS))
    before, after = max(frame - 1, 0), min(frame + 1, scene.n_frames - 1)
    seconds = max(after - before, 1) / FRAMES_PER_SECOND
    step = np.linalg.inv(imu_pose(scene, before)) @ imu_pose(scene, after)
    velocity = pose[:3, :3].T @ (imu_pose(scene, after) - imu_pose(scene, before))[:3, 3] / seconds
    north_east = (pose[:3, :3] @ velocity)[[1, 0]]
    rates = np.array(_roll_pitch_yaw(step)) / seconds
    gravity = pose[:3, :3].T @ [0.0, 0.0, 9.81]
    values = [
        *(latitude, longitude, _ORIGIN[2] + pose[2, 3]),
        *_roll_pitch_yaw(pose),
        *north_east,
        *velocity,
        *gravity,  # along the body's axes,
        *gravity,  # and forward, leftward, upward: the same here
        *rates,
        *rates,
        *(0.05, 0.02),
    ]
    return " ".join(f"{value:.14g}" for value in values) + " 4 9 4 4 0\n"


def _latitude(north: float, origin: float) -> float:
    """Invert y = s R ln tan(pi (90 + latitude) / 360), from metres north of the latitude `origin`."""
    start = np.log(np.tan((90 + origin) * np.pi / 360))
    return float(360 / np.pi * np.arctan(np.exp(start + north / (_SCALE * _EARTH_RADIUS))) - 90)


def _roll_pitch_yaw(pose: FloatArray) -> tuple[float, float, float]:
    """Angles with R = Rz(yaw) Ry(pitch) Rx(roll)."""
    rotation = pose[:3, :3]
    roll = np.arctan2(rotation[2, 1], rotation[2, 2])
    pitch = np.arcsin(np.clip(-rotation[2, 0], -1, 1))
    return float(roll), float(pitch), float(np.arctan2(rotation[1, 0], rotation[0, 0]))
