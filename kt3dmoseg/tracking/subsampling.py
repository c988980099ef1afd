"""The documented rule by which the background is thinned out for evaluation."""

from __future__ import annotations

import numpy as np

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import IntArray, Labels


def subsample_background(
    labels: Labels, rng: np.random.Generator, fraction: float = 0.1, smallest: int = 1
) -> IntArray:
    """Choose the trajectories that are evaluated.

    Every labelled foreground trajectory is kept, of motions that have `smallest` of them. Of the B
    background trajectories, round(fraction * B) are drawn uniformly *with* replacement and duplicates
    are dropped, so at the default about 9.5 % of them are kept: this is the rule that the 2018 release
    is consistent with (its kept share is 9.65 % pooled, independent of a trajectory's length and
    position). Unlabelled trajectories (label 0) are never evaluated.

    Parameters
    ----------
    labels : Labels
        Labels of all dense trajectories, with `background` set.
    rng : numpy.random.Generator
        Source of the draw; the same state gives the same rows.
    fraction : float
        Share of the background that is drawn, 0 to 1; a background that exists keeps at least one
        trajectory as long as the fraction is not 0.
    smallest : int
        Moving objects with fewer trajectories are not evaluated, neither as a motion nor as background.

    Returns
    -------
    (n,) int64
        Rows of the dense trajectories, ascending.

    Raises
    ------
    InvalidValueError
        When the fraction is not in [0, 1], or labels are given without saying which is the background.
    """
    if not 0 <= fraction <= 1:
        raise InvalidValueError("fraction", expected="a number from 0 to 1", found=str(fraction))
    if labels.background is None and labels.n_motions:
        raise InvalidValueError(
            "labels.background", expected="the label of the static scene", found="none", fix="set it"
        )
    motions, size = np.unique(labels.label, return_counts=True)
    large = np.isin(labels.label, motions[size >= smallest])
    foreground = np.flatnonzero(large & (labels.label != 0) & (labels.label != labels.background))
    background = np.flatnonzero((labels.label != 0) & (labels.label == labels.background))
    count = round(fraction * len(background))
    if fraction > 0 and len(background):
        count = max(1, count)
    drawn = rng.integers(0, max(1, len(background)), size=count)
    rows = np.concatenate([foreground, background[np.unique(drawn)]])
    return np.sort(rows).astype(np.int64)
