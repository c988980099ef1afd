"""The table of true motions against predicted groups, and the best assignment of groups to motions."""

import math
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import permutations

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.io.predictions import label_vector
from kt3dmoseg.types import FloatArray, IntArray

_MAX_SEARCH = 1000


@dataclass(frozen=True, eq=False)
class Contingency:
    """How many trajectories of each motion are in each predicted group.

    Trajectories without a true label (0) are not in the table. Predicted 0 means "outlier, in no
    group": such trajectories are counted apart, in `unassigned`.
    """

    counts: IntArray  # (M, G): trajectories of motion i in group j
    unassigned: IntArray  # (M,): trajectories of motion i that were predicted 0
    motions: IntArray  # (M,): the true labels of the rows, ascending
    groups: IntArray  # (G,): the predicted labels of the columns, ascending
    background: int | None = None  # the row of the static scene, when the truth names it

    @cached_property
    def assignment(self) -> IntArray:
        """Group of each motion, (M,): the one-to-one choice with most agreement; -1 = none."""
        return best_assignment(self.counts, self.sizes)

    @cached_property
    def sizes(self) -> IntArray:
        """Trajectories of each motion, (M,)."""
        return np.asarray(self.counts.sum(axis=1) + self.unassigned, dtype=np.int64)

    @property
    def static(self) -> int:
        """Row of the static scene; where the truth does not name it, that of the largest motion."""
        return int(np.argmax(self.sizes)) if self.background is None else self.background

    @property
    def n(self) -> int:
        """Number of scored trajectories."""
        return int(self.sizes.sum())

    def shared(self, assignment: IntArray) -> tuple[IntArray, IntArray]:
        """Trajectories that each motion shares with its group, and those of the group, (M,); 0 for -1."""
        padded = np.pad(self.counts, ((0, 0), (0, 1)))  # the last column, which -1 picks, is no group
        return padded[np.arange(len(padded)), assignment], padded.sum(axis=0)[assignment]


def contingency(truth: npt.ArrayLike, pred: npt.ArrayLike, *, background: int | None = None) -> Contingency:
    """Count true motions (n,) against predicted groups (n,); `background` is the label of the static scene.

    Truth 0 = not scored; prediction 0 = outlier. InvalidValueError when the vectors are no labels, differ in
    length, or no trajectory has a true label.

    >>> contingency([1, 1, 2, 2, 0], [5, 5, 5, 9, 9]).counts.tolist()
    [[2, 0], [1, 1]]
    """
    true, predicted = label_vector(truth, "truth"), label_vector(pred, "pred")
    if len(true) != len(predicted):
        expected = f"{len(true)} labels, as many as truth"
        raise InvalidValueError("pred", expected=expected, found=f"{len(predicted)}")
    scored = true > 0
    if not scored.any():
        raise InvalidValueError("truth", expected="at least one label > 0", found="none")
    motions, row = np.unique(true[scored], return_inverse=True)
    groups, column = np.unique(predicted[scored], return_inverse=True)
    table = np.zeros((len(motions), len(groups)), dtype=np.int64)
    np.add.at(table, (row, column), 1)
    none = groups == 0
    static = motions.tolist().index(background) if background in motions else None
    return Contingency(table[:, ~none], table[:, none].sum(axis=1), motions, groups[~none], static)


def best_assignment(counts: IntArray, sizes: IntArray | None = None) -> IntArray:
    """Choose a different group for each motion so that most trajectories agree: columns (M,), -1 = none.

    Of equally good choices, that with the larger sum of intersections over unions is taken; `sizes` (M,) are
    those of the motions where some of their trajectories are in no group. Here the first motion has 3 + 2
    trajectories and the second 4 + 0; the other choice would agree on 3 + 0:

    >>> best_assignment(np.array([[3, 2], [4, 0]])).tolist()
    [1, 0]
    """
    motions = counts.sum(axis=1) if sizes is None else sizes
    union = motions[:, None] + counts.sum(axis=0) - counts
    overlap = counts / np.maximum(union, 1)
    # Each overlap is at most 1, so all of them together weigh less than one trajectory.
    return assign(counts + overlap / (2 * max(1, min(counts.shape))))


def assign(gain: FloatArray) -> IntArray:
    """Maximise the sum of gains (M, G) >= 0 over one-to-one choices (Kuhn 1955): columns (M,), -1 = none."""
    chosen = np.full(len(gain), -1, dtype=np.int64)
    if gain.size:
        # A fixed order of the columns makes the choice independent of how groups are numbered.
        order = np.lexsort(gain)
        rows, columns = _solve(gain[:, order])
        chosen[rows] = order[columns]
        chosen[gain[np.arange(len(gain)), chosen] <= 0] = -1
    return chosen


def _solve(gain: FloatArray) -> tuple[IntArray, IntArray]:
    """Find the best one-to-one choice: by search when it is small, else with scipy."""
    few, many = sorted(gain.shape)
    # The search spares the import of scipy.optimize, which takes longer than scoring a benchmark.
    if math.perm(many, few) > _MAX_SEARCH:
        from scipy.optimize import linear_sum_assignment

        rows, columns = linear_sum_assignment(gain, maximize=True)
        return rows, columns
    if len(gain) > few:
        columns, rows = _solve(gain.T)
        return rows, columns
    choices = _choices(many, few)
    return np.arange(few), choices[np.argmax(gain[np.arange(few), choices].sum(axis=1))]


@cache
def _choices(many: int, few: int) -> IntArray:
    """Every ordered choice of `few` out of `many`, (P, few)."""
    return np.array(list(permutations(range(many), few)), dtype=np.int64)
