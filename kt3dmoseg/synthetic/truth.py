"""How far a tracker is from the truth."""

from __future__ import annotations

import numpy as np

from kt3dmoseg.synthetic.scene import Scene
from kt3dmoseg.types import FloatArray, Trajectories


def track_errors(scene: Scene, tracks: Trajectories, after: int | None = None) -> FloatArray:
    """Measure how far trajectories are from the truth, some frames after their starts.

    Parameters
    ----------
    scene : Scene
        The scene that was tracked.
    tracks : Trajectories
        N trajectories without gaps.
    after : int or None
        Number of frames; None = at the last frame of each trajectory.

    Returns
    -------
    (N,) float64
        Pixels to where the surface point at the trajectory's start really is; NaN where the trajectory
        or the point is not seen then.
    """
    rows = np.arange(len(tracks))
    start = tracks.visible.argmax(axis=1)
    end = start + (tracks.lengths - 1 if after is None else after)
    truth = scene.trajectories(np.column_stack([tracks.xy[rows, start], start]))
    within = np.minimum(end, tracks.n_frames - 1)
    apart = np.linalg.norm(tracks.xy[rows, within] - truth.xy[rows, within], axis=1)
    return np.where(end == within, apart, np.nan)
