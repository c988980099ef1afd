"""Score tracks and labels of clips against truth that nobody here made, from your own copy of KITTI.

Usage: python tools/truth.py sceneflow CLIP... --kitti TRAINING --drive 2011_09_26_0005 [--index FRAME=NUMBER]
       python tools/truth.py pairs NUMBER... --kitti TRAINING
       python tools/truth.py tracking CLIP... --kitti TRAINING --sequence 0000 [--start 0]
       python tools/truth.py tracklets CLIP... --kitti RAW_ROOT --drive 2011_09_26_0005

CLIP is a clip file of camera 0 (image_00) whose frame numbers are those of the KITTI raw drive.

sceneflow: KITTI 2015 scene flow (flow, disparity, object maps). Its truth belongs to camera 2; the disparity
takes every point to camera 0. Printed: end-point error over one frame, share within 1 px, and how far the
labels agree with the object map, by object, size and distance. The map marks moving cars and vans only.
pairs: the tracker alone, run on the multi-view frames of camera 2 of these pictures (0, 1, ... 199).
tracking: labels of KITTI tracking; with `instances/` beside `label_02/` the masks of KITTI MOTS as well.
tracklets: the 3D boxes of KITTI raw. In both a box moves when its centre travels more than 1 m over the
clip's frames, in the world of the GPS/IMU poses: boxes of parked cars wander by up to that much.
A trajectory belongs to an object when it lies in it in more than half of the frames where it is visible, and
to the static scene when it never does; others are not counted. Without masks "in it" means in the
middle half (each way) of the projected box, and "never" in no part of it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from pykitti.utils import load_oxts_packets_and_poses, read_calib_file
from scipy.spatial import cKDTree
from tqdm import tqdm

from kt3dmoseg import load
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.io.flow_files import read_flow
from kt3dmoseg.io.images import read_frames, read_picture
from kt3dmoseg.kitti import RawDrive
from kt3dmoseg.kitti.tracklets import project_box
from kt3dmoseg.text import text_table
from kt3dmoseg.tracking import track
from kt3dmoseg.types import BoolArray, Clip, FloatArray, IntArray, Trajectories

REACH = 0.75  # pixels from a trajectory to the truth point that it is compared with
TRAVEL = 1.0  # metres: what travels more in the world moves
MIDDLE = 0.5  # share of a box, each way, that surely is on the object
UNSURE = -1
SIZES = {"px": (0, 1000, 10000, np.inf), "tracks": (0, 16, 64, 256, np.inf)}
DISTANCES = 0, 10, 20, 40, np.inf
# KITTI 2015 scene flow: raw frame -> index of the picture NNNNNN_10.png, of the clips' drives.
INDEX: dict[str, dict[int, int]] = {
    "2011_09_26_0005": {10: 2, 59: 3},
    "2011_09_26_0009": {354: 7, 364: 8, 374: 9, 384: 10, 394: 11, 414: 12},
    "2011_09_26_0011": {111: 13, 127: 14, 147: 15, 157: 16, 167: 17},
    "2011_09_26_0013": {10: 18, 20: 19, 40: 20, 70: 21},
    "2011_09_26_0028": {71: 62, 118: 63, 228: 64, 269: 65, 284: 66, 303: 67, 313: 68, 378: 69},
    "2011_09_26_0059": {
        26: 118, 46: 119, 137: 120, 150: 121, 260: 122,
        280: 123, 290: 124, 300: 125, 310: 126, 320: 127,
    },
    "2011_09_26_0070": {69: 128, 224: 129},
    "2011_09_26_0084": {84: 130, 179: 131, 238: 132},
    "2011_09_29_0071": {59: 168, 943: 169},
}  # fmt: skip


@dataclass(frozen=True)
class Surface:
    """Surface points that one frame shows: `xy` and `moved`, where they are a frame later (n, 2); m; ids."""

    xy: FloatArray
    moved: FloatArray
    depth: FloatArray
    ids: IntArray


@dataclass
class Found:
    """What is known of trajectories, one value each: its object, what that is like, its error and label."""

    unit: str = "px"  # of `size`
    object: list[str] = field(default_factory=list)
    size: list[float] = field(default_factory=list)
    distance: list[float] = field(default_factory=list)
    moves: list[bool] = field(default_factory=list)
    labelled: list[float] = field(default_factory=list)  # 1 a motion, 0 the background, NaN not labelled
    error: list[float] = field(default_factory=list)


# --- KITTI 2015 scene flow


def surface(training: Path, index: int, camera: int = 0) -> Surface:
    """Read the truth of a picture pair, which is that of camera 2, and take it to another camera."""
    name = f"{index:06d}"
    flow = read_flow(training / "flow_occ" / f"{name}_10.png")
    depths = [disparity(training / f"disp_occ_{k}" / f"{name}_10.png", flow.shape[:2]) for k in (0, 1)]
    ids = picture(training / "obj_map" / f"{name}_10.png", flow.shape[:2])
    calibration = read_calib_file(training / "calib_cam_to_cam" / f"{name}.txt")
    P, P2, P3 = (calibration[f"P_rect_0{k}"].reshape(3, 4) for k in (camera, 2, 3))
    y, x = np.nonzero(np.isfinite(flow).all(axis=2) & (depths[0] > 0) & (depths[1] > 0))
    before = np.stack([x, y], axis=1).astype(np.float64)
    places, far = [], []
    for at, seen in ((before, depths[0]), (before + flow[y, x], depths[1])):
        z = (P2[0, 3] - P3[0, 3]) / seen[y, x]
        rays = np.linalg.solve(P2[:, :3], np.c_[at, np.ones(len(at))].T * z - P2[:, 3:])
        image = P[:, :3] @ rays + P[:, 3:]
        places.append((image[:2] / image[2]).T)
        far.append(image[2])
    return Surface(places[0], places[1], far[0], ids[y, x].astype(np.int64))


def picture(path: Path, shape: tuple[int, ...]) -> FloatArray:
    """Read a map of the size of the flow."""
    if not path.is_file():
        raise InputFileError(f"{path}: no such file", fix="give training/ of KITTI 2015 scene flow")
    values = np.asarray(read_picture(path))
    if values.shape != shape:
        raise FileFormatError(f"{path}", expected=f"one channel of {shape}", found=f"{values.shape}")
    return values


def disparity(path: Path, shape: tuple[int, ...]) -> FloatArray:
    """Disparity in pixels, 0 where unknown."""
    return picture(path, shape) / 256.0


def score_surface(
    dense: Trajectories, moving: FloatArray, row: int, truth: Surface, found: Found, where: str
) -> None:
    """Compare the trajectories seen in frames `row` and `row + 1` with the truth of that step."""
    rows = np.flatnonzero(dense.visible[:, row] & dense.visible[:, row + 1])
    near, at = nearest(truth, dense.xy[rows, row])
    rows, at = rows[near], at[near]
    expected = dense.xy[rows, row] + truth.moved[at] - truth.xy[at]
    labelled = moving[rows]
    areas = np.bincount(truth.ids)
    far = {k: float(np.median(truth.depth[truth.ids == k])) for k in np.unique(truth.ids[at])}
    apart = np.linalg.norm(dense.xy[rows, row + 1] - expected, axis=1)
    for k, error, label, z in zip(truth.ids[at], apart, labelled, truth.depth[at], strict=True):
        found.object.append(f"{where} object {k}" if k else "static")
        found.size.append(float(areas[k]) if k else np.nan)
        found.distance.append(far[k] if k else z)
        found.moves.append(bool(k))
        found.labelled.append(label)
        found.error.append(error)


def nearest(truth: Surface, xy: FloatArray) -> tuple[BoolArray, IntArray]:
    """Of the truth points within `REACH` of each place the one in front, (n,), and whether there is one."""
    apart, at = cKDTree(truth.xy).query(xy, k=4, distance_upper_bound=REACH)
    depth = np.where(np.isfinite(apart), np.append(truth.depth, np.inf)[at], np.inf)
    first = depth.argmin(axis=1)
    # Among points of one surface the nearest in the image, not the nearest to the camera.
    front = depth < 1.05 * depth.min(axis=1, keepdims=True)
    first = np.where(front, apart, np.inf).argmin(axis=1)
    return np.isfinite(depth.min(axis=1)), at[np.arange(len(at)), first]


def motion_of(clip: Clip) -> FloatArray:
    """Whether each trajectory is labelled as moving, (N,): 1, 0, or NaN where it has no label."""
    out = np.full(len(clip.dense), np.nan)
    labels = clip.labels
    if labels.background is None and labels.n_motions:
        raise InvalidValueError(clip.name, expected="labels that name the background", found="none")
    known = labels.label != 0
    out[clip.evaluated[known]] = labels.label[known] != labels.background
    return out


# --- 3D boxes: tracklets and KITTI tracking


@dataclass
class Box:
    """An object of KITTI: eight corners in camera 0 and the centre in the world, by frame number."""

    name: str
    corners: dict[int, FloatArray] = field(default_factory=dict)
    world: dict[int, FloatArray] = field(default_factory=dict)

    def moves(self, numbers: Iterable[int]) -> bool:
        """Whether the centre travels in the world."""
        places = np.array([self.world[n] for n in numbers if n in self.world])
        return len(places) > 1 and float(np.ptp(places, axis=0).max()) > TRAVEL

    def depth(self, number: int) -> float:
        """Distance in metres along the axis of camera 0."""
        return float(self.corners[number][:, 2].mean())


Members = Callable[[int, int, FloatArray], tuple[BoolArray, BoolArray]]
"""Of box k in a frame number and places (n, 2): which are surely in it, and which may be."""


def in_boxes(boxes: Sequence[Box], K: FloatArray, size: tuple[int, int]) -> Members:
    def members(k: int, number: int, xy: FloatArray) -> tuple[BoolArray, BoolArray]:
        box = project_box(boxes[k].corners[number], K, size)
        if box is None:
            return np.zeros(len(xy), np.bool_), np.zeros(len(xy), np.bool_)
        middle, half = (box[:2] + box[2:]) / 2, (box[2:] - box[:2]) / 2
        off = np.abs(xy - middle) / half
        return (off <= MIDDLE).all(axis=1), (off <= 1).all(axis=1)

    return members


def score_boxes(clip: Clip, boxes: Sequence[Box], members: Members, found: Found) -> None:
    """Decide for every trajectory which object it is on, and compare its label with whether that moves."""
    found.unit, dense, numbers = "tracks", clip.dense, clip.frame_numbers.tolist()
    votes, touched = np.zeros((len(dense), len(boxes))), np.zeros(len(dense), np.bool_)
    sizes: list[list[int]] = [[] for _ in boxes]
    for frame, number in enumerate(numbers):
        rows = np.flatnonzero(dense.visible[:, frame])
        free = np.ones(len(rows), np.bool_)
        here = [k for k, box in enumerate(boxes) if number in box.corners]
        for k in sorted(here, key=lambda k: boxes[k].depth(number)):  # what is nearer hides what is behind
            sure, maybe = members(k, number, dense.xy[rows, frame])
            votes[rows[sure & free], k] += 1
            touched[rows[maybe]] = True
            sizes[k].append(int(maybe.sum()))
            free &= ~maybe
    share = votes / np.maximum(dense.visible.sum(axis=1, keepdims=True), 1)
    own = np.where(share.max(axis=1, initial=0) > 0.5, share.argmax(axis=1) if len(boxes) else 0, UNSURE)
    labelled = motion_of(clip)
    for row in np.flatnonzero((own >= 0) | ~touched):
        box = boxes[own[row]] if own[row] >= 0 else None
        near = np.median([box.depth(n) for n in numbers if n in box.corners]) if box else np.nan
        found.object.append(f"{clip.name} {box.name}" if box else "static")
        found.size.append(float(np.mean(sizes[own[row]])) if box else np.nan)
        found.distance.append(float(near))
        found.moves.append(box.moves(numbers) if box else False)
        found.labelled.append(labelled[row])
        found.error.append(np.nan)


def tracklet_boxes(drive: RawDrive, numbers: Sequence[int]) -> list[Box]:
    """Read the drive's tracklets as boxes in the frames `numbers`."""
    poses = drive.poses(np.array(numbers)) @ np.linalg.inv(drive.T_cam_imu)
    boxes = []
    for k, tracklet in enumerate(drive.tracklets()):
        box = Box(f"{tracklet.kind.lower()} {k + 1}")
        for n, pose in zip(numbers, poses, strict=True):
            if n in tracklet.numbers:
                box.corners[n] = tracklet.corners(n) @ drive.T_cam_velo[:3, :3].T + drive.T_cam_velo[:3, 3]
                box.world[n] = (pose[:3, :3] @ box.corners[n].mean(axis=0) + pose[:3, 3])[:3]
        boxes.append(box)
    return [box for box in boxes if box.corners]


