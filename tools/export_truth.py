"""Write a synthetic drive as KITTI raw, KITTI 2015 scene flow, and KITTI tracking with MOTS masks.

Usage: python tools/export_truth.py OUT [--seed 0] [--frames 12] [--width 1242] [--height 375] [--objects 3]

OUT/raw is a KITTI raw root with drive 2011_09_26_0001 and camera 0; OUT/sceneflow/training holds picture
000000 (raw frame `frames // 2`) of camera 2 with its multi-view frames, flow, disparity and object map;
OUT/tracking/training holds sequence 0000. Camera 2 is 6 cm to the left of camera 0 and camera 3 47 cm to its
right, as on KITTI's car. Everything is exact up to the files' rounding.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from kt3dmoseg.files import write_bytes, write_text
from kt3dmoseg.io.flow_files import write_flow
from kt3dmoseg.synthetic import Scene, SceneOptions, write_drive
from kt3dmoseg.synthetic.kitti_export import T_CAM_VELO, T_VELO_IMU
from kt3dmoseg.types import FloatArray

LEFT, RIGHT = -0.0622, 0.4704  # metres of cameras 2 and 3 to the right of camera 0
AROUND = 10  # multi-view frames before and after
KINDS = {"car": 1, "van": 1, "truck": 1, "pedestrian": 2, "cyclist": 2}  # classes of MOTS


class SideCamera(Scene):
    """The same scene, seen from a camera beside camera 0."""

    beside = LEFT

    def camera_pose(self, frame: int) -> FloatArray:
        """``T_world_cam`` (4, 4) of the camera beside camera 0."""
        aside = np.eye(4)
        aside[0, 3] = self.beside
        return super().camera_pose(frame) @ aside


def picture(path: Path, values: np.ndarray) -> None:
    write_bytes(path, cv2.imencode(".png", values)[1].tobytes())


def numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.9e}" for value in np.ravel(values))


def projections(scene: Scene) -> dict[str, FloatArray]:
    """P_rect of the four cameras (3, 4)."""
    places = {"0": 0.0, "1": 0.54, "2": LEFT, "3": RIGHT}
    return {k: np.hstack([scene.K, [[-scene.K[0, 0] * x], [0.0], [0.0]]]) for k, x in places.items()}


def disparity(scene: Scene, depth: FloatArray) -> np.ndarray:
    """Disparity between cameras 2 and 3 as KITTI writes it, uint16; 0 where there is none."""
    return np.rint(256 * scene.K[0, 0] * (RIGHT - LEFT) / depth).astype(np.uint16)


def write_sceneflow(scene: Scene, training: Path) -> None:
    at = scene.n_frames // 2
    for frame in range(max(0, at - AROUND), min(scene.n_frames, at + AROUND + 1)):
        gray = scene.frame(frame)
        picture(training / "image_2" / f"000000_{frame - at + AROUND:02d}.png", np.dstack([gray] * 3))
    flow, seen = scene.flow(at, at + 1)
    depth, ids = scene.depth(at), scene.ids(at)
    known = np.isfinite(depth)
    inside = known & (np.abs(flow) < 500).all(axis=2)
    write_flow(training / "flow_occ" / "000000_10.png", np.where(inside[..., None], flow, np.nan))
    write_flow(training / "flow_noc" / "000000_10.png", np.where((inside & seen)[..., None], flow, np.nan))
    picture(training / "disp_occ_0" / "000000_10.png", np.where(known, disparity(scene, depth), 0))
    picture(training / "disp_occ_1" / "000000_10.png", np.where(known, disparity(scene, later(scene, at)), 0))
    picture(training / "obj_map" / "000000_10.png", np.where(ids > 1, ids - 1, 0).astype(np.uint8))
    lines = [f"P_rect_0{k}: {numbers(P)}\n" for k, P in projections(scene).items()]
    write_text(training / "calib_cam_to_cam" / "000000.txt", "".join(lines))


def later(scene: Scene, at: int) -> FloatArray:
    """Depth in frame `at + 1` of the points at the pixel centres of `at`, (H, W)."""
    width, height = scene.image_size
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    points, body = scene.surface_points(np.c_[x.ravel(), y.ravel(), np.full(x.size, at)])
    poses = scene.body_poses(at + 1)
    z = np.einsum("nj,nj->n", points, poses[body, 2])
    with np.errstate(divide="ignore"):
        return np.where(points[:, 3] > 0, z / np.maximum(points[:, 3], 1e-12), np.inf).reshape(height, width)


def write_tracking(front: Scene, side: Scene, training: Path) -> None:
    """Boxes in camera 0, pictures and masks of camera 2, poses and calibration."""
    from kt3dmoseg.synthetic.kitti_export import _oxts_line  # the packet of KITTI raw, the same here

    lines, packets = [], []
    for frame in range(front.n_frames):
        picture(training / "image_02" / "0000" / f"{frame:06d}.png", np.dstack([side.frame(frame)] * 3))
        ids = side.ids(frame).astype(np.uint16)
        masks = np.zeros_like(ids)
        for k, vehicle in enumerate(side.vehicles):
            masks[ids == k + 2] = 1000 * KINDS[vehicle.kind] + k
        picture(training / "instances" / "0000" / f"{frame:06d}.png", masks)
        packets.append(_oxts_line(front, frame))
        for k, (vehicle, pose) in enumerate(zip(front.vehicles, front.body_poses(frame)[1:], strict=True)):
            width, height, length = vehicle.size
            yaw = np.arctan2(-pose[2, 2], pose[0, 2])  # about y, 0 when the object faces to the right
            shape = f"{height:.6f} {width:.6f} {length:.6f}"
            place = " ".join(f"{value:.6f}" for value in pose[:3, 3])
            kind = vehicle.kind.capitalize()
            lines.append(f"{frame} {k} {kind} 0 0 0.0 0 0 0 0 {shape} {place} {yaw:.6f}\n")
    write_text(training / "label_02" / "0000.txt", "".join(lines))
    write_text(training / "oxts" / "0000.txt", "".join(packets))
    calibration = [f"P{k}: {numbers(P)}\n" for k, P in projections(front).items()]
    calibration.append(f"R_rect {numbers(np.eye(3))}\n")
    calibration.append(f"Tr_velo_cam {numbers(T_CAM_VELO[:3])}\nTr_imu_velo {numbers(T_VELO_IMU[:3])}\n")
    write_text(training / "calib" / "0000.txt", "".join(calibration))


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path)
    defaults = {"seed": 0, "frames": 12, "width": 1242, "height": 375, "objects": 3, "samples": 2}
    for name, value in defaults.items():
        parser.add_argument(f"--{name}", type=int, default=value)
    given = vars(parser.parse_args(argv))
    out = given.pop("out")
    options = SceneOptions(**given)
    front, side = Scene(options), SideCamera(options)
    write_drive(front, out / "raw")
    write_sceneflow(side, out / "sceneflow" / "training")
    write_tracking(front, side, out / "tracking" / "training")
    return 0


if __name__ == "__main__":
    sys.exit(main())
