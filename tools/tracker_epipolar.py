"""How far tracks of the static scene stray from their epipolar lines, on the real frames.

Usage: python tools/tracker_epipolar.py [--clips CLIP ...] [--after 10] [--cache FOLDER] [-o OUT.md]

Real frames have no true tracks, but where the scene is static and the camera moves, a point and the same
point some frames later obey x'^T F x = 0. The released tracks of the background that live so long are
started again at their first points and followed in several ways. For each way and each start frame, F is
fitted (MAGSAC) to its own positions of those tracks that every way keeps, and the Sampson distances of all
are pooled: of all tracks, of those that every way keeps, and of those on which the release and the default
disagree, where the distances show which of the two is right. The error along the epipolar line stays unseen.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from tqdm import tqdm
from tracker_aims import table
from tracker_release import FAST, NO_STOPS
from tracker_truth import alive_after, starts

from kt3dmoseg import load
from kt3dmoseg.files import write_text
from kt3dmoseg.tracking import RELIABLE, track
from kt3dmoseg.types import Clip

LEAST_POINTS = 50
LEAST_MOTION = 3.0  # pixels: the median of a pair that determines F
WAYS = {
    "default": NO_STOPS,
    "anchored": {"anchor": RELIABLE["anchor"], **NO_STOPS},
    "reliable": dict(RELIABLE),
}
APART = 1.0  # pixels between the release and the default that make them disagree
HEAD = ["of", "tracks", "points", "median px", "90 %", "95 %", "nearer than the release"]


def sampson(fundamental: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Sampson distance of pairs (N, 2) in pixels (Hartley and Zisserman, 2004, eq. 11.9)."""
    one = np.ones((len(a), 1))
    line, back = np.c_[a, one] @ fundamental.T, np.c_[b, one] @ fundamental
    product = (np.c_[b, one] * line).sum(axis=1)
    return np.abs(product) / np.sqrt((line[:, :2] ** 2).sum(axis=1) + (back[:, :2] ** 2).sum(axis=1))


def strayed(a: np.ndarray, b: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Distances of pairs (N, 2) from the epipolar geometry that fits the kept ones best; NaN for none."""
    fundamental, _ = cv2.findFundamentalMat(a[kept], b[kept], cv2.USAC_MAGSAC, 0.5, 0.9999, 20_000)
    return np.full(len(a), np.nan) if fundamental is None else sampson(fundamental[:3], a, b)


@dataclass
class Comparison:
    """The same N tracks in several ways."""

    distance: dict[str, np.ndarray]  # of each way, (N,); NaN where it has stopped
    gap: np.ndarray  # pixels between the release and the default, (N,)
    step: np.ndarray  # length of the released track's first step in pixels, (N,)

    @classmethod
    def pooled(cls, parts: Sequence[Comparison]) -> Comparison:
        """All tracks of several comparisons."""
        distance = {
            name: np.concatenate([part.distance[name] for part in parts]) for name in parts[0].distance
        }
        return cls(distance, *(np.concatenate([getattr(part, k) for part in parts]) for k in ("gap", "step")))


def compare(clip: Clip, frames: Path, after: int, cache: str | None) -> Comparison:
    """Follow a clip's released background tracks in every way; distances `after` frames later."""
    label = np.zeros(len(clip.dense), int)
    label[clip.evaluated] = clip.labels.label
    moving = (label > 0) & (label != clip.labels.background)
    dense = clip.dense.select((clip.dense.lengths > 0) & ~moving)
    seeds = starts(dense)
    with tempfile.TemporaryDirectory() as temporary:
        ways = {
            name: track(frames, "dis", seeds, cache=cache or temporary, **options).xy
            for name, options in WAYS.items()
        }
    ways = {"release": dense.xy, **ways}
    rows, at = alive_after(dense, after)
    none = np.zeros(0)
    parts = [Comparison(dict.fromkeys(ways, none), none, none)]
    for end in np.unique(at):
        some = rows[at == end]
        first = {name: xy[some, end - after] for name, xy in ways.items()}
        last = {name: xy[some, end] for name, xy in ways.items()}
        kept = np.isfinite(np.stack(list(last.values()))).all(axis=(0, 2))
        way = np.linalg.norm(last["release"] - first["release"], axis=1)
        if kept.sum() >= LEAST_POINTS and np.median(way) >= LEAST_MOTION:
            gap = np.linalg.norm(last["release"] - last["default"], axis=1)
            step = np.linalg.norm(dense.xy[some, end - after + 1] - first["release"], axis=1)
            parts.append(
                Comparison({name: strayed(first[name], last[name], kept) for name in ways}, gap, step)
            )
    return Comparison.pooled(parts)


def rows_of(found: Comparison) -> list[list[str]]:
    """One row for each way and each set of tracks."""
    kept = np.isfinite(np.stack(list(found.distance.values()))).all(axis=0)
    apart = found.gap > APART
    sets = {
        "all": np.ones_like(kept),
        "kept by all": kept,
        f"over {APART:g} px apart": apart,
        f"the same, steps > {FAST:g} px": apart & (found.step > FAST),
    }
    return [
        row(of, name, distance[some], found.distance["release"][some])
        for of, some in sets.items()
        for name, distance in found.distance.items()
    ]


def row(of: str, name: str, distance: np.ndarray, release: np.ndarray) -> list[str]:
    there = np.isfinite(distance) & np.isfinite(release)
    quantiles = (
        [f"{q:.3f}" for q in np.percentile(distance[there], [50, 90, 95])] if there.any() else ["-"] * 3
    )
    nearer = f"{np.mean((distance < release)[there]):.3f}" if there.any() and name != "release" else "-"
    return [of, name, str(there.sum()), *quantiles, nearer]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    root = os.environ.get("KT3DMOSEG_DATA", Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--data", type=Path, default=Path(root), help="folder that holds kt3dmoseg/")
    parser.add_argument("--clips", nargs="+", help="default: every released clip")
    parser.add_argument("--after", type=int, default=10, help="frames between the two points")
    parser.add_argument("--cache", metavar="FOLDER", help="keep the flow here (4 MB a field)")
    parser.add_argument("-o", "--output")
    arguments = parser.parse_args()
    data = arguments.data / "kt3dmoseg"
    known = sorted(p.name.removesuffix("_Tracks.mat") for p in (data / "release").glob("*_Tracks.mat"))
    parts = [
        compare(
            load(data / "release" / f"{name}_Tracks.mat"),
            data / "frames" / name,
            arguments.after,
            arguments.cache,
        )
        for name in tqdm(arguments.clips or known, disable=None)
    ]
    text = table(HEAD, rows_of(Comparison.pooled(parts)))
    if arguments.output:
        write_text(arguments.output, text)
    sys.stdout.write(text)


if __name__ == "__main__":
    main()
