"""How far two labellings of the same trajectories, or two annotators' regions, agree."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from kt3dmoseg.annotate.formats.masks import mask_of
from kt3dmoseg.annotate.propagation import Region
from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.matching import match_labels
from kt3dmoseg.types import ByteArray, FloatArray, IntArray

# Bytes of eight pixels each, of all objects together, that are compared at once.
_BLOCK = 1 << 18


@dataclass(frozen=True, eq=False)
class Agreement:
    """Agreement of labellings (n,): the labels of `a` renamed to the matching ones of `b`, or to others.

    `matching` maps labels of the given `a` to labels of `b`.
    """

    a: IntArray
    b: IntArray
    matching: dict[int, int]

    @property
    def agreement(self) -> float:
        """Share of trajectories with the same label; one that only one side labelled counts as different.

        >>> agree([1, 1, 2, 0], [1, 1, 1, 1]).agreement
        0.5
        """
        return float(np.mean(self.a == self.b)) if len(self.a) else 1.0

    @property
    def both(self) -> float:
        """Share of the trajectories that both sides labelled with the same label.

        >>> round(agree([1, 1, 2, 0], [1, 1, 1, 1]).both, 3)
        0.667
        """
        labelled = (self.a != 0) & (self.b != 0)
        return float(np.mean((self.a == self.b)[labelled])) if labelled.any() else 1.0

    @property
    def kappa(self) -> float:
        """Cohen's kappa (1960), with "unlabelled" as a category: 1 = equal, 0 = as by chance.

        >>> agree([1, 1, 2, 2], [1, 1, 2, 1]).kappa
        0.5
        """
        either = np.union1d(self.a, self.b)
        chance = sum(float(np.mean(self.a == label) * np.mean(self.b == label)) for label in either)
        return 1.0 if len(either) < 2 else (self.agreement - chance) / (1.0 - chance)

    @property
    def differences(self) -> IntArray:
        """Rows that differ, ascending."""
        return np.flatnonzero(self.a != self.b)

    def groups(self) -> list[tuple[int, int, IntArray]]:
        """Return the differing rows by (label of a, label of b), the largest group first."""
        pairs = np.unique(np.column_stack([self.a, self.b])[self.differences], axis=0).tolist()
        found = [(x, y, np.flatnonzero((self.a == x) & (self.b == y))) for x, y in pairs]
        return sorted(found, key=lambda group: -len(group[2]))


def agree(a: npt.ArrayLike, b: npt.ArrayLike) -> Agreement:
    """Compare two labellings (n,) of the same trajectories; 0 = unlabelled.

    The labels of `a` are renamed by the one-to-one assignment with the largest overlap (Kuhn 1955).
    Raises InvalidValueError when the lengths differ.
    """
    mine, other = np.asarray(a, dtype=np.int64), np.asarray(b, dtype=np.int64)
    if mine.ndim != 1 or mine.shape != other.shape:
        found = f"{mine.shape} and {other.shape}"
        raise InvalidValueError("labels", expected="two vectors of one length", found=found)
    matching = match_labels(mine, other)
    spare = int(max(other.max(initial=0), mine.max(initial=0))) + 1
    names = {0: 0} | {label: spare + label for label in mine.tolist() if label} | matching
    return Agreement(np.array([names[label] for label in mine.tolist()], dtype=np.int64), other, matching)


def overlaps(
    a: Mapping[int, list[Region]], b: Mapping[int, list[Region]], image_size: tuple[int, int]
) -> FloatArray:
    """Return the intersection over union (len(a), len(b)) of objects, of the visible pixels of all frames."""
    width = -(-image_size[0] * image_size[1] // 8)

    def masks(side: Mapping[int, list[Region]], frame: int) -> ByteArray:
        shown = (regions[frame] for regions in side.values())
        drawn = [mask_of(r.polygons if r.visibility == "visible" else (), image_size) for r in shown]
        return np.array([np.packbits(mask) for mask in drawn], dtype=np.uint8).reshape(len(side), width)

    shared, union = np.zeros((len(a), len(b))), np.zeros((len(a), len(b)))
    step = max(1, _BLOCK // (len(a) + len(b) + 1))
    for frame in range(max((len(regions) for regions in (*a.values(), *b.values())), default=0)):
        packed = masks(a, frame), masks(b, frame)
        for first in range(0, width, step):
            mine, theirs = (
                np.unpackbits(side[:, first : first + step], axis=1).astype(np.float32) for side in packed
            )
            both = mine @ theirs.T
            shared += both
            union += mine.sum(axis=1)[:, None] + theirs.sum(axis=1) - both
    return np.asarray(shared / np.maximum(union, 1), dtype=np.float64)


def match_regions(
    a: Mapping[int, list[Region]], b: Mapping[int, list[Region]], image_size: tuple[int, int]
) -> list[tuple[int, int, float]]:
    """Pair the objects of two annotators so that they overlap most (Kuhn 1955).

    Returns ids and overlap; an object without a counterpart comes with id 0 and overlap 0.
    """
    overlap, ids_a, ids_b = overlaps(a, b, image_size), list(a), list(b)
    chosen = zip(*linear_sum_assignment(overlap, maximize=True), strict=True)
    pairs = [(ids_a[i], ids_b[j], float(overlap[i, j])) for i, j in chosen if overlap[i, j] > 0]
    alone_a = set(ids_a) - {i for i, _, _ in pairs}
    alone_b = set(ids_b) - {j for _, j, _ in pairs}
    return pairs + [(i, 0, 0.0) for i in sorted(alone_a)] + [(0, j, 0.0) for j in sorted(alone_b)]