def tracking_boxes(
    training: Path, sequence: str, start: int
) -> tuple[list[Box], dict[str, FloatArray], list[int]]:
    """Read boxes, calibration and track ids of a sequence of KITTI tracking; frame 0 is raw frame `start`."""
    calibration = tracking_calibration(training / "calib" / f"{sequence}.txt")
    packets = load_oxts_packets_and_poses([training / "oxts" / f"{sequence}.txt"])
    T_cam_imu = calibration["rect"] @ calibration["Tr_velo_cam"] @ calibration["Tr_imu_velo"]
    poses = [packet.T_w_imu @ np.linalg.inv(T_cam_imu) for packet in packets]
    boxes: dict[int, Box] = {}
    path = training / "label_02" / f"{sequence}.txt"
    for number, line in enumerate(path.read_text().splitlines(), start=1):
        words = line.split()
        if len(words) < 17:
            raise FileFormatError(f"{path}: line {number}", expected="17 words", found=f"{len(words)}")
        frame, track, kind = int(words[0]), int(words[1]), words[2]
        if kind == "DontCare":
            continue
        box = boxes.setdefault(track, Box(f"{kind.lower()} {track}"))
        corners = label_corners(np.array(words[10:17], dtype=np.float64))
        if frame >= len(poses):
            raise FileFormatError(
                f"{path}: line {number}", expected=f"one of {len(poses)} frames", found=words[0]
            )
        pose = poses[frame]
        box.corners[frame + start] = corners
        box.world[frame + start] = pose[:3, :3] @ corners.mean(axis=0) + pose[:3, 3]
    return list(boxes.values()), calibration, list(boxes)


