"""Preference matrices: how much each point likes each hypothesis, and how alike two points' tastes are."""

from __future__ import annotations

from typing import Literal

import numpy as np

from kt3dmoseg.types import FloatArray

_CHOSEN_WITHIN = 5.0


def preference_matrix(
    residuals: FloatArray, scale: float, kind: Literal["exponential", "cauchy"] = "exponential"
) -> FloatArray:
    """Preferences of points for hypotheses.

    Parameters
    ----------
    residuals : (N, M) float64
        Residuals >= 0 of N points to M hypotheses; infinite ones have preference zero.
    scale : float
        For "exponential" the inlier threshold epsilon: ``exp(-5 r / epsilon)`` below it, else 0. For
        "cauchy" the noise scale sigma: ``1 / (1 + (r / (5 sigma))^2)``.
    kind : {"exponential", "cauchy"}
        Shape of the preference.

    Returns
    -------
    (N, M) float64
        In [0, 1].

    References
    ----------
    Magri and Fusiello, "T-Linkage", CVPR 2014, equation 3, and "Robust multiple model fitting with
    preference analysis and low-rank approximation", BMVC 2015, section 2.
    """
    if kind == "cauchy":
        return np.asarray(1 / (1 + (residuals / (_CHOSEN_WITHIN * scale)) ** 2))
    return np.where(residuals < scale, np.exp(-_CHOSEN_WITHIN * residuals / scale), 0.0)


def tanimoto_distance(preferences: FloatArray) -> FloatArray:
    """Tanimoto distances of preference vectors.

    ``1 - <p, q> / (|p|^2 + |q|^2 - <p, q>)``; 0 for equal vectors, 1 for orthogonal ones and for any pair
    of which one is zero.

    Parameters
    ----------
    preferences : (N, M) float64
        One row per point.

    Returns
    -------
    (N, N) float64
        Symmetric, in [0, 1], zero diagonal.

    References
    ----------
    Magri and Fusiello, "T-Linkage: a continuous relaxation of J-Linkage for multi-model fitting", CVPR
    2014, equation 4.
    """
    inner = preferences @ preferences.T
    squares = np.diagonal(inner).copy()
    union = squares[:, None] + squares - inner
    alike = np.divide(inner, union, out=np.zeros_like(inner), where=union > 0)
    distance = np.clip(1 - alike, 0, 1)
    np.fill_diagonal(distance, 0)
    return np.asarray(distance)
