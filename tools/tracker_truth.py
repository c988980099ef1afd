"""Tracks of synthetic drives compared with the exact ones; a part of tracker_fidelity.py."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np

from kt3dmoseg.flow import Flow
from kt3dmoseg.synthetic import Scene
from kt3dmoseg.tracking import track
from kt3dmoseg.types import Trajectories

AFTER = 10
Kinds: TypeAlias = Mapping[str, Mapping[str, Any]]  # options of the tracker, by what the tracks are called


def starts(tracks: Trajectories) -> np.ndarray:
    """x, y, frame of every trajectory's first point, (N, 3)."""
    first = tracks.visible.argmax(axis=1)
    return np.c_[tracks.xy[np.arange(len(tracks)), first], first]


def alive_after(tracks: Trajectories, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows that are visible k frames after their start, and that frame."""
    first = tracks.visible.argmax(axis=1)
    rows = np.flatnonzero(first + k < tracks.n_frames)
    rows = rows[tracks.visible[rows, first[rows] + k]]
    return rows, first[rows] + k


@dataclass
class Truth:
    """Errors of tracks against the exact ones."""

    error: list[np.ndarray] = field(default_factory=list)
    slid: int = 0
    tracks: int = 0

    def figures(self) -> dict[str, float]:
        """Median and 95th percentile after ten frames, share within 1 px, share that has slid."""
        error = np.concatenate(self.error)
        median, most = np.percentile(error, [50, 95])
        return {
            "median": median,
            "95 %": most,
            "< 1 px": np.mean(error < 1),
            "slid": self.slid / self.tracks,
        }

    def add(self, other: Truth) -> None:
        """Pool another scene's comparison with this one."""
        self.error += other.error
        self.slid += other.slid
        self.tracks += other.tracks


def against_truth(scene: Scene, flow: Flow, kinds: Kinds) -> dict[str, Truth]:
    """Track a synthetic drive with each kind of options and compare with its geometry."""
    frames = list(scene.frames())
    with tempfile.TemporaryDirectory() as cache:
        tracks = {kind: track(frames, flow, cache=cache, **options) for kind, options in kinds.items()}
    return {kind: compare(scene, ours) for kind, ours in tracks.items()}


def compare(scene: Scene, ours: Trajectories) -> Truth:
    begin = starts(ours)
    exact = scene.trajectories(begin)
    rows, at = alive_after(ours, AFTER)
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


def row(name: str, t: Truth) -> list[str]:
    f = t.figures()
    return [
        name,
        str(t.tracks),
        f"{f['median']:.3f}",
        f"{f['95 %']:.2f}",
        f"{f['< 1 px']:.3f}",
        f"{f['slid']:.2%}".replace("%", " %"),
    ]


HEAD = ["scene", "tracks", "10: median px", "10: 95 % px", "10: <1 px", "slid to another object"]