def label_corners(values: FloatArray) -> FloatArray:
    """Corners (8, 3) in camera 0 of height, width, length, x, y, z of the bottom's centre, yaw about y."""
    height, width, length, *centre, yaw = values
    unit = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-1.0, 0.0) for z in (-0.5, 0.5)])
    turn = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    # `project_box` joins corners that differ in one coordinate, in this order of the three.
    return np.asarray((unit * (length, height, width)) @ turn.T + centre)


def tracking_calibration(path: Path) -> dict[str, FloatArray]:
    """Matrices of a calibration file of KITTI tracking; some of its keys have no colon."""
    out: dict[str, FloatArray] = {}
    for line in path.read_text().splitlines():
        key, _, rest = line.replace(":", " ", 1).partition(" ")
        values = np.array(rest.split(), dtype=np.float64)
        if values.size == 12:
            out[key] = np.vstack([values.reshape(3, 4), (0, 0, 0, 1)])
        elif values.size == 9:
            out["rect"] = np.eye(4)
            out["rect"][:3, :3] = values.reshape(3, 3)
    for missing in {"P0", "P2", "rect", "Tr_velo_cam", "Tr_imu_velo"} - set(out):
        raise FileFormatError(f"{path}", expected=f"a line {missing}", found="none")
    return out


