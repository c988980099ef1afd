"""The kernel of one view of a clip: ordered residual kernels of all frame pairs, averaged."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby, islice, pairwise
from typing import TypeVar

import numpy as np

from kt3dmoseg.types import Float32Array, FloatArray, IntArray, Trajectories
from mseg.affinity.ordered_residuals import preferences, top_count
from mseg.geometry import Distance, change_frame, hartley, residuals
from mseg.types import Hypotheses

# The authors' guard against division by zero, part of the values that alpha is applied to.
GUARD = 0.1
_PAIRS_AT_A_TIME = 4
# Rows spread into the sum at once: few enough that their copy stays in the cache.
_ROWS_AT_A_TIME = 128
_T = TypeVar("_T")


def view_kernel(
    trajectories: Trajectories,
    hypotheses: Hypotheses,
    *,
    fraction: float = 0.1,
    distance: Distance = "sampson",
) -> Float32Array:
    """Accumulate ordered residual kernels over frame pairs and divide by co-visibility.

    Parameters
    ----------
    trajectories : Trajectories
        The N points to compare.
    hypotheses : Hypotheses
        Models in pixel coordinates; each pair of frames is ranked by itself.
    fraction : float
        Part of a pair's hypotheses that a point prefers.
    distance : {"sampson", "transfer"}
        Residual.

    Returns
    -------
    (N, N) float32
        Symmetric, in 0..1: sum over pairs of shared preferences, divided by the number of frames
        in which both points are visible, plus 0.1. Zero for points that never meet.

    References
    ----------
    Xu, Cheong, Li, "Motion segmentation by exploiting complementary geometric models", CVPR 2018,
    section 3.1.
    """
    total: Float32Array = np.zeros((len(trajectories), len(trajectories)), dtype=np.float32)
    for rows, marks, count in _marked_chunks(trajectories, hypotheses, fraction, distance):
        shared = marks @ marks.T
        shared /= np.float32(count)
        for start in range(0, len(rows), _ROWS_AT_A_TIME):
            part = slice(start, start + _ROWS_AT_A_TIME)
            total[np.ix_(rows[part], rows)] += shared[part]
    total /= covisible_frames(trajectories) + np.float32(GUARD)
    return total


def covisible_frames(trajectories: Trajectories) -> Float32Array:
    """Count (N, N) the frames in which both of two trajectories are visible."""
    seen = trajectories.visible.astype(np.float32)
    together: Float32Array = seen @ seen.T
    return together


def _marked_chunks(
    trajectories: Trajectories, hypotheses: Hypotheses, fraction: float, distance: Distance
) -> Iterator[tuple[IntArray, Float32Array, int]]:
    """Yield rows (R,), their preferred hypotheses (R, M) as 0 and 1, and how many each prefers.

    Several frame pairs at a time: one product of their marks side by side is the sum of their
    kernels, and the sum is spread into the large matrix once.
    """
    pairs, start = np.unique(hypotheses.pair, axis=0, return_index=True)
    parts = [slice(b, e) for b, e in pairwise([*start, len(hypotheses.pair)])]
    for count, group in groupby(
        zip(pairs, parts, strict=True), key=lambda item: top_count(item[1].stop - item[1].start, fraction)
    ):
        for chunk in _batched(group, _PAIRS_AT_A_TIME):
            yield *_marks(trajectories, hypotheses, chunk, count, distance), count


def _marks(
    trajectories: Trajectories,
    hypotheses: Hypotheses,
    chunk: Sequence[tuple[IntArray, slice]],
    count: int,
    distance: Distance,
) -> tuple[IntArray, Float32Array]:
    seen = [(part, *trajectories.pair(int(i), int(j))) for (i, j), part in chunk]
    rows = np.unique(np.concatenate([r for _, r, _, _ in seen]))
    marks: Float32Array = np.zeros((len(rows), sum(p.stop - p.start for p, *_ in seen)), dtype=np.float32)
    column = 0
    for part, visible, x1, x2 in seen:
        end = column + part.stop - part.start
        if len(visible):
            residual = _pair_residuals(hypotheses, part, x1, x2, distance)
            marks[np.searchsorted(rows, visible), column:end] = preferences(residual, count)
        column = end
    return rows, marks


def _pair_residuals(
    hypotheses: Hypotheses, part: slice, x1: FloatArray, x2: FloatArray, distance: Distance
) -> Float32Array:
    """Residuals (P, K) in the pair's own normalised frame; single precision is enough to rank."""
    n1, t1 = hartley.normalise(x1)
    n2, t2 = hartley.normalise(x2)
    models = change_frame(hypotheses.kind, hypotheses.models[part], t1, t2)
    single = n1.astype(np.float32), n2.astype(np.float32)
    return residuals(hypotheses.kind, models, *single, distance=distance)


def _batched(items: Iterable[_T], size: int) -> Iterator[list[_T]]:
    """Split into lists of at most `size` (itertools.batched is new in Python 3.12)."""
    iterator = iter(items)
    while chunk := list(islice(iterator, size)):
        yield chunk
