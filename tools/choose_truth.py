"""How well `kt3dmoseg choose` measures the three principles, on synthetic drives, whose geometry is known.

Usage: python tools/choose_truth.py [--size 414x126] [--frames 100] [--movers mseg]

The drives differ in speed and traffic. Of every window the measures from pictures alone (no GPS/IMU, no
tracklets) are ranked against the exact ones: metres between the first and the last camera; depth and clutter
as `kt3dmoseg.choosing.windows` defines them, by exact depths and exact tracks of a grid on the static scene;
vehicles with 8 points of the grid for 5 frames. Prints Spearman's rank correlations.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import cv2
import numpy as np
from scipy.stats import spearmanr

from kt3dmoseg.choosing import ChooseOptions, Window, measure_windows
from kt3dmoseg.choosing.windows import _GAP, FEWEST, LIVES, _clutter
from kt3dmoseg.frames import Cut, FrameFolder
from kt3dmoseg.synthetic import Scene, SceneOptions, make_scene
from kt3dmoseg.tables import text_table

_DRIVES = ((3.0, 2), (8.0, 4), (15.0, 0), (8.0, 1))  # speed, vehicles
_SPACING = 8


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", default="414x126")
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--movers", default="mseg")
    given = parser.parse_args()
    width, height = map(int, given.size.split("x"))
    found: list[Window] = []
    exact = []
    for seed, (speed, objects) in enumerate(_DRIVES):
        options = {"width": width, "height": height, "frames": given.frames, "samples": 1, "turn": 1}
        scene = make_scene(SceneOptions(speed=speed, objects=objects, seed=seed, **options))
        with tempfile.TemporaryDirectory() as folder:
            for number, frame in enumerate(scene.frames()):
                cv2.imwrite(f"{folder}/{number:06d}.png", frame)
            windows = measured(Path(folder), given.frames, given.movers)
        found += windows
        frames = [truth_of_frame(scene, k) for k in range(given.frames)]
        exact += [truth(scene, frames, window) for window in windows]
    names = ("translation", "depth", "clutter", "motions", "score")
    ours = np.array([[getattr(window, name) for name in names] for window in found])
    theirs = np.array([[getattr(window, name) for name in names] for window in exact])
    rows = [[n, f"{spearmanr(a, b).statistic:.2f}"] for n, a, b in zip(names, ours.T, theirs.T, strict=True)]
    print(text_table(rows, ("measure", "Spearman")))
    half = [set(np.argsort(values)[len(values) // 2 :]) for values in (ours[:, -1], theirs[:, -1])]
    both = len(half[0] & half[1]) / len(half[1])
    print(
        f"{len(found)} windows; of the upper half by the exact score {both:.0%} are in the upper half by ours"
    )
    same, more = (ours[:, 3] == theirs[:, 3]).mean(), (ours[:, 3] > theirs[:, 3]).mean()
    print(f"motions: as many in {same:.0%}, more in {more:.0%}")


def measured(folder: Path, count: int, movers: str) -> list[Window]:
    options, found = ChooseOptions(movers=movers), {}
    for start in range(0, count - options.longest + 1, options.longest // 2):
        for window in measure_windows(FrameFolder(folder, Cut(start, start + options.longest - 1)), options):
            found.setdefault((window.first, window.last), window)
    return list(found.values())


def truth_of_frame(scene: Scene, frame: int) -> tuple[float, float, np.ndarray]:
    """Depth and clutter from a frame on, and the vehicles seen at the grid's points, (objects,) counts."""
    width, height = scene.image_size
    grid = (np.arange(4, side - 4, _SPACING) for side in (width, height))
    x, y = (values.ravel() for values in np.meshgrid(*grid))
    ids, later = scene.ids(frame)[y, x], min(frame + _GAP, scene.n_frames - 1)
    near, far = np.quantile(1 / scene.depth(frame)[y, x][ids == 1], (0.95, 0.05))
    tracks = scene.trajectories(np.stack([x, y, np.full(len(x), frame)], axis=1).astype(float)[ids == 1])
    _, before, after = tracks.pair(frame, later)
    clutter = _clutter(before, after) if later > frame else 0.0
    return float(np.log2(near / far)), clutter, np.bincount(ids, minlength=8)[2:8]


def truth(scene: Scene, frames: list[tuple[float, float, np.ndarray]], window: Window) -> Window:
    """Return the window with exact measures."""
    a, b = (scene.camera_pose(k)[:3, 3] for k in (window.first, window.last))
    inside = frames[window.first : max(window.first + 1, window.last + 1 - _GAP)]
    depth, clutter = np.median([part[:2] for part in inside], axis=0).tolist()
    seen = np.array([part[2] for part in frames[window.first : window.last + 1]]) >= FEWEST
    sizes = (FEWEST,) * int((seen.sum(axis=0) >= LIVES).sum())
    where = window.recording, window.first, window.last
    return Window(*where, float(np.linalg.norm(b - a)), "m", depth, clutter, sizes, "truth")


if __name__ == "__main__":
    main()