def in_masks(
    boxes: Sequence[Box], tracks: Sequence[int], folder: Path, start: int, P: Mapping[str, FloatArray]
) -> Members:
    """Masks of KITTI MOTS, of camera 2, at the places of camera 0: shifted by each object's distance."""

    def members(k: int, number: int, xy: FloatArray) -> tuple[BoolArray, BoolArray]:
        values = np.asarray(read_picture(folder / f"{number - start:06d}.png"))
        shift = (P["P2"][0, 3] - P["P0"][0, 3]) / boxes[k].depth(number)
        x, y = np.rint(xy + np.array([shift, 0.0])).astype(int).T
        inside = (x >= 0) & (y >= 0) & (x < values.shape[1]) & (y < values.shape[0])
        out = np.zeros(len(xy), np.bool_)
        out[inside] = values[y[inside], x[inside]] % 1000 == tracks[k]
        out[inside] &= ~np.isin(values[y[inside], x[inside]], (0, 10000))
        return out, out

    return members


# --- tables


def report(found: Found) -> str:
    """Tables of errors and agreement: all, by object, by size and by distance."""
    names, moves = np.array(found.object), np.array(found.moves, dtype=np.bool_)
    error, labelled = np.array(found.error), np.array(found.labelled)
    if not len(names):
        return "no trajectory meets the truth\n"

    def row(name: str, rows: BoolArray) -> list[str]:
        off = error[rows & np.isfinite(error)]
        right = (labelled == moves)[rows & np.isfinite(labelled)]
        cells = [f"{np.median(off):.2f}", f"{off.mean():.2f}", f"{(off <= 1).mean():.1%}"] if len(off) else []
        share = f"{right.mean():.1%}" if len(right) else "-"
        return [name, str(rows.sum()), *(cells or ["-"] * 3), str(len(right)), share]

    def bins(values: Sequence[float], bounds: Sequence[float], unit: str) -> list[list[str]]:
        ranges = [(f"{a:g} to {b:g} {unit}", np.array(values), a, b) for a, b in pairwise(bounds)]
        return [row(name, (v >= a) & (v < b)) for name, v, a, b in ranges if ((v >= a) & (v < b)).any()]

    tables = {
        "All": [row("all", np.ones_like(moves)), row("static", ~moves), row("moving", moves)],
        "By object": [row(name, names == name) for name in dict.fromkeys(names.tolist())],
        f"By size of the object ({found.unit})": bins(found.size, SIZES[found.unit], found.unit),
        "By distance": bins(found.distance, DISTANCES, "m"),
    }
    head = ["", "tracks", "median px", "mean px", "within 1 px", "labelled", "agree"]
    return "\n".join(f"{title}\n{text_table(rows, head)}\n" for title, rows in tables.items() if rows)


