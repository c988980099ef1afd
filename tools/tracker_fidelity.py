"""How close our trajectories are to the 2018 release, and to the truth of synthetic drives.

Usage: python tools/tracker_fidelity.py [--flow dis] [--clips CLIP ...] [--scenes 4]
       [--track NAME=VALUE ...] [-o OUT.md]

Prints two Markdown tables. The first compares with the released trajectories: every one of them is
started at its first point and followed without stops, and compared after 1, 5 and 10
frames; then the clip is tracked as usual and start cells, number and mean length are compared. The
second compares the usual tracks of synthetic drives with the exact ones. docs/tracking.md explains
the columns.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np
from tqdm import tqdm

from kt3dmoseg import load
from kt3dmoseg.files import write_text
from kt3dmoseg.flow import Flow, create
from kt3dmoseg.options import add_parameters, parse_assignments
from kt3dmoseg.synthetic import Scene, SceneOptions, make_scene
from kt3dmoseg.tracks import track
from kt3dmoseg.types import Clip, Trajectories

AFTER = (1, 5, 10)
FAST = 20.0
MIN_LENGTH = 5
RAYS = 3  # squared: per pixel; with more of them the pictures hardly change (docs/synthetic.md)
NO_STOPS = {"consistency_floor": float("inf"), "boundary_floor": float("inf"), "appearance": 0}


@dataclass
class Release:
    """What one released clip, or several pooled, gave."""

    error: dict[int, list[np.ndarray]] = field(default_factory=lambda: {k: [] for k in AFTER})
    moving: list[np.ndarray] = field(default_factory=list)
    fast: list[np.ndarray] = field(default_factory=list)
    first: np.ndarray = field(default_factory=lambda: np.zeros(3, int))  # both, ours, released start cells
    later: np.ndarray = field(default_factory=lambda: np.zeros(3, int))
    count: np.ndarray = field(default_factory=lambda: np.zeros(2, int))  # ours, released
    frames: np.ndarray = field(default_factory=lambda: np.zeros(2, int))

    def add(self, other: Release) -> None:
        """Pool another clip's comparison with this one."""
        for k in AFTER:
            self.error[k] += other.error[k]
        self.moving += other.moving
        self.fast += other.fast
        for name in ("first", "later", "count", "frames"):
            getattr(self, name).__iadd__(getattr(other, name))


def starts(tracks: Trajectories) -> np.ndarray:
    """x, y, frame of every trajectory's first point, (N, 3)."""
    first = tracks.visible.argmax(axis=1)
    return np.c_[tracks.xy[np.arange(len(tracks)), first], first]


def compare(clip: Clip, frames: Path, flow: Flow, cache: str | None, options: Mapping[str, str]) -> Release:
    """Compare one clip with its release; `options` are the tracker's."""
    dense = clip.dense.select(clip.dense.lengths > 0)
    label = np.zeros(len(clip.dense), int)
    label[clip.evaluated] = clip.labels.label
    label = label[clip.dense.lengths > 0]
    seeds = starts(dense)
    with tempfile.TemporaryDirectory() as temporary:
        followed = track(frames, flow, seeds, cache=cache or temporary, **{**options, **NO_STOPS})
        ours = track(frames, flow, cache=cache or temporary, **options)
    out = Release()
    gap = np.linalg.norm(followed.xy - dense.xy, axis=2)
    for k in AFTER:
        rows, at = alive_after(dense, k)
        error = np.nan_to_num(gap[rows, at], nan=np.inf)
        out.error[k].append(error)
        if k == MIN_LENGTH:
            first = seeds[rows, 2].astype(int)
            step = np.linalg.norm(dense.xy[rows, first + 1] - dense.xy[rows, first], axis=1)
            out.moving.append(error[(label[rows] > 0) & (label[rows] != clip.labels.background)])
            out.fast.append(error[step > FAST])
    cells = [{tuple(c) for c in np.rint(starts(t)).astype(int).tolist()} for t in (ours, long_enough(dense))]
    for mine, when in ((out.first, lambda c: c[2] == 0), (out.later, lambda c: c[2] > 0)):
        a, b = ({c for c in some if when(c)} for some in cells)
        mine += (len(a & b), len(a), len(b))
    out.count += (len(ours), len(long_enough(dense)))
    out.frames += (ours.lengths.sum(), long_enough(dense).lengths.sum())
    return out


def long_enough(tracks: Trajectories) -> Trajectories:
    return tracks.select(tracks.lengths >= MIN_LENGTH)


