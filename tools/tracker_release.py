"""Tracks compared with the 2018 release; a part of tracker_fidelity.py."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from tracker_truth import alive_after, starts

from kt3dmoseg.errors import InputFileError
from kt3dmoseg.flow import Flow
from kt3dmoseg.tracking import track
from kt3dmoseg.types import Clip, Trajectories

AFTER = (1, 5, 10)
FAST = 20.0
MIN_LENGTH = 5
NEAR = 2.0  # pixels
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
    matched: np.ndarray = field(default_factory=lambda: np.zeros(2, int))  # released ones compared, all

    def add(self, other: Release) -> None:
        """Pool another clip's comparison with this one."""
        for k in AFTER:
            self.error[k] += other.error[k]
        self.moving += other.moving
        self.fast += other.fast
        for name in ("first", "later", "count", "frames", "matched"):
            getattr(self, name).__iadd__(getattr(other, name))

    def figures(self) -> dict[str, float]:
        """Give what the table shows, by name; NaN where nothing is measured."""
        out = {}
        for k, parts in self.error.items():
            error = np.concatenate([np.zeros(0), *parts])
            out[f"{k}: median"] = float(np.median(error)) if len(error) else np.nan
            out[f"{k}: < 1 px"] = share_within(parts)
        return out | {
            "moving": share_within(self.moving),
            "fast": share_within(self.fast),
            "matched": self.matched[0] / self.matched[1],
            "first recall": self.first[0] / self.first[2],
            "first precision": self.first[0] / self.first[1],
            "later recall": self.later[0] / max(1, self.later[2]),
            "number": self.count[0] / self.count[1],
            "mean length": self.frames[0] / self.count[0] / (self.frames[1] / self.count[1]),
        }


def share_within(parts: list[np.ndarray]) -> float:
    """Share of the errors under one pixel."""
    error = np.concatenate([np.zeros(0), *parts])
    return float(np.mean(error < 1)) if len(error) else np.nan


def compare(clip: Clip, frames: Path, flow: Flow, cache: str | None, options: Mapping[str, Any]) -> Release:
    """Compare one clip with its release; `options` are the tracker's."""
    dense = clip.dense.select(clip.dense.lengths > 0)
    with tempfile.TemporaryDirectory() as temporary:
        followed = track(frames, flow, starts(dense), cache=cache or temporary, **{**options, **NO_STOPS})
        ours = track(frames, flow, cache=cache or temporary, **options)
    return _compared(clip, np.arange(len(dense)), followed.xy, ours)


def compare_tracks(clip: Clip, theirs: Trajectories) -> Release:
    """Compare the trajectories of any tracker with the release.

    They start elsewhere: of the released ones count those that have one of theirs within `NEAR` pixels of
    their start, in that frame. The nearest is moved there; what it is off from then on is compared.
    """
    dense = clip.dense.select(clip.dense.lengths > 0)
    seeds, rows, paths = starts(dense), [], []
    for frame in np.unique(seeds[:, 2].astype(int)):
        here = np.flatnonzero(seeds[:, 2] == frame)
        known, places = theirs.at(frame)
        if len(known):
            apart, nearest = cKDTree(places).query(seeds[here, :2])
            rows.append(here[apart <= NEAR])
            moved = theirs.xy[known[nearest]] - (places[nearest] - seeds[here, :2])[:, None]
            paths.append(moved[apart <= NEAR])
    if not rows:
        raise InputFileError(clip.name, expected=f"tracks within {NEAR:g} px of released ones", found="none")
    order = np.argsort(np.concatenate(rows))
    return _compared(clip, np.concatenate(rows)[order], np.concatenate(paths)[order], theirs)


def _compared(clip: Clip, rows: np.ndarray, followed: np.ndarray, ours: Trajectories) -> Release:
    """Compare paths (n, F, 2) with rows of the release's visible tracks, and all tracks by their starts."""
    label = np.zeros(len(clip.dense), int)
    label[clip.evaluated] = clip.labels.label
    seen = clip.dense.lengths > 0
    dense, label = clip.dense.select(seen).select(rows), label[seen][rows]
    seeds, out = starts(dense), Release()
    out.matched += (len(rows), seen.sum())
    gap = np.linalg.norm(followed - dense.xy, axis=2)
    for k in AFTER:
        rows, at = alive_after(dense, k)
        error = np.nan_to_num(gap[rows, at], nan=np.inf)
        out.error[k].append(error)
        if k == MIN_LENGTH:
            first = seeds[rows, 2].astype(int)
            step = np.linalg.norm(dense.xy[rows, first + 1] - dense.xy[rows, first], axis=1)
            out.moving.append(error[(label[rows] > 0) & (label[rows] != clip.labels.background)])
            out.fast.append(error[step > FAST])
    released = long_enough(clip.dense)
    cells = [{tuple(c) for c in np.rint(starts(t)).astype(int).tolist()} for t in (ours, released)]
    for mine, when in ((out.first, lambda c: c[2] == 0), (out.later, lambda c: c[2] > 0)):
        a, b = ({c for c in some if when(c)} for some in cells)
        mine += (len(a & b), len(a), len(b))
    out.count += (len(ours), len(released))
    out.frames += (ours.lengths.sum(), released.lengths.sum())
    return out


def long_enough(tracks: Trajectories) -> Trajectories:
    return tracks.select(tracks.lengths >= MIN_LENGTH)


def row(name: str, r: Release) -> list[str]:
    f = r.figures()
    within = [f"{f[f'{k}: median']:.2f} / {f[f'{k}: < 1 px']:.3f}" for k in AFTER]
    counted = [(f["moving"], r.moving), (f["fast"], r.fast)]
    cells = [
        name,
        *within,
        *(f"{share:.3f} ({sum(map(len, parts))})" for share, parts in counted),
        f"{f['first recall']:.3f} / {f['first precision']:.3f}",
        *(f"{f[what]:.3f}" for what in ("later recall", "number", "mean length", "matched")),
    ]
    return ["-" if cell.startswith("nan") else cell for cell in cells]


HEAD = [
    "clip",
    *(f"{k}: median px / <1 px" for k in AFTER),
    "moving objects, 5: <1 px (n)",
    f"steps > {FAST:g} px, 5: <1 px (n)",
    "first cells: recall / precision",
    "later cells: recall",
    "number",
    "mean length",
    "compared",
]
