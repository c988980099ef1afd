"""Motions found as rigid bodies: over-segment, reconstruct, choose the fewest bodies that explain the clip.

1. Atoms: k-means with more clusters than there are motions, on the fused embedding of the paper's views.
   An atom hardly ever holds two motions; the difficulty is which atoms belong together.
2. Bodies: bundle adjustment of atoms and of unions of similar ones gives cameras of candidate bodies
   (`mseg.geometry.rigid`). A rigid body explains all coordinates of a trajectory in all frames by three
   numbers, so that motion along an epipolar line, which no two views reveal, stands out over many frames.
3. Choice: the grouping of atoms of least cost for each number of motions, and, by a price per motion, the
   number.
4. Refinement: the bodies of the best groupings are adjusted again and compete in another choice; last, each
   trajectory joins the body that explains it and its neighbours best.

The cost of a grouping is ``sum_i w_i c(i, body of i) + coherence * cut + price * mean(w) * motions``:
``c = min(3, log(1 + q / (9 s^2)) + 0.28 log(s^2 / s_0^2))`` for a mean squared residual q of trajectory i
under a body whose own trajectories leave s, s_0 being the noise of the clip, both estimated from residuals.
(0.28 and not 1/2: what a lens or a tracker gets wrong is alike in neighbours, so there are fewer witnesses.
At most 3: a tracker that loses its point may end anywhere, whatever the body; an atom of such trajectories
follows its neighbours.) w_i grows with the length of the trajectory; the cut is the weight of edges between
motions in the mean of the views' graphs, each with unit degrees, times the lesser w of both ends.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.cluster.hierarchy import linkage
from scipy.ndimage import median
from scipy.sparse import csr_array, diags_array
from scipy.spatial.distance import squareform

from kt3dmoseg.compiled import compiled
from kt3dmoseg.options import option
from kt3dmoseg.types import BoolArray, Clip, FloatArray, IntArray, Trajectories
from mseg.clustering.kmeans import kmeans
from mseg.errors import TooFewPointsError
from mseg.geometry import rigid
from mseg.methods.paper import KINDS, Subset
from mseg.types import Segmentation

ALGORITHM_VERSION: int = 11  # raised when results of this method change

# Noise of tracked points, as fractions of the width of the image: the scale on which bodies are adjusted, and
# the least that is believed, below which lenses and trackers err alike for all points.
_NOISE = 2.5e-4
_LEAST_NOISE = 8e-5
# Focal lengths tried (a camera's own is not used), in widths of the image; the usual one, and what a square
# of the logarithm of another over it costs; sets asked, their trajectories, how much one counts at most.
_FOCAL = (0.6, 0.8, 1.1, 1.5, 2.1, 3.0)
_USUAL_FOCAL, _UNUSUAL_FOCAL = 0.8, 10.0
_FOCAL_SETS, _FOCAL_SAMPLE, _FOCAL_DOUBT = 12, 32, 20.0
# Frames and trajectories of a body that are adjusted.
_FRAMES = 10
_SAMPLE = 48
# Residual, in standard deviations of a body, at which a trajectory begins to be unexplained; largest noise of
# a body in noises of the clip.
_UNEXPLAINED = 3.0
_NOISIEST = 10.0
# Cost of a body's noise, per trajectory and logarithm of its variance over the clip's.
_NOISIER = 0.28
# Cost of a trajectory that fits no motion, at most.
_MISFIT = 3.0
# A trajectory is still that stays within this of its mean, in widths of the image; what leaves it by more
# than three times as much has moved. Where at least this share is still, the camera is. A body that moves
# explains still points, too, as points far away, which cost this much then: they have a place and no depth.
# In fewer frames than the last of these a camera that moves slowly looks still, too.
_STILL, _STILL_SHARE, _FAR_AWAY, _LEAST_LIFE = 7.5e-4, 0.3, 1.0, 5
# A trajectory of this many frames weighs 1, the heaviest one 1.5.
_USUAL_LENGTH = 10
_HEAVIEST = 1.5
# Power of the kernel and restarts of k-means for the atoms. The weak ties of the paper's methods, which keep
# few clusters whole, would tie small motions to the static scene.
_ALPHA = 8.0
_RESTARTS = 50
# Sets that share this part of their trajectories give the same body.
_SAME = 0.9
_SMALLEST = 6
_SWEEPS = 10
# Least fall of the cost that counts as one.
_GAIN = 1e-9
# Price of a body and coherence in partitions that were not made to cost little.
_PRICE_OF_ANY, _COHERENCE_OF_ANY = 8.0, 18.0


@dataclass(frozen=True)
class MultiBody:
    """Rigid bodies, each reconstructed over all frames; finds the number of motions itself, or takes it.

    Source: ours, on the fused views of Xu, Cheong, Li, CVPR 2018. Input: gaps allowed. Number of motions:
    found, or given. Cost: that of "subset", and about 160 small bundle adjustments.
    """

    atoms: int = option(20, "clusters of the over-segmentation", low=2)
    price: float = option(17.0, "cost of a motion, for trajectories of ten frames", low=0)
    coherence: float = option(12.0, "cost of an edge between motions, per unit of degree", low=0)
    most: int = option(7, "largest number of motions that is looked for", low=1)
    reject_outliers: bool = option(False, "label 0 for trajectories that fit no motion")

    def segment(self, clip: Clip, *, n_motions: int | None, rng: np.random.Generator) -> Segmentation:
        """Segment the evaluated trajectories of `clip`; see `mseg.types.Method.segment`.

        The report holds `n_motions`, the `costs` of each number of motions and the `margin` to the next best.
        """
        fused = Subset(alpha=_ALPHA, max_sweeps=1)
        *streams, body_rng = rng.spawn(len(KINDS) + 1)
        views, used = fused.views(clip, streams, n_motions or 1)
        count = min(max(self.atoms, 2 * (n_motions or 1)), int(used.sum()))
        embedding = fused.fuse([fused.laplacian(view) for view in views], count).joint().astype(np.float32)
        atoms = kmeans(embedding, count, body_rng, n_restarts=_RESTARTS).labels
        points = clip.evaluated_trajectories.select(used)
        scene = _Scene(points, _edges(views, self.coherence), atoms, body_rng)
        found = scene.groupings(max(self.most, n_motions or 1), self.price)
        costs = {number: grouping.cost for number, grouping in found.items()}
        # A clip of few atoms may not come apart into as many motions as are asked for.
        best = min(costs, key=costs.__getitem__) if n_motions is None else min(n_motions, max(costs))
        others = [cost for number, cost in costs.items() if number != best]
        labels = found[best].labels + 1
        if self.reject_outliers:
            labels[found[best].misfit] = 0
        report: dict[str, Any] = {
            "views": [*KINDS],
            "n_motions": best,
            "costs": costs,
            "margin": min(others) - costs[best] if others else None,
            "noise": scene.noise * scene.width,
            "focal": scene.focal * scene.width,
        }
        return Segmentation.of_part(labels, used, report)


def _means(points: Trajectories) -> FloatArray:
    """Mean place (N, 2) of each trajectory."""
    return np.asarray(np.nansum(points.xy, axis=1) / np.maximum(points.lengths, 1)[:, None])


def _edges(views: Sequence[csr_array], weight: float) -> csr_array:
    """Mean of the views' graphs, each with unit degrees, times a weight."""
    total = csr_array(views[0].shape)
    for view in views:
        root = diags_array(1 / np.sqrt(np.maximum(view.sum(axis=1), np.finfo(np.float32).tiny)))
        total = total + root @ view @ root
    return csr_array(total * (weight / len(views)))


