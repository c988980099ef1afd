"""The kernel of one view of a clip: ordered residual kernels of all frame pairs, averaged."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.linalg.blas import ssyrk

from kt3dmoseg.types import Float32Array, FloatArray, IntArray, Trajectories
from mseg.geometry import Distance, FramePair, change_frame, frame_pair, residuals
from mseg.kernels.ordered_residuals import preferences, top_count
from mseg.types import Hypotheses

# The authors' guard against division by zero, part of the values that alpha is applied to.
GUARD = 0.1
# Rows spread into the sum at once: few enough that their copy stays in the cache.
_BLOCK = 128


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
    parts = _pairs(hypotheses)
    usual = top_count(max(map(_length, parts), default=0), fraction)
    pairs = [frame_pair(trajectories, *hypotheses.pair[part.start].tolist()) for part in parts]
    models = _in_frames_of_pairs(hypotheses, parts, pairs)
    for part, pair in zip(parts, pairs, strict=True):
        if not len(pair.rows):
            continue
        single = pair.x1.astype(np.float32), pair.x2.astype(np.float32)
        residual = residuals(hypotheses.kind, models[part], *single, distance=distance)
        count = top_count(_length(part), fraction)
        marks = preferences(residual, count).astype(np.float32)
        # Upper triangle of marks marks^T: counts, exact in single precision. A pair that has fewer
        # hypotheses than usual weighs as much as the others.
        _add_upper(total, pair.rows, ssyrk(usual / count, marks.T, trans=1, lower=1).T)
    _mirror(total)
    total /= np.float32(usual) * (covisible_frames(trajectories) + np.float32(GUARD))
    return total


def covisible_frames(trajectories: Trajectories) -> Float32Array:
    """Count (N, N) the frames in which both of two trajectories are visible."""
    seen = trajectories.visible.astype(np.float32)
    together: Float32Array = seen @ seen.T
    return together


def _pairs(hypotheses: Hypotheses) -> list[slice]:
    """Where the hypotheses of each frame pair lie."""
    change = np.flatnonzero((hypotheses.pair[1:] != hypotheses.pair[:-1]).any(axis=1)) + 1
    return [slice(start, end) for start, end in pairwise([0, *change.tolist(), len(hypotheses.pair)])]


def _length(part: slice) -> int:
    return int(part.stop - part.start)


def _in_frames_of_pairs(
    hypotheses: Hypotheses, parts: Sequence[slice], pairs: Sequence[FramePair]
) -> FloatArray:
    """Models in the normalised frames of their pairs, where single precision is enough to rank."""
    of = np.repeat(np.arange(len(parts)), list(map(_length, parts)))
    t1, t2 = np.stack([pair.t1 for pair in pairs])[of], np.stack([pair.t2 for pair in pairs])[of]
    return change_frame(hypotheses.kind, hypotheses.models, t1, t2)


def _add_upper(total: Float32Array, rows: IntArray, shared: Float32Array) -> None:
    """Add the upper triangle of a matrix over some rows (ascending) to that over all, in place.

    First to their columns, then to their rows: an index into both axes at once takes five times as long.
    """
    for start in range(0, len(rows), _BLOCK):
        part = slice(start, start + _BLOCK)
        spread = np.zeros((len(rows[part]), len(total)), dtype=np.float32)
        spread[:, rows[start:]] = shared[part, start:]
        total[rows[part]] += spread


def _mirror(upper: Float32Array) -> None:
    """Copy the upper triangle of a square matrix to the lower, in place, by blocks of rows."""
    for start in range(0, len(upper), _BLOCK):
        stop = min(start + _BLOCK, len(upper))
        upper[stop:, start:stop] = upper[start:stop, stop:].T
        block = upper[start:stop, start:stop]
        block[:] = np.triu(block) + np.triu(block, 1).T