def alive_after(tracks: Trajectories, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows that are visible k frames after their start, and that frame."""
    first = tracks.visible.argmax(axis=1)
    rows = np.flatnonzero(first + k < tracks.n_frames)
    rows = rows[tracks.visible[rows, first[rows] + k]]
    return rows, first[rows] + k


def release_row(name: str, r: Release) -> list[str]:
    pooled = {k: np.concatenate(r.error[k]) for k in AFTER}
    within = [f"{np.median(e):.2f} / {np.mean(e < 1):.3f}" if len(e) else "-" for e in pooled.values()]
    moving, fast = np.concatenate(r.moving), np.concatenate(r.fast)
    return [
        name,
        *within,
        *(f"{np.mean(e < 1):.3f} ({len(e)})" if len(e) else "-" for e in (moving, fast)),
        f"{r.first[0] / r.first[2]:.3f} / {r.first[0] / r.first[1]:.3f}",
        f"{r.later[0] / max(1, r.later[2]):.3f}",
        f"{r.count[0] / r.count[1]:.3f}",
        f"{r.frames[0] / r.count[0] / (r.frames[1] / r.count[1]):.3f}",
    ]


RELEASE_HEAD = [
    "clip",
    *(f"{k}: median px / <1 px" for k in AFTER),
    "moving objects, 5: <1 px (n)",
    f"steps > {FAST:g} px, 5: <1 px (n)",
    "first cells: recall / precision",
    "later cells: recall",
    "number",
    "mean length",
]


@dataclass
class Truth:
    """Errors of tracks against the exact ones."""

    error: list[np.ndarray] = field(default_factory=list)
    slid: int = 0
    tracks: int = 0

    def add(self, other: Truth) -> None:
        """Pool another scene's comparison with this one."""
        self.error += other.error
        self.slid += other.slid
        self.tracks += other.tracks


def against_truth(scene: Scene, flow: Flow, options: Mapping[str, str]) -> Truth:
    """Track a synthetic drive and compare with its geometry; `options` are the tracker's."""
    ours = track(scene.frames(), flow, **options)
    begin = starts(ours)
    exact = scene.trajectories(begin)
    rows, at = alive_after(ours, AFTER[-1])
    seen = exact.visible[rows, at]
    error = np.linalg.norm(ours.xy[rows, at] - exact.xy[rows, at], axis=1)[seen]
    return Truth([error], int(slides(scene, ours, begin).sum()), len(ours))


def slides(scene: Scene, tracks: Trajectories, begin: np.ndarray) -> np.ndarray:
    """Which tracks end on another object than they start on: nowhere within one pixel is their own, (N,)."""
    last = tracks.n_frames - 1 - tracks.visible[:, ::-1].argmax(axis=1)
    rows = np.arange(len(tracks))
    own = object_ids(scene, begin[:, :2], begin[:, 2].astype(int), reach=0)[:, 0]
    there = object_ids(scene, tracks.xy[rows, last], last, reach=1)
    return (there != own[:, None]).all(axis=1)


def object_ids(scene: Scene, xy: np.ndarray, frame: np.ndarray, reach: int) -> np.ndarray:
    """Object ids of the pixels within `reach` of points, (N, (2 reach + 1)^2)."""
    width, height = scene.image_size
    offsets = np.arange(-reach, reach + 1)
    out = np.zeros((len(xy), len(offsets) ** 2), int)
    for t in np.unique(frame):
        rows = np.flatnonzero(frame == t)
        x, y = np.rint(xy[rows]).astype(int).T
        column = np.clip(x[:, None, None] + offsets[None, None, :], 0, width - 1)
        row = np.clip(y[:, None, None] + offsets[None, :, None], 0, height - 1)
        out[rows] = np.minimum(scene.ids(int(t)), 255)[row, column].reshape(len(rows), -1)
    return out


def truth_row(name: str, t: Truth) -> list[str]:
    e = np.concatenate(t.error)
    return [
        name,
        str(t.tracks),
        f"{np.median(e):.3f}",
        f"{np.percentile(e, 95):.2f}",
        f"{np.mean(e < 1):.3f}",
        f"{100 * t.slid / t.tracks:.2f} %",
    ]


TRUTH_HEAD = ["scene", "tracks", "10: median px", "10: 95 % px", "10: <1 px", "slid to another object"]


T = TypeVar("T", Release, Truth)


def table(head: list[str], rows: Iterable[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def pooled_last(
    items: dict[str, Callable[[], T]], total: T, row: Callable[[str, T], list[str]]
) -> list[list[str]]:
    """One row for each item and one for all of them pooled."""
    rows = []
    for name, make in tqdm(items.items(), disable=None):
        one = make()
        total.add(one)
        rows.append(row(name, one))
    return [*rows, row("**all**", total)]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    root = os.environ.get("KT3DMOSEG_DATA", Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--data", type=Path, default=Path(root), help="folder that holds kt3dmoseg/")
    parser.add_argument("--flow", default="dis")
    add_parameters(parser, "the optical flow")
    parser.add_argument(
        "--track", action="append", default=[], metavar="NAME=VALUE", help="an option of the tracker"
    )
    parser.add_argument(
        "--clips", nargs="*", help="default: every released clip; none: --clips without names"
    )
    parser.add_argument("--scenes", type=int, default=4, help="number of synthetic drives")
    parser.add_argument("--cache", metavar="FOLDER", help="keep the flow of real clips here (4 MB a field)")
    parser.add_argument("-o", "--output")
    arguments = parser.parse_args()
    flow = create(arguments.flow, **parse_assignments(arguments.parameter))
    options = parse_assignments(arguments.track)
    data = arguments.data / "kt3dmoseg"
    text = report(data, flow, arguments.clips, arguments.scenes, arguments.cache, options)
    if arguments.output:
        write_text(arguments.output, text)
    sys.stdout.write(text)


def report(
    data: Path,
    flow: Flow,
    clips: list[str] | None,
    scenes: int,
    cache: str | None,
    options: Mapping[str, str],
) -> str:
    """Both tables, in Markdown."""
    known = sorted(p.name.removesuffix("_Tracks.mat") for p in (data / "release").glob("*_Tracks.mat"))
    chosen = known if clips is None else clips
    release = {
        name: lambda name=name: compare(
            load(data / "release" / f"{name}_Tracks.mat"), data / "frames" / name, flow, cache, options
        )
        for name in chosen
    }
    truth = {
        f"seed {seed}": lambda seed=seed: against_truth(
            make_scene(SceneOptions(seed=seed, samples=RAYS)), flow, options
        )
        for seed in range(scenes)
    }
    parts = [f"`{flow}` {dict(options) or ''}\n"]
    if release:
        parts.append(table(RELEASE_HEAD, pooled_last(release, Release(), release_row)))
    if truth:
        parts.append(table(TRUTH_HEAD, pooled_last(truth, Truth(), truth_row)))
    return "\n".join(parts)


if __name__ == "__main__":
    main()