@dataclass(frozen=True, eq=False)
class _Body:
    """A candidate: mean squared residual (N,) of all trajectories, and that of its own."""

    square: FloatArray
    own: float


class _Choice(NamedTuple):
    """Some bodies (M,), the one (A,) that each atom follows, and what they cost without the price."""

    cost: float = np.inf
    bodies: IntArray = np.empty(0, dtype=np.int64)
    group: IntArray = np.empty(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class _Grouping:
    """Labels (N,), 0..M-1, their cost, and which trajectories (N,) fit no motion."""

    cost: float
    labels: IntArray
    misfit: BoolArray


class _Scene:
    """A clip's trajectories and atoms, and the search among groupings of the atoms into bodies."""

    def __init__(
        self, points: Trajectories, edges: csr_array, atoms: IntArray, rng: np.random.Generator
    ) -> None:
        seen = points.xy[points.visible]
        low, high = seen.min(axis=0), seen.max(axis=0)
        self.width = float(points.image_size[0]) if points.image_size else float(max(high - low)) or 1.0
        centre = (np.array(points.image_size) - 1) / 2 if points.image_size else (low + high) / 2
        frames = np.unique(np.linspace(0, points.n_frames - 1, _FRAMES).round().astype(np.int64))
        self.image = (points.xy[:, frames] - centre) / self.width
        self.length = points.visible[:, frames].sum(axis=1)
        self.freedom = np.maximum(2 * self.length - 3, 1)
        self.weight = np.minimum(points.lengths / _USUAL_LENGTH, _HEAVIEST)
        # Where a trajectory is short, its graph's edges tell as little as its residuals.
        ends = edges.tocoo()
        lighter = np.minimum(self.weight[ends.row], self.weight[ends.col])
        self.edges, self.rng = csr_array((ends.data * lighter, (ends.row, ends.col)), edges.shape), rng
        _, self.atom = np.unique(atoms, return_inverse=True)
        self.member = self.atom == np.arange(self.atom.max() + 1)[:, None]
        self.size = (self.member & (self.length > 1)).sum(axis=1)
        indicator = self.member.astype(np.float64)
        self.atom_edges = indicator @ (self.edges @ indicator.T)
        self.focal, self.noise, self.misfit = 1.0, _NOISE, _MISFIT
        off = np.where(points.visible, np.linalg.norm(points.xy - _means(points)[:, None], axis=2), 0.0)
        apart = np.sqrt((off**2).sum(axis=1) / np.maximum(points.lengths, 1)) / self.width
        judged = points.lengths >= _LEAST_LIFE
        still, moved = judged & (apart < _STILL), judged & (apart > 3 * _STILL)
        stands = still.sum() > _STILL_SHARE * judged.sum()
        self.still, self.moved = stands & still, stands & moved

    def groupings(self, most: int, price: float) -> dict[int, _Grouping]:
        """Best grouping into M motions, for each M."""
        sets = self._unions()
        if not sets:
            raise TooFewPointsError(
                "multibody",
                expected=f"{_SMALLEST} trajectories that live long enough",
                found=str(self.size.sum()),
            )
        # The cameras of a motion have parameters in every frame that its trajectories live.
        price *= float(self.weight.mean())
        self.focal = self._focal(sets)
        bodies = self._bodies(sets)
        self._measure_noise(bodies)
        bodies += self._bodies(self._distinct([self._explained(body) for body in bodies], sets))
        choices = self._choose(bodies, most)
        groups = [choice.group == k for choice in choices.values() for k in range(len(choice.bodies))]
        bodies += self._bodies(self._distinct(groups))
        choices = self._choose(bodies, most)
        return {
            number: self._refine([bodies[b] for b in choice.bodies], choice.group, price)
            for number, choice in sorted(choices.items())
        }

    def _unions(self) -> list[BoolArray]:
        """Masks (A,) of the atoms, and of the unions that average linkage makes of them."""
        size = self.member.sum(axis=1)
        sets = list(np.eye(len(size), dtype=np.bool_))
        if len(size) > 1:
            similar = self.atom_edges / (size[:, None] * size)
            distance = similar.max() - similar
            np.fill_diagonal(distance, 0)
            for first, second, _, _ in linkage(squareform(distance, checks=False), "average"):
                sets.append(sets[int(first)] | sets[int(second)])
        return self._distinct(sets)

    def _distinct(self, sets: list[BoolArray], known: Sequence[BoolArray] = ()) -> list[BoolArray]:
        """Those of the sets of atoms that are large enough and unlike the known ones and the ones before."""
        every = np.array([*known, *sets])
        shared = every @ (self.size * every).T
        own = shared.diagonal()
        alike = shared >= _SAME * (own[:, None] + own - shared)
        kept = [*range(len(known))]
        for k in range(len(known), len(every)):
            if own[k] >= _SMALLEST and not alike[k, kept].any():
                kept.append(k)
        return [every[k] for k in kept[len(known) :]]

    def _sample(self, atoms: BoolArray, most: int = _SAMPLE) -> IntArray:
        """Draw some trajectories of a set of atoms, long ones preferred."""
        rows = np.flatnonzero(self.member[atoms].any(axis=0) & (self.length > 1))
        share = self.length[rows] / self.length[rows].sum()
        return rows if len(rows) <= most else self.rng.choice(rows, most, replace=False, p=share)

    def _focal(self, sets: list[BoolArray]) -> float:
        """Focal length, in widths, that lets sets be rigid best.

        Sets of more than a third of all may hold two motions, which some focal length makes one body.
        """
        largest = sorted(sets, key=lambda atoms: -int(self.size[atoms].sum()))
        small = [atoms for atoms in largest if 3 * self.size[atoms].sum() <= self.size.sum()] or largest
        costs = self.focal_costs(small[:_FOCAL_SETS], _FOCAL_SAMPLE)
        excess = np.minimum(costs - costs.min(axis=1, keepdims=True), _FOCAL_DOUBT).sum(axis=0)
        return _FOCAL[int((excess + _UNUSUAL_FOCAL * np.log(np.divide(_FOCAL, _USUAL_FOCAL)) ** 2).argmin())]

    def focal_costs(self, sets: list[BoolArray], most: int) -> FloatArray:
        """Compute what sets cost (B, L) under each focal length."""
        samples = [self.image[self._sample(atoms, most)] for atoms in sets]
        return rigid.focal_costs(samples, self.rng, noise=_NOISE, lengths=_FOCAL)

    def _bodies(self, sets: list[BoolArray]) -> list[_Body]:
        """Adjust a body to each set of atoms."""
        image, noise = self.image / self.focal, _NOISE / self.focal
        bodies = []
        for atoms in sets:
            cameras = rigid.adjust(image[self._sample(atoms)], self.rng, noise=noise)
            _, residual = rigid.triangulate(cameras, image)
            square = residual * self.focal**2 / self.freedom
            bodies.append(_Body(square, float(np.median(square[self.member[atoms].any(axis=0)]))))
        return bodies

    def _measure_noise(self, bodies: list[_Body]) -> None:
        least = np.min([body.square for body in bodies], axis=0)
        self.noise = max(float(np.sqrt(np.median(least))), _LEAST_NOISE)

    def _scale(self, body: _Body) -> float:
        """Variance of a body's residuals, within what noise can be."""
        return float(np.clip(body.own, self.noise**2, (_NOISIEST * self.noise) ** 2))

    def _explained(self, body: _Body) -> BoolArray:
        """Atoms that a body explains."""
        limit = _UNEXPLAINED**2 * self._scale(body)
        return np.asarray(median(body.square, self.atom, np.arange(len(self.member))) < limit)

    def _costs(self, bodies: list[_Body]) -> FloatArray:
        """Cost (B, N) of trajectories under bodies; see the module."""
        scale = np.array([self._scale(body) for body in bodies])[:, None]
        square = np.stack([body.square for body in bodies])
        relative = square / (_UNEXPLAINED**2 * scale)
        cost = np.minimum(np.log1p(relative) + _NOISIER * np.log(scale / self.noise**2), self.misfit)
        moves = (relative[:, self.moved] < 1).sum(axis=1) >= _SMALLEST
        return np.asarray(self.weight * (cost + _FAR_AWAY * (moves[:, None] & self.still)))

    def _choose(self, bodies: list[_Body], most: int) -> dict[int, _Choice]:
        """Choose M bodies and the one that each atom follows, for each M.

        Choices of M start from those of M - 1 with one body more and from those of M + 1 with one less, and
        swap bodies, up and down until none gets better.
        """
        table = self._costs(bodies) @ self.member.T
        every = np.arange(len(bodies))[:, None]
        best: dict[int, _Choice] = {}

        def improve(options: IntArray) -> bool:
            found = _Choice(*_swapped(table, self.atom_edges, options))
            if found.cost >= best.get(len(found.bodies), _Choice()).cost - _GAIN:
                return False
            best[len(found.bodies)] = found
            return True

        better, top = improve(every), min(most, len(bodies), len(self.member))
        while better:
            better = False
            for known in range(1, top):
                if known in best:
                    more = np.tile(best[known].bodies, (len(bodies), 1))
                    better |= improve(np.concatenate([more, every], axis=1))
            for known in range(top, 1, -1):
                if known in best:
                    better |= improve(np.stack([np.delete(best[known].bodies, k) for k in range(known)]))
        return best

    def _refine(self, bodies: list[_Body], group: IntArray, price: float) -> _Grouping:
        """Let single trajectories change their motion (iterated conditional modes)."""
        costs, number, every = self._costs(bodies), len(bodies), np.arange(len(self.atom))
        labels = start = group[self.atom]
        for _ in range(_SWEEPS):
            support = self.edges @ (labels[:, None] == np.arange(number)).astype(np.float64)
            wanted = (costs.T - support).argmin(axis=1)
            if (wanted == labels).all():
                break
            # Half of them at a time: neighbours that change together undo each other.
            labels = np.where(self.rng.random(len(labels)) < 0.5, wanted, labels)
        if len(np.unique(labels)) < number:
            labels = start
        rows, columns = self.edges.nonzero()
        cut = self.edges.data[labels[rows] != labels[columns]].sum() / 2
        paid = costs[labels, every]
        return _Grouping(float(paid.sum() + cut + price * number), labels, paid >= self.misfit * self.weight)


@compiled
def _swapped(table: FloatArray, edges: FloatArray, options: IntArray) -> tuple[float, IntArray, IntArray]:
    """Swap bodies, one at a time, from the best of choices (C, M) on; see `_Choice`."""
    group, cost, bodies = np.zeros(table.shape[1], np.int64), np.inf, options[0]
    for start in options:
        found = _follow(table, edges, start, group)
        if found < cost:
            cost, bodies = found, start
    better = True
    while better:
        start, better = bodies, False
        for k in range(len(start)):
            for body in range(len(table)):
                tried = start.copy()
                tried[k] = body
                found = _follow(table, edges, tried, group)
                if found < cost - _GAIN:
                    cost, bodies, better = found, tried, True
    return _follow(table, edges, bodies, group), bodies, group


@compiled
def _follow(table: FloatArray, edges: FloatArray, bodies: IntArray, group: IntArray) -> float:
    """Write which of some bodies each atom follows, and return the cost: infinite if none follows one."""
    fits = np.ones(len(group), np.bool_)
    for atom in range(len(group)):
        best = 0
        for k in range(1, len(bodies)):
            more = table[bodies[k], atom] - table[bodies[best], atom]
            if more < -_GAIN:
                best, fits[atom] = k, True
            elif more < _GAIN:
                fits[atom] = False
        group[atom] = best
    _follow_neighbours(table, edges, bodies, group, fits)
    cost, followed = 0.0, np.zeros(len(bodies), np.bool_)
    for atom in range(len(group)):
        followed[group[atom]] = True
        cost += table[bodies[group[atom]], atom]
        for other in range(atom):
            if group[other] != group[atom]:
                cost += edges[atom, other]
    return cost if followed.all() else np.inf


@compiled
def _follow_neighbours(
    table: FloatArray, edges: FloatArray, bodies: IntArray, group: IntArray, fits: BoolArray
) -> None:
    """Let atoms that fit no body, so that several cost the same, join the one to which most edges lead."""
    for atom in range(len(group)):
        if fits[atom]:
            continue
        near, least = np.zeros(len(bodies)), table[bodies[group[atom]], atom]
        for other in range(len(group)):
            if fits[other]:
                near[group[other]] += edges[atom, other]
        for k in range(len(bodies)):
            if table[bodies[k], atom] < least + _GAIN and near[k] > near[group[atom]]:
                group[atom] = k
        fits[atom] = True


def code_lengths(
    points: Trajectories,
    views: Sequence[csr_array],
    partitions: Mapping[int, IntArray],
    rng: np.random.Generator,
) -> dict[int, float]:
    """Cost, much as `MultiBody` has it, of partitions (N,) of N trajectories, by number of motions.

    A body is adjusted to every group. A partition with a group too small for one has no cost.
    """
    _, atoms = np.unique(np.stack([*partitions.values()], axis=1), axis=0, return_inverse=True)
    # Atoms are the trajectories that no partition parts; they need not fit at all.
    scene = _Scene(points, _edges(views, _COHERENCE_OF_ANY), atoms.ravel(), rng)
    scene.misfit = np.inf
    of_atoms = np.unique(scene.atom, return_index=True)[1]
    groups: dict[int, list[BoolArray]] = {}
    for number, labels in partitions.items():
        parts = [labels[of_atoms] == k for k in np.unique(labels)]
        if all(scene.size[part].sum() >= _SMALLEST for part in parts):
            groups[number] = parts
    sets = {part.tobytes(): part for parts in groups.values() for part in parts}
    if not sets:
        return {}
    largest = sorted(sets.values(), key=lambda part: -int(scene.size[part].sum()))[:6]
    scene.focal = _FOCAL[int(scene.focal_costs(largest, _SAMPLE).sum(axis=0).argmin())]
    bodies = scene._bodies([*sets.values()])
    scene._measure_noise(bodies)
    table = dict(zip(sets, scene._costs(bodies) @ scene.member.T, strict=True))
    found = {}
    for number, parts in groups.items():
        group = np.argmax(parts, axis=0)
        cut = scene.atom_edges[group[:, None] != group].sum() / 2
        paid = sum(table[part.tobytes()][part].sum() for part in parts)
        found[number] = float(paid + cut + _PRICE_OF_ANY * len(parts))
    return found
