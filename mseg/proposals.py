"""What moves by itself, as proposals for the labelling page of kt3dmoseg.

Registered in the entry point group ``kt3dmoseg.proposers``, as any third party would.

1. The static scene is the rigid body that explains most trajectories (`mseg.geometry.rigid`).
2. Candidates: near trajectories that move alike and that the scene does not explain, at several limits.
3. A body is adjusted to each. Its trajectories are those around it that it explains better than the scene;
   its worth is what it saves over all of them, times how much they are apart from what moves like them.
4. Of candidates that overlap the best is kept. Left out is what moves as something static near it does:
   tracks that cling to the outline of a pole in front, or of a tree.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from kt3dmoseg.neighbours import alike, connected, near_pairs
from kt3dmoseg.types import BoolArray, FloatArray, IntArray, Labels, Trajectories
from mseg.errors import TooFewPointsError
from mseg.geometry import rigid

if TYPE_CHECKING:
    from kt3dmoseg.annotate.proposals import Request

# A body needs trajectories of so many frames; a clip needs so many of them. Frames that are looked at.
_SHORTEST, _FEWEST, _FRAMES = 4, 50, 30
# Widths of the image: focal length (which hardly matters), least noise, noise at which bodies are adjusted;
# noise per pixel of motion in a frame.
_FOCAL, _NOISE, _ADJUSTED, _SLIP = 0.6, 8e-5, 2.5e-4, 0.02
# Starts and sample for the scene; sample for other bodies.
_STARTS, _SCENE, _SAMPLE = 3, 200, 48
# Residuals, in standard deviations, from which trajectories are gathered, and how strictly they move alike.
_LEVELS, _STRICT = (2, 3, 5, 8, 14), (1.0, 2.0, 3.0)
_SMALLEST, _APART = 8, 0.4  # trajectories of a candidate, and how much apart it is at least
_UNEXPLAINED, _BETTER = 3.0, 0.5  # see `_Scene.costs`; what a trajectory saves under its own body at least
_INSIDE, _BESIDE = 8.0, 60.0  # pixels from a body's trajectories: around it, and to what may carry them along
_ALONE = 0.9  # so much apart, nothing static carries it
# Residual against a static neighbour over that against the scene; residual of what is static.
_CARRIED, _STATIC = 0.5, 1.5
_USUAL = 10  # frames, from which on a body is trusted
_OVERLAP = 0.3
_WORTH = 150.0  # least worth


class _Body(NamedTuple):
    """Trajectories of a candidate, (n,); how much they are apart, and what the body is worth."""

    rows: IntArray
    apart: float
    worth: float = 0.0


def propose(request: Request) -> Labels:
    """Find what moves by itself: 1 for the static scene, 2, 3, ... for movers, the surest first.

    TooFewPointsError when fewer than 50 trajectories live for 4 frames.
    """
    scene = _Scene(request.trajectories)
    labels = np.ones(len(request.trajectories), dtype=np.int64)
    for number, body in enumerate(scene.movers(), start=2):
        labels[body.rows] = number
    return Labels(labels, background=1)


class _Scene:
    """A clip's trajectories, their residuals under the static scene, and what does not belong to it."""

    def __init__(self, tracks: Trajectories) -> None:
        frames = np.unique(np.linspace(0, tracks.n_frames - 1, _FRAMES).round().astype(np.int64))
        self.tracks = Trajectories(tracks.xy[:, frames], tracks.visible[:, frames])
        self.length = self.tracks.lengths
        self.rows = np.flatnonzero(self.length >= _SHORTEST)
        if len(self.rows) < _FEWEST:
            expected = f"{_FEWEST} trajectories of {_SHORTEST} frames"
            raise TooFewPointsError("mseg", expected=expected, found=str(len(self.rows)))
        seen = tracks.xy[tracks.visible]
        width = tracks.image_size[0] if tracks.image_size else float(np.ptp(seen, axis=0).max()) or 1.0
        self.scale = _FOCAL * width
        xy = (self.tracks.xy - (seen.min(axis=0) + seen.max(axis=0)) / 2) / self.scale
        self.image = np.where(self.tracks.visible[..., None], xy, 0.0)
        steps = np.linalg.norm(np.diff(self.tracks.xy, axis=1), axis=2)
        motion = np.nansum(steps, axis=1) / np.maximum(np.isfinite(steps).sum(axis=1), 1)
        self.noise = np.hypot(_NOISE * width, _SLIP * motion)
        self.rng = np.random.default_rng(0)
        self.pairs = near_pairs(self.tracks, self.rows)
        self.links = [self.pairs[alike(self.tracks, self.pairs, strict)] for strict in _STRICT]
        self.static = self._static()

    def residuals(self, cameras: FloatArray, rows: IntArray) -> FloatArray:
        """Residuals (n,) of rows (n,) under a body, in standard deviations."""
        _, square = rigid.triangulate(cameras, self.image[rows], self.tracks.visible[rows])
        freedom = np.maximum(2 * self.length[rows] - 3, 1)
        return np.asarray(np.sqrt(square / freedom) * self.scale / self.noise[rows])

    def costs(self, residuals: FloatArray) -> FloatArray:
        """Robust costs of residuals: what is far off costs little more."""
        return np.asarray(np.log1p((residuals / _UNEXPLAINED) ** 2))

    def adjusted(self, rows: IntArray, most: int) -> FloatArray:
        """Cameras of the body of some rows, of which at most so many are taken, long ones preferred."""
        if len(rows) > most:
            share = self.length[rows] / self.length[rows].sum()
            rows = self.rng.choice(rows, most, replace=False, p=share)
        image, visible = self.image[rows], self.tracks.visible[rows]
        return rigid.adjust(image, visible, self.rng, noise=_ADJUSTED / _FOCAL)[0]

    def _static(self) -> FloatArray:
        """Residuals (N,) under the body that explains most, of several starts, then of what it explains."""
        every = np.arange(len(self.tracks))

        def tried(rows: IntArray, most: int) -> FloatArray:
            return self.residuals(self.adjusted(rows, most), every)

        def cost(residuals: FloatArray) -> float:
            return float(self.costs(residuals[self.rows]).sum())

        best = min((tried(self.rows, _SCENE) for _ in range(_STARTS)), key=cost)
        for _ in range(2):
            best = min(best, tried(self.rows[best[self.rows] < _LEVELS[2]], 2 * _SCENE), key=cost)
        return best

    def apart(self, chosen: BoolArray) -> float:
        """Share, of the links of chosen trajectories (N,), of those among themselves."""
        ends = chosen[self.links[1]].sum(axis=1)
        return float((ends == 2).sum() / max((ends >= 1).sum(), 1))

    def candidates(self) -> list[_Body]:
        """Group linked trajectories that the scene does not explain, at several limits."""
        found: list[_Body] = []
        masks: list[BoolArray] = []
        for level in _LEVELS:
            rows = self.rows[self.static[self.rows] > level]
            hot = np.isin(np.arange(len(self.tracks)), rows)
            for links in self.links:
                for group in connected(links[hot[links].all(axis=1)], rows, _SMALLEST):
                    mask = np.isin(np.arange(len(hot)), group)
                    apart = self.apart(mask)
                    known = any((mask & other).sum() > 0.9 * (mask | other).sum() for other in masks)
                    if apart >= _APART and not known:
                        masks.append(mask)
                        found.append(_Body(group, apart))
        return found

    def around(self, rows: IntArray) -> IntArray:
        """Rows, and the trajectories that are next to them in most of their frames."""
        near = np.zeros(len(self.tracks))
        for frame in range(self.tracks.n_frames):
            (_, there), (here, at) = self.tracks.select(rows).at(frame), self.tracks.at(frame)
            if len(there):
                near[here] += cKDTree(there).query(at)[0] <= _INSIDE
        near[rows] = np.inf
        return self.rows[near[self.rows] > self.length[self.rows] / 2]

    def judged(self, bodies: Sequence[_Body]) -> list[_Body]:
        """Bodies of the trajectories that they explain better than the scene, the most worth first."""
        found = []
        for body in bodies:
            rows = self.around(body.rows)
            own = self.residuals(self.adjusted(body.rows, _SAMPLE), rows)
            gain = self.costs(self.static[rows]) - self.costs(own)
            better = np.isin(np.arange(len(self.tracks)), rows[gain > _BETTER])
            links = self.links[0]
            groups = connected(links[better[links].all(axis=1)], np.flatnonzero(better), _SMALLEST)
            if groups:
                near = np.isin(rows, self.around(groups[0]))
                apart = self.apart(np.isin(np.arange(len(better)), groups[0]))
                life = np.count_nonzero(self.tracks.visible[groups[0]].sum(axis=0) >= _SHORTEST)
                saved = float((gain * self.length[rows])[near].sum())
                found.append(_Body(groups[0], apart, saved * apart**2 * min(1.0, life / _USUAL)))
        return sorted(found, key=lambda body: -body.worth)

    def movers(self) -> list[_Body]:
        """Bodies that move by themselves, the surest first."""
        sure = _distinct([body for body in self.judged(self.candidates()) if body.worth > _WORTH / 2])
        sure = _distinct([body for body in self.judged(sure) if body.worth > _WORTH])
        return [body for body in sure if body.apart > _ALONE or not self.carried(body.rows)]

    def carried(self, rows: IntArray) -> bool:
        """Whether trajectories (n,) move as something static beside them, which their tracks cling to."""
        best = np.full(len(rows), np.inf)
        other = np.setdiff1d(self.rows[self.static[self.rows] < _STATIC], rows)
        for frame in range(0, self.tracks.n_frames, 3):
            k, there = (np.flatnonzero(self.tracks.visible[part, frame]) for part in (rows, other))
            if len(there):
                xy = self.tracks.xy[:, frame]
                near = cKDTree(xy[other[there]]).query_ball_point(xy[rows[k]], _BESIDE)
                for own, beside in zip(k, near, strict=True):
                    best[own] = min(best[own], self._apart_from(rows[own], other[there[beside]]))
        return bool(np.median(best / np.maximum(self.static[rows], 1.0)) < _CARRIED)

    def _apart_from(self, row: int, others: IntArray) -> float:
        """Least residual of a trajectory against those of others that show most of it, shifted."""
        apart = self.tracks.xy[others] - self.tracks.xy[row]
        both = np.isfinite(apart[..., 0])
        enough = both.sum(axis=1) >= max(3, 0.6 * self.length[row])
        apart, freedom = apart[enough], 2 * both[enough].sum(axis=1) - 3
        off = apart - np.nanmean(apart, axis=1, keepdims=True) if len(apart) else apart
        square = np.nansum(off**2, axis=(1, 2)) / freedom
        return float(np.sqrt(square.min(initial=np.inf)) / self.noise[row])


def _distinct(bodies: Sequence[_Body]) -> list[_Body]:
    """Those of bodies, in this order, that share few trajectories with the ones before."""
    kept: list[_Body] = []
    for body in bodies:
        shared = (
            len(np.intersect1d(body.rows, other.rows)) / min(len(body.rows), len(other.rows))
            for other in kept
        )
        if all(share <= _OVERLAP for share in shared):
            kept.append(body)
    return kept
