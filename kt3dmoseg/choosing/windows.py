"""Windows of a recording, and what of a good clip each of them has.

Xu, Cheong and Li (CVPR 2018) chose clips with a camera that translates far, a static scene of deep and
cluttered structure, and several motions with enough points for hypotheses. A part of a recording is tracked
once; of every window in it are measured

* **translation**: metres between the first and last camera (GPS/IMU); without these, pixels of image motion
  that no rotation of the camera explains, of the nearest quarter of the scene, over the window;
* **depth**: how many times the inverse depth of the static scene doubles between its 5 % and 95 % quantiles;
* **clutter**: share of the static scene that the best homography does not explain, which is 0 for a plane;
* **motions**: moving objects with `FEWEST` trajectories that live for `LIVES` frames.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from kt3dmoseg.annotate import Annotation, label_tracks
from kt3dmoseg.annotate.proposals import PROPOSERS, Request
from kt3dmoseg.annotate.proposals.residual import moving_groups
from kt3dmoseg.choosing import ChooseOptions
from kt3dmoseg.errors import InvalidValueError, KT3DMoSegError
from kt3dmoseg.frames import FrameSource, KittiClip
from kt3dmoseg.tracking import find_cuts, track
from kt3dmoseg.types import ByteArray, FloatArray, IntArray, Labels, Trajectories

FEWEST, LIVES = 8, 5  # trajectories of a motion: as many as a fundamental matrix needs; frames of each
_GAP = 4  # frames over which image motion is measured
_FOCAL = 0.58  # of the width, KITTI's; rotations are removed with it where the camera is not known
_STILL = 0.25  # pixels a frame; less image motion has no depth
_OFF, _LINE = 1.5, 0.5  # pixels that a point is off the homography, off its epipolar line
_POINTS = 24  # static points that a measure needs
# Where each measure is worth half: metres or pixels, doublings of depth, share, motions.
_HALF = {"m": 8.0, "px": 60.0, "depth": 3.0, "clutter": 0.4, "motions": 1.0}
_NONE = 0.25  # what no motion counts as, so that such windows keep an order


@dataclass(frozen=True)
class Window:
    """A window of a recording: frame numbers, both included, its measures and `score`, 0 to 1.

    `unit` is that of the translation, m or px; `sizes` are the trajectories of what `movers` found to move.
    """

    recording: str
    first: int
    last: int
    translation: float
    unit: str
    depth: float
    clutter: float
    sizes: tuple[int, ...]
    movers: str
    cut: bool = False  # the picture changes to another one within it: it is no clip

    @property
    def name(self) -> str:
        """The clip's name."""
        return f"{self.recording}_{self.first:06d}-{self.last:06d}"

    @property
    def motions(self) -> int:
        """Number of moving objects."""
        return len(self.sizes)

    @property
    def principles(self) -> tuple[float, float, float]:
        """What the three principles are worth, 0 to 1: translation, structure of the scene, motions."""
        structure = (_worth(self.depth, "depth") + _worth(self.clutter, "clutter")) / 2
        return _worth(self.translation, self.unit), structure, _worth(max(self.motions, _NONE), "motions")

    @property
    def score(self) -> float:
        """Geometric mean of the principles; 0 where there is a cut."""
        return 0.0 if self.cut else float(np.prod(self.principles) ** (1 / 3))


def _worth(value: float, what: str) -> float:
    return value / (value + _HALF[what])


def measure_windows(source: FrameSource, options: ChooseOptions | None = None) -> list[Window]:
    """Measure every window of a part of a recording, as long as the longest window or longer, held in memory.

    They come by their first frame, then their length; their recording is the source's name. KT3DMoSegError
    when the frames cannot be read or tracked.
    """
    settings = options or ChooseOptions()
    frames = list(source.frames(settings.colour))
    starts, numbers, windows = find_cuts(frames)[0], source.numbers(), windows_of(len(frames), settings)
    found = []
    for start, stop in pairwise([*starts, len(frames)]):
        ends = [(a, b) for a, b in windows if start <= a and b < stop]
        found += _measure_shot(source, frames[start:stop], start, ends, settings) if ends else []
    cut = [(numbers[a], numbers[b]) for a, b in windows if any(a < start <= b for start in starts)]
    found += [Window(source.name, *ends, 0, "px", 0, 0, (), "", cut=True) for ends in cut]
    return sorted(found, key=lambda window: (window.first, window.last))


def _measure_shot(
    source: FrameSource,
    frames: Sequence[ByteArray],
    start: int,
    windows: Sequence[tuple[int, int]],
    settings: ChooseOptions,
) -> list[Window]:
    """Measure windows of a shot, whose frames begin at index `start` of the source."""
    tracks, numbers = track(frames, flow=settings.flow), source.numbers()
    paths = source.paths()[start : start + len(frames)] if isinstance(source, KittiClip) else []
    labels, movers = _moving(source, tracks, paths, settings.movers)
    focal = float(source.drive.K[0, 0]) if isinstance(source, KittiClip) else _FOCAL * frames[0].shape[1]
    pairs = [_pair(tracks, labels, frame, focal) for frame in range(max(1, len(frames) - _GAP))]
    found = []
    for a, b in windows:
        first, last = a - start, b - start
        inside = [pair for pair in pairs[first : max(first + 1, last + 1 - _GAP)] if pair is not None]
        motion, depth, clutter = np.median(inside, axis=0).tolist() if inside else (0.0, 0.0, 0.0)
        metres = metres_between(source, numbers[a], numbers[b])
        lives = tracks.visible[:, first : last + 1].sum(axis=1) >= LIVES
        counts = np.bincount(labels[lives & (labels > 1)], minlength=2)
        sizes = tuple(sorted((int(n) for n in counts if n >= FEWEST), reverse=True))
        far, unit = (motion * (last - first), "px") if metres is None else (metres, "m")
        found.append(Window(source.name, numbers[a], numbers[b], far, unit, depth, clutter, sizes, movers))
    return found


