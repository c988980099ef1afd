"""Synthetic drives: rigid street scenes with moving vehicles, rendered, with exact ground truth.

A pinhole camera on a car drives along a street of textured boxes. Frames are ray-cast in numpy; optical flow,
visibility, depth, trajectories and labels come from the same geometry and are exact.

>>> scene = make_scene(SceneOptions(width=128, height=64, frames=2, objects=1))
>>> scene.frame(0).shape
(64, 128)
"""

from kt3dmoseg.synthetic.drives import DrivePlan, make_drive, measure_drive, plan_drives
from kt3dmoseg.synthetic.kitti_export import write_drive
from kt3dmoseg.synthetic.scene import Scene, SceneOptions, make_scene, track_errors

ALGORITHM_VERSION = 2
"""Raised when the same options or plan give another scene, other pictures or other figures."""

__all__ = [
    "DrivePlan",
    "Scene",
    "SceneOptions",
    "make_drive",
    "make_scene",
    "measure_drive",
    "plan_drives",
    "track_errors",
    "write_drive",
]