# --- command line


def sceneflow(arguments: argparse.Namespace, found: Found) -> None:
    given = dict(tuple(map(int, text.split("="))) for text in arguments.index)
    index, clips = given or INDEX.get(arguments.drive or "", {}), loaded(arguments)
    met = 0
    for clip in clips:
        for row, number in enumerate(clip.frame_numbers[:-1].tolist()):
            if number in index:
                truth = surface(arguments.kitti, index[number])
                name = f"{clip.name} frame {number}"
                score_surface(clip.dense, motion_of(clip), row, truth, found, name)
                met += 1
    if not met:
        numbers = {clip.name: f"{clip.frame_numbers[0]}..{clip.frame_numbers[-1]}" for clip in clips}
        expected = f"one of {sorted(index)}" if index else "a drive that KITTI 2015 has, or --index"
        raise InvalidValueError("frames", expected=expected, found=f"{numbers}")


def pairs(arguments: argparse.Namespace, found: Found) -> None:
    for number in tqdm([int(text) for text in arguments.clips], disable=None):
        frames = sorted((arguments.kitti / "image_2").glob(f"{number:06d}_*.png"))
        names = [int(path.stem[7:]) for path in frames]
        if not {10, 11} <= set(names):
            raise InputFileError(f"{arguments.kitti}/image_2/{number:06d}_10.png, _11.png: no such files")
        tracks = track(list(read_frames(frames, "luma")), arguments.flow)
        truth, unlabelled = surface(arguments.kitti, number, camera=2), np.full(len(tracks), np.nan)
        score_surface(tracks, unlabelled, names.index(10), truth, found, f"{number:06d}")


def tracking(arguments: argparse.Namespace, found: Found) -> None:
    boxes, P, tracks = tracking_boxes(arguments.kitti, arguments.sequence, arguments.start)
    masks = arguments.kitti / "instances" / arguments.sequence
    for clip in loaded(arguments):
        members = in_boxes(boxes, P["P0"][:3, :3], clip.dense.image_size)
        if masks.is_dir():
            members = in_masks(boxes, tracks, masks, arguments.start, P)
        score_boxes(clip, boxes, members, found)


def tracklets(arguments: argparse.Namespace, found: Found) -> None:
    date, _, number = (arguments.drive or "").rpartition("_")
    drive = RawDrive(arguments.kitti, date, number)
    for clip in loaded(arguments):
        boxes = tracklet_boxes(drive, clip.frame_numbers.tolist())
        score_boxes(clip, boxes, in_boxes(boxes, drive.K, drive.image_size), found)


def loaded(arguments: argparse.Namespace) -> list[Clip]:
    return [load(path) for path in arguments.clips]


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    kinds = {"sceneflow": sceneflow, "pairs": pairs, "tracking": tracking, "tracklets": tracklets}
    parser.add_argument("truth", choices=kinds)
    parser.add_argument("clips", nargs="+", help="clip files; with pairs: numbers of pictures")
    parser.add_argument("--kitti", type=Path, required=True, help="your copy of the truth")
    parser.add_argument("--drive", help="for instance 2011_09_26_0005")
    parser.add_argument("--sequence", default="0000", help="of KITTI tracking")
    parser.add_argument("--start", type=int, default=0, help="raw frame of the sequence's first frame")
    parser.add_argument("--index", nargs="*", default=[], metavar="FRAME=NUMBER")
    parser.add_argument("--flow", default="dis", help="with pairs: see kt3dmoseg track --help")
    arguments, found = parser.parse_args(argv), Found()
    try:
        kinds[arguments.truth](arguments, found)
    except (KT3DMoSegError, OSError) as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    sys.stdout.write(report(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