def windows_of(count: int, options: ChooseOptions) -> list[tuple[int, int]]:
    """Give the windows of so many frames, as indices of first and last: three lengths from every start."""
    middle = (options.shortest + options.longest) // 2
    lengths = sorted({options.shortest, middle, options.longest})
    starts = range(0, count, options.stride)
    return [(start, start + n - 1) for start in starts for n in lengths if start + n <= count]


def metres_between(source: FrameSource, first: int, last: int) -> float | None:
    """Metres between the cameras of two frames; None where that is not known."""
    if not isinstance(source, KittiClip):
        return None
    try:
        drive = source.drive
        cameras = drive.poses([first, last]) @ np.linalg.inv(drive.T_cam_imu)
    except KT3DMoSegError:
        return None
    metres = float(np.linalg.norm(cameras[1, :3, 3] - cameras[0, :3, 3]))
    return metres if np.isfinite(metres) else None  # packets may hold nan


def _moving(
    source: FrameSource, tracks: Trajectories, paths: Sequence[Path], movers: str
) -> tuple[IntArray, str]:
    """Labels (N,) of the trajectories, 1 = static scene, and the name of what found the motions.

    Where it can find none, everything is static, and the name comes with the reason.
    """
    kitti = source.drive if isinstance(source, KittiClip) else None
    if movers == "auto":
        known = "mseg" if "mseg" in PROPOSERS.names() else "residual"
        movers = "tracklets" if kitti is not None and kitti.has_tracklets else known
    empty = Annotation(source.name, tracks.image_size or (0, 0), tracks.n_frames)
    root = None if kitti is None else kitti.root
    try:
        if movers == "residual":
            return moving_groups(tracks), movers
        found = PROPOSERS.load(movers)(Request(source.name, empty, tracks, tuple(paths), kitti=root))
    except KT3DMoSegError as error:
        if movers == "tracklets":
            expected = "another one, or a KITTI drive with tracklets"
            raise InvalidValueError("movers", expected=expected, found=f"{source.where}: {error}") from None
        return np.ones(len(tracks), dtype=np.int64), f"{movers}: {error}"
    if not isinstance(found, Labels):
        found = label_tracks(tracks, replace(empty, objects=tuple(found)))
    return found.label, movers


def _pair(
    tracks: Trajectories, labels: IntArray, frame: int, focal: float
) -> tuple[float, float, float] | None:
    """Image motion in pixels a frame, depth and clutter from a frame to `_GAP` later; None of few points."""
    rows, x1, x2 = tracks.pair(frame, min(frame + _GAP, tracks.n_frames - 1))
    static = labels[rows] == 1
    if np.count_nonzero(static) < _POINTS or tracks.image_size is None:
        return None
    x1, x2 = x1[static], x2[static]
    centre = (np.array(tracks.image_size) - 1) / 2
    length, inverse = parallax((x1 - centre) / focal, (x2 - centre) / focal, 1 / focal)
    low, high = np.quantile(inverse, (0.05, 0.95))
    deep = np.count_nonzero(length * focal > _STILL * _GAP) >= _POINTS
    motion = float(np.quantile(length, 0.75)) * focal / _GAP
    return motion, float(np.log2(high / low)) if deep else 0.0, _clutter(x1, x2)


def parallax(x1: FloatArray, x2: FloatArray, pixel: float) -> tuple[FloatArray, FloatArray]:
    """Image motion (P,) of points (P, 2) without the camera's rotation, and inverse depths up to scale.

    All in units of the focal length. Inverse depths are of the points on their epipolar lines, and of the
    least motion that can be told, `_STILL` pixels a frame. Rotation R and direction t of the translation are
    those of the essential matrix; of its two R the smaller, as cameras do not turn by 90 degrees.
    With x2' the second view turned back, ``x2' - x1 = (x2' t_z - t_xy) / z`` for a point at depth z.
    """
    method, threshold = cv2.USAC_MAGSAC, _LINE * pixel
    found: Any = cv2.findEssentialMat(x1, x2, 1.0, (0.0, 0.0), method, 0.999, threshold)
    essential, inliers = found
    if essential is None or not inliers.any():
        return np.zeros(len(x1)), np.ones(1)
    *turns, t = cv2.decomposeEssentialMat(essential)
    turn = max(turns, key=np.trace)
    x, y, z = turn.T @ np.vstack([x2.T, np.ones(len(x2))])
    seen, t = np.column_stack([x / z, y / z]), (turn.T @ t).ravel()
    length = np.hypot(*(seen - x1).T)
    away = np.hypot(*(seen * t[2] - t[:2]).T)
    inverse = np.maximum(length, _STILL * _GAP * pixel) / np.maximum(away, pixel)
    return length, inverse[inliers.ravel() > 0]


def _clutter(x1: FloatArray, x2: FloatArray) -> float:
    found, inliers = cv2.findHomography(x1, x2, cv2.USAC_MAGSAC, _OFF, maxIters=500, confidence=0.99)
    return 0.0 if found is None else float(1 - np.mean(inliers))
