"""The kernel of one view of a clip: ordered residual kernels of all frame pairs, averaged."""

from __future__ import annotations

import numpy as np

from kt3dmoseg.types import Float32Array, FloatArray, Trajectories
from mseg.affinity.ordered_residuals import ordered_residual_kernel
from mseg.geometry import Distance, change_frame, hartley, residuals
from mseg.types import Hypotheses

# The authors' guard against division by zero, part of the values that alpha is applied to.
_GUARD = 0.1


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
    pairs, start = np.unique(hypotheses.pair, axis=0, return_index=True)
    stop = np.append(start[1:], len(hypotheses.pair))
    for (i, j), begin, end in zip(pairs, start, stop, strict=True):
        rows, x1, x2 = trajectories.pair(int(i), int(j))
        if len(rows):
            residual = _pair_residuals(hypotheses, slice(begin, end), x1, x2, distance)
            total[np.ix_(rows, rows)] += ordered_residual_kernel(residual, fraction=fraction)
    seen = trajectories.visible.astype(np.float32)
    shared: Float32Array = seen @ seen.T
    shared += np.float32(_GUARD)
    total /= shared
    return total


def _pair_residuals(
    hypotheses: Hypotheses, part: slice, x1: FloatArray, x2: FloatArray, distance: Distance
) -> Float32Array:
    """Residuals (P, K) in the pair's own normalised frame; single precision is enough to rank."""
    n1, t1 = hartley.normalise(x1)
    n2, t2 = hartley.normalise(x2)
    models = change_frame(hypotheses.kind, hypotheses.models[part], t1, t2)
    single = n1.astype(np.float32), n2.astype(np.float32)
    return residuals(hypotheses.kind, models, *single, distance=distance)
