"""What moves by itself, as proposals for the labelling page of kt3dmoseg.

Registered in the entry point group ``kt3dmoseg.proposers``, as any third party would.

1. The static scene is the rigid body that explains most trajectories (`mseg.geometry.rigid`). Residuals are
   in standard deviations: where the frames show an edge, or little texture, trackers slide.
2. What the scene explains only as deeper than its ground, or floating in front of it, does not belong to it:
   what moves along its own epipolar lines.
3. Candidates: near trajectories that move alike and that the scene does not explain, at several limits.
4. A body is adjusted to each. Its trajectories are those around it that it explains better than the scene;
   its worth is what it saves over all of them, times how much they are apart from what moves like them.
5. Of candidates that overlap the best is kept. What moves nearly as something static near it does is worth
   less: tracks that cling to the outline of a pole in front, or of a tree.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np
from scipy.ndimage import minimum_filter1d
from scipy.spatial import cKDTree

from kt3dmoseg.io.images import picture_size, read_frame
from kt3dmoseg.neighbours import alike, connected, near_pairs
from kt3dmoseg.types import BoolArray, FloatArray, IntArray, Labels, Trajectories
from mseg.errors import TooFewPointsError
from mseg.geometry import rigid

if TYPE_CHECKING:
    from pathlib import Path

    from kt3dmoseg.annotate.proposals import Request

# A body needs trajectories of so many frames; a clip needs so many of them. Frames that are looked at.
_SHORTEST, _FEWEST, _FRAMES = 4, 50, 30
# Widths of the image: focal length (which hardly matters), least noise, noise at which bodies are adjusted;
# noise per pixel of motion in a frame.
_FOCAL, _NOISE, _ADJUSTED, _SLIP = 0.6, 4e-5, 2.5e-4, 0.01
# Noise of gray levels, pixels over which squared gradients are averaged, and the least mean of these.
_GRAY, _WINDOW, _FLATTEST = 3.0, 4.0, 0.3
_PASSES, _NEAREST, _TINY = 4, 0.05, 1e-9  # in which points are found; least depth; least curvature
# The ground: places that are looked at, planes that are drawn, passes that adjust the best; share of the
# places on it at least; share of what seems static that may float or lie under it.
_PLACES, _DRAWS, _REFINED, _ON_GROUND, _MISFITS = 4000, 300, 4, 0.1, 0.1
# Inverse depths over that of the ground: how near, from where on under it, and in front of the ground that is
# seen just below in cells of so many pixels.
_NEAR_GROUND, _UNDER, _IN_FRONT, _CELL = 0.1, 0.8, 1.4, (8.0, 4.0)
# Starts and sample for the scene; sample for other bodies.
_STARTS, _SCENE, _SAMPLE = 3, 200, 48
# Residuals, in standard deviations, from which trajectories are gathered, and how strictly they move alike.
_LEVELS, _STRICT = (2, 3, 5, 8, 14), (1.0, 2.0, 3.0)
_SMALLEST, _APART = 8, 0.4  # trajectories of a candidate, and how much apart it is at least
_UNEXPLAINED, _BETTER = 3.0, 0.5  # see `_Scene.costs`; what a trajectory saves under its own body at least
_INSIDE, _BESIDE = 8.0, 60.0  # pixels from a body's trajectories: around it, and to what may carry them along
_UNLIKE, _STATIC = 1.5, 1.5  # see `_Scene.unlike`; residual of what is static
_USUAL = 10  # frames, from which on a body is trusted
_OVERLAP = 0.3
_WORTH = 100.0  # least worth


class _Body(NamedTuple):
    """Trajectories of a candidate, (n,); how much they are apart, and what the body is worth."""

    rows: IntArray
    apart: float
    worth: float = 0.0


def propose(request: Request) -> Labels:
    """Find what moves by itself: 1 for the static scene, 2, 3, ... for movers, the surest first.

    TooFewPointsError when fewer than 50 trajectories are seen in 4 frames: of a long clip in 4 of 30 that are
    spread over it.
    """
    scene = _Scene(request.trajectories, request.frames)
    labels = np.ones(len(request.trajectories), dtype=np.int64)
    for number, body in enumerate(scene.movers(), start=2):
        labels[body.rows] = number
    return Labels(labels, background=1)


class _Scene:
    """A clip's trajectories, their residuals under the static scene, and what does not belong to it.

    `static` (N,) are residuals of points that stand on the ground or above it, `free` (N,) of any.
    """

    def __init__(self, tracks: Trajectories, paths: Sequence[Path] = ()) -> None:
        frames = np.unique(np.linspace(0, tracks.n_frames - 1, _FRAMES).round().astype(np.int64))
        self.tracks = Trajectories(tracks.xy[:, frames], tracks.visible[:, frames])
        self.length = self.tracks.lengths
        self.rows = np.flatnonzero(self.length >= _SHORTEST)
        if len(self.rows) < _FEWEST:
            expected = f"{_FEWEST} trajectories seen in {_SHORTEST} of {len(frames)} frames"
            raise TooFewPointsError("mseg", expected=expected, found=str(len(self.rows)))
        seen = tracks.xy[tracks.visible]
        width = tracks.image_size[0] if tracks.image_size else float(np.ptp(seen, axis=0).max()) or 1.0
        self.scale = _FOCAL * width
        self.image = (self.tracks.xy - (seen.min(axis=0) + seen.max(axis=0)) / 2) / self.scale
        steps = np.linalg.norm(np.diff(self.tracks.xy, axis=1), axis=2)
        motion = np.nansum(steps, axis=1) / np.maximum(np.isfinite(steps).sum(axis=1), 1)
        self.noise = np.hypot(_NOISE * width, _SLIP * motion)
        # Pictures of another size do not show what is at the tracks.
        fit = bool(paths) and picture_size(paths[0]) == tracks.image_size
        self.whiten = self._whiten([paths[frame] for frame in frames] if fit else ())
        self.rng = np.random.default_rng(0)
        self.pairs = near_pairs(self.tracks, self.rows)
        self.links = [self.pairs[alike(self.tracks, self.pairs, strict)] for strict in _STRICT]
        self.free, self.static = self._static()

    def _whiten(self, paths: Sequence[Path]) -> FloatArray:
        """Matrices (N, F, 2, 2) that make errors standard deviations; 0 where unseen.

        The least variance of a place in an image is that of its gray levels by the structure tensor.
        """
        seen = self.tracks.visible
        covariance = np.eye(2) * self.noise[:, None, None, None] ** 2 * np.ones((*seen.shape, 1, 1))
        for frame, path in enumerate(paths):
            rows, xy = self.tracks.at(frame)
            slopes = [slope / np.float32(8) for slope in cv2.spatialGradient(read_frame(path, "luma"))]
            tensor = cv2.GaussianBlur(np.dstack([a * b for a in slopes for b in slopes]), (0, 0), _WINDOW)
            x, y = np.clip(np.rint(xy).T.astype(np.int64), 0, np.array(tensor.shape[1::-1])[:, None] - 1)
            there = tensor[y, x].reshape(-1, 2, 2).astype(np.float64) + _FLATTEST * np.eye(2)
            covariance[rows, frame] += _GRAY**2 * np.linalg.inv(there)
        return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)) * seen[..., None, None])

    def residuals(self, cameras: FloatArray, rows: IntArray) -> FloatArray:
        """Residuals (n,) of rows (n,) under a body, in standard deviations."""
        points, _ = rigid.triangulate(cameras, self.image[rows])
        return self.fitted(cameras, rows, points)[1]

    def fitted(
        self, cameras: FloatArray, rows: IntArray, points: FloatArray, adapted: int = 3
    ) -> tuple[FloatArray, FloatArray]:
        """Adapt so many coordinates of points (n, 3) of rows to their noise; also return residuals (n,)."""
        best, found = np.full(len(rows), np.inf), points
        image, whiten = np.nan_to_num(self.image[rows]), self.whiten[rows] * self.scale
        columns = cameras[..., [0, 1, 3][:adapted]]
        for _ in range(_PASSES):
            ray = np.insert(points, 2, 1.0, axis=1) @ cameras.swapaxes(1, 2)
            depth = np.maximum(ray[..., 2:], _NEAREST).swapaxes(0, 1)
            shown = ray[..., :2].swapaxes(0, 1) / depth
            off = (whiten @ (shown - image)[..., None]).reshape(len(rows), 2 * image.shape[1], 1)
            square = (off**2).sum(axis=(1, 2))
            found = np.where((square < best)[:, None], points, found)
            best = np.minimum(square, best)
            slope = (columns[:, :2] - shown[..., None] * columns[:, 2:]) / depth[..., None]
            slope = (whiten @ slope).reshape(len(rows), 2 * image.shape[1], adapted)
            back = slope.swapaxes(1, 2)
            points = points.copy()
            points[:, :adapted] -= np.linalg.solve(back @ slope + _TINY * np.eye(adapted), back @ off)[..., 0]
            points[:, 2] = np.maximum(points[:, 2], 0)
        return found, np.sqrt(best / np.maximum(2 * self.length[rows] - 3, 1))

    def costs(self, residuals: FloatArray) -> FloatArray:
        """Robust costs of residuals: what is far off costs little more."""
        return np.asarray(np.log1p((residuals / _UNEXPLAINED) ** 2))

    def adjusted(self, rows: IntArray, most: int) -> FloatArray:
        """Cameras of the body of some rows, of which at most so many are taken, long ones preferred."""
        if len(rows) > most:
            share = self.length[rows] / self.length[rows].sum()
            rows = self.rng.choice(rows, most, replace=False, p=share)
        return rigid.adjust(self.image[rows], self.rng, noise=_ADJUSTED / _FOCAL)

    def _static(self) -> tuple[FloatArray, FloatArray]:
        """Residuals (N,) under the body that explains most, of several starts, then of what it explains."""
        every = np.arange(len(self.tracks))

        def tried(rows: IntArray, most: int) -> tuple[FloatArray, FloatArray, FloatArray]:
            cameras = self.adjusted(rows, most)
            points, _ = rigid.triangulate(cameras, self.image)
            return (*self.fitted(cameras, every, points), cameras)

        def cost(state: tuple[FloatArray, FloatArray, FloatArray]) -> float:
            return float(self.costs(state[1][self.rows]).sum())

        best = min((tried(self.rows, _SCENE) for _ in range(_STARTS)), key=cost)
        for _ in range(2):
            best = min(best, tried(self.rows[best[1][self.rows] < _LEVELS[2]], 2 * _SCENE), key=cost)
        points, free, cameras = best
        low, high = self._bounds(points, free, cameras)
        static, held = free.copy(), np.column_stack([points[:, :2], np.clip(points[:, 2], low, high)])
        bent = np.flatnonzero(held[:, 2] != points[:, 2])
        static[bent] = self.fitted(cameras, bent, held[bent], 2)[1]
        was = self.rows[free[self.rows] < _STATIC]
        return free, free if was.size and (static[was] > _LEVELS[0]).mean() > _MISFITS else static

    def _bounds(self, points: FloatArray, free: FloatArray, cameras: FloatArray) -> FloatArray:
        """Least and largest inverse depth (2, N) of static points: not under the ground, nor floating."""
        seen, shift = self.tracks.visible, cameras[:, 2, 3]
        away = np.insert(points[:, :2], 2, 1.0, axis=1) @ cameras[:, 2, :3].T
        nearness = points[:, 2:] / np.maximum(away + points[:, 2:] * shift, _NEAREST)
        static = seen & ((free < _STATIC) & (self.length >= _SHORTEST))[:, None]
        at = np.insert(self.image, 2, 1.0, axis=2)
        plane = ground_plane(at[static], nearness[static], self.rng)
        if plane is None:
            return np.repeat([[0.0], [np.inf]], len(points), axis=1)
        ground = at @ plane
        shown = static & (np.abs(nearness - ground) < _NEAR_GROUND * ground)
        below = self._below(np.where(shown, ground, np.inf))
        bounds = []
        for bound, none in ((_UNDER * ground, 0.0), (_IN_FRONT * below, np.inf)):
            known = np.isfinite(bound) & (ground > 0)
            bound = np.where(known, bound, 0.0)
            known &= 1 - bound * shift > _NEAREST
            depth = np.where(known, bound * away / np.where(known, 1 - bound * shift, 1.0), none)
            depth[~seen & seen.any(axis=1, keepdims=True)] = np.nan
            bounds.append(np.nanmedian(depth, axis=1))
        return np.asarray(np.maximum(bounds, bounds[0]))

    def _below(self, ground: FloatArray) -> FloatArray:
        """Least value (N, F), of those that are finite, just below each trajectory in each frame."""
        cell = np.where(self.tracks.visible[..., None], self.tracks.xy, 0.0) // _CELL
        column, row = np.moveaxis(cell - cell.min(axis=(0, 1)), 2, 0).astype(np.int64)
        frame = np.broadcast_to(np.arange(self.tracks.n_frames), row.shape)
        table = np.full((self.tracks.n_frames, row.max() + 2, column.max() + 1), np.inf)
        np.minimum.at(table, (frame, row, column), ground)
        table = np.minimum.accumulate(table[:, ::-1], axis=1)[:, ::-1]
        return np.asarray(minimum_filter1d(table, 3, axis=2)[frame, row + 1, column])

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
        sure = [body._replace(worth=body.worth * min(1.0, self.unlike(body.rows) / _UNLIKE)) for body in sure]
        return sorted((body for body in sure if body.worth > _WORTH), key=lambda body: -body.worth)

    def unlike(self, rows: IntArray) -> float:
        """How far trajectories (n,) move unlike what is static beside them, which tracks cling to.

        Median of their least residual against one of these, over that against the scene.
        """
        best = np.full(len(rows), np.inf)
        other = np.setdiff1d(self.rows[self.free[self.rows] < _STATIC], rows)
        for frame in range(0, self.tracks.n_frames, 3):
            k, there = (np.flatnonzero(self.tracks.visible[part, frame]) for part in (rows, other))
            if len(there):
                xy = self.tracks.xy[:, frame]
                near = cKDTree(xy[other[there]]).query_ball_point(xy[rows[k]], _BESIDE)
                for own, beside in zip(k, near, strict=True):
                    best[own] = min(best[own], self._apart_from(rows[own], other[there[beside]]))
        return float(np.median(best / np.maximum(self.free[rows], 1.0)))

    def _apart_from(self, row: int, others: IntArray) -> float:
        """Least residual of a trajectory against those of others that show most of it, shifted."""
        apart = self.tracks.xy[others] - self.tracks.xy[row]
        both = np.isfinite(apart[..., 0])
        enough = both.sum(axis=1) >= max(3, 0.6 * self.length[row])
        apart, freedom = apart[enough], 2 * both[enough].sum(axis=1) - 3
        off = apart - np.nanmean(apart, axis=1, keepdims=True) if len(apart) else apart
        square = np.nansum(off**2, axis=(1, 2)) / freedom
        return float(np.sqrt(square.min(initial=np.inf)) / self.noise[row])


def ground_plane(at: FloatArray, nearness: FloatArray, rng: np.random.Generator) -> FloatArray | None:
    """Find how inverse depth grows (3,) on the ground under a camera that keeps its height.

    Of what lies in the lower half of places (M, 3), homogeneous, y down, a part lies on the ground and little
    under it. None where there is no ground.
    """
    if len(at) < 2 * _FEWEST:
        return None
    lower = rng.permutation(np.flatnonzero(at[:, 1] > np.median(at[:, 1])))[:_PLACES]
    at, nearness = at[lower], nearness[lower]

    def shares(planes: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        ground = at @ planes.T
        on = np.abs(nearness[:, None] - ground) < _NEAR_GROUND * ground
        return on.mean(axis=0), (nearness[:, None] < _UNDER * ground).mean(axis=0), on

    drawn = rng.choice(len(at), (_DRAWS, 3))
    planes = np.einsum("dij,dj->di", np.linalg.pinv(at[drawn]), nearness[drawn])
    planes = planes[planes[:, 1] > 2 * np.abs(planes[:, 0])]
    for _ in range(_REFINED if len(planes) else 0):
        on, under, near = shares(planes)
        best = (on - 2 * under).argmax()
        places, seen = at[near[:, best]], nearness[near[:, best], None]
        weight = 1 / (places @ planes[best])[:, None]
        planes = np.linalg.lstsq(places * weight, seen * weight, rcond=None)[0].T
    return planes[0] if len(planes) and shares(planes)[0][0] > _ON_GROUND else None


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
