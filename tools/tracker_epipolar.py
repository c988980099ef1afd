"""How far tracks of the static scene stray from their epipolar lines, on the real frames.

Usage: python tools/tracker_epipolar.py [--clips CLIP ...] [--after 10] [--cache FOLDER] [-o OUT.md]

Real frames have no true tracks, but where the scene is static and the camera moves, a point and the same
point some frames later obey x'^T F x = 0. The released tracks of the background that live so long are
started anew at their first points and followed in several ways. For each way and each start frame, F is
fitted (MAGSAC) to its own positions of those tracks that every way keeps, and the Sampson distances of all
are pooled. The error along the epipolar line stays unseen.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
from tqdm import tqdm
from tracker_fidelity import NO_STOPS, alive_after, starts

from kt3dmoseg import load
from kt3dmoseg.files import write_text
from kt3dmoseg.tracks import RELIABLE, track
from kt3dmoseg.types import Clip

LEAST_POINTS = 50
LEAST_MOTION = 3.0  # pixels: the median of a pair that tells F
WAYS = {
    "default": NO_STOPS,
    "anchored": {"anchor": RELIABLE["anchor"], **NO_STOPS},
    "reliable": dict(RELIABLE),
}
HEAD = ["tracks", "points", "median px", "90 %", "95 %", "kept by `reliable`: median px", "90 %", "95 %"]


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


def compare(clip: Clip, frames: Path, after: int, cache: str | None) -> dict[str, np.ndarray]:
    """Distances of each way of tracking, (N,), of the same tracks; NaN where a way has stopped."""
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
    pooled: dict[str, list[np.ndarray]] = {name: [] for name in ways}
    for end in np.unique(at):
        some = rows[at == end]
        step = np.linalg.norm(dense.xy[some, end] - dense.xy[some, end - after], axis=1)
        kept = np.isfinite(np.stack([xy[some, end, 0] for xy in ways.values()])).all(axis=0)
        if kept.sum() >= LEAST_POINTS and np.median(step) >= LEAST_MOTION:
            for name, xy in ways.items():
                pooled[name].append(strayed(xy[some, end - after], xy[some, end], kept))
    return {name: np.concatenate([np.zeros(0), *parts]) for name, parts in pooled.items()}


def row(name: str, distance: np.ndarray, kept: np.ndarray) -> list[str]:
    def quantiles(values: np.ndarray) -> list[str]:
        return [f"{q:.3f}" for q in np.nanpercentile(values, [50, 90, 95])]

    return [name, str(np.isfinite(distance).sum()), *quantiles(distance), *quantiles(distance[kept])]


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
    pooled = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    kept = np.isfinite(np.stack(list(pooled.values()))).all(axis=0)
    lines = [HEAD, ["---"] * len(HEAD), *(row(name, d, kept) for name, d in pooled.items())]
    text = "".join(f"| {' | '.join(cells)} |\n" for cells in lines)
    if arguments.output:
        write_text(arguments.output, text)
    sys.stdout.write(text)


if __name__ == "__main__":
    main()
