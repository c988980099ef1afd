"""Rigid motions over time: how the camera and the vehicles move.

World coordinates are in metres: x right, y down, z forward along the street, y = 0 on the road. A body
has the same axes, its origin on the ground. Poses are 4x4 matrices ``T_world_body`` that take body to world
coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kt3dmoseg.types import FloatArray

_CAMERA_HEIGHT = 1.65
_PITCH, _ROLL, _BOUNCE = 0.0035, 0.0025, 0.012  # radians, radians, metres: a car on its springs
_SWAY = 0.6  # metres; a body weaves about its straight path by at most twice this
_SLOWEST_WEAVE = 0.5  # radians per second


@dataclass(frozen=True)
class Drive:
    """Motion along a gentle weave: near time 0 a turn at a constant rate, in the long run straight on.

    Parameters
    ----------
    x, z : float
        Position at time 0, metres.
    yaw : float
        Heading at time 0, radians; 0 looks along +z, positive turns right.
    speed : float
        Metres per second along the heading at time 0.
    yaw_rate : float
        Radians per second at time 0.
    """

    x: float
    z: float
    yaw: float = 0.0
    speed: float = 0.0
    yaw_rate: float = 0.0

    def pose(self, time: float) -> FloatArray:
        """``T_world_body`` (4, 4) at `time` seconds.

        Sideways s(t) = v r / w^2 (1 - cos wt) and heading atan(r / w sin wt), the direction of travel, so
        that s'' (0) / v is the yaw rate r; w is chosen so that v r / w^2 stays within the lane.
        """
        weave = max(_SLOWEST_WEAVE, np.sqrt(self.speed * abs(self.yaw_rate) / _SWAY))
        aside = self.speed * self.yaw_rate / weave**2 * (1 - np.cos(weave * time))
        pose = np.eye(4)
        base = rotation_y(self.yaw)
        pose[:3, :3] = base @ rotation_y(np.arctan(self.yaw_rate / weave * np.sin(weave * time)))
        pose[:3, 3] = [self.x, 0.0, self.z] + base @ [aside, 0.0, self.speed * time]
        return pose


def camera_pose(drive: Drive, time: float, phase: float) -> FloatArray:
    """``T_world_cam`` (4, 4) of a camera mounted on a car that nods and rolls a little."""
    mount = np.eye(4)
    pitch, roll = _PITCH * np.sin(7.0 * time + phase), _ROLL * np.sin(5.0 * time + 2 * phase)
    mount[:3, :3] = _rotation_x(pitch) @ _rotation_z(roll)
    mount[1, 3] = -_CAMERA_HEIGHT + _BOUNCE * np.sin(9.0 * time + 3 * phase)
    return drive.pose(time) @ mount


def rotation_y(angle: float) -> FloatArray:
    """Rotate about the vertical axis: +z towards +x for a positive angle."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _rotation_x(angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _rotation_z(angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
