"""How many motions: which of a method's partitions, of 1, 2, 3, ... motions, rigid bodies explain best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.sparse import csr_array

from kt3dmoseg.types import BoolArray, IntArray, Trajectories
from mseg.methods.multibody import _SMALLEST, _edges, _Scene

# As in `multibody`, but of partitions that were not made to cost little; see docs/methods.md.
_PRICE, _COHERENCE = 8.0, 18.0


def code_lengths(
    points: Trajectories,
    views: Sequence[csr_array],
    partitions: Mapping[int, IntArray],
    rng: np.random.Generator,
) -> dict[int, float]:
    """Cost, as `mseg.methods.multibody` has it, of partitions (N,) of N trajectories, by number of motions.

    A body is adjusted to every group. A partition with a group too small for one has no cost.
    """
    _, atoms = np.unique(np.stack([*partitions.values()], axis=1), axis=0, return_inverse=True)
    return _Partitions(points, _edges(views, _COHERENCE), atoms.ravel(), rng).costs_of(partitions)


class _Partitions(_Scene):
    """A clip whose atoms are the trajectories that no partition parts."""

    def costs_of(self, partitions: Mapping[int, IntArray]) -> dict[int, float]:
        of_atoms = np.unique(self.atom, return_index=True)[1]
        groups: dict[int, list[BoolArray]] = {}
        for number, labels in partitions.items():
            parts = [labels[of_atoms] == k for k in np.unique(labels)]
            if all(self.size[part].sum() >= _SMALLEST for part in parts):
                groups[number] = parts
        sets = {part.tobytes(): part for parts in groups.values() for part in parts}
        if not sets:
            return {}
        self.focal = self._focal([*sets.values()])
        bodies = self._bodies([*sets.values()])
        self._measure_noise(bodies)
        table = dict(zip(sets, self._costs(bodies) @ self.member.T, strict=True))
        found = {}
        for number, parts in groups.items():
            group = np.argmax(parts, axis=0)
            cut = self.atom_edges[group[:, None] != group].sum() / 2
            found[number] = float(sum(table[p.tobytes()][p].sum() for p in parts) + cut + _PRICE * len(parts))
        return found
