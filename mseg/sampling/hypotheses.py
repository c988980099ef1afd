"""Hypotheses: models fitted to random minimal samples of the points of each frame pair."""

from __future__ import annotations

import numpy as np

from kt3dmoseg.types import BoolArray, FloatArray, IntArray, Trajectories
from mseg.geometry import MODELS
from mseg.sampling.subsets import draw_subsets
from mseg.types import Hypotheses, ModelKind

_TRIES = 12


def frame_pairs(n_frames: int, gap: int) -> IntArray:
    """Pairs (f, f + gap) of frames, (n, 2)."""
    first = np.arange(max(n_frames - gap, 0))
    return np.stack([first, first + gap], axis=1)


def sample_hypotheses(
    trajectories: Trajectories,
    kind: ModelKind,
    rng: np.random.Generator,
    *,
    per_pair: int = 500,
    gap: int = 1,
) -> Hypotheses:
    """Fit models to uniform minimal samples of every frame pair, all pairs at once.

    Degenerate samples are drawn again, at most eleven times; then they are left out, so a pair may
    hold fewer models than asked for. A pair with fewer visible points than a minimal sample holds
    none.

    Parameters
    ----------
    trajectories : Trajectories
        The points to sample from.
    kind : {"affine", "homography", "fundamental"}
        Kind of model.
    rng : numpy.random.Generator
        Randomness.
    per_pair : int
        Hypotheses per frame pair (500 in Xu, Cheong, Li, CVPR 2018, section 4).
    gap : int
        Frames from the first to the second of a pair.

    Returns
    -------
    Hypotheses
        In pixel coordinates, pairs ascending.
    """
    model = MODELS[kind]
    pairs = frame_pairs(trajectories.n_frames, gap)
    points = [trajectories.pair(int(i), int(j)) for i, j in pairs]
    size = np.array([len(rows) for rows, _, _ in points], dtype=np.int64)
    usable = np.flatnonzero(size >= model.minimal)
    pair_of = np.repeat(usable, per_pair)
    models, ok = np.zeros((len(pair_of), 3, 3)), np.zeros(len(pair_of), dtype=np.bool_)
    if len(usable):
        x1, x2 = (np.concatenate([p[side] for p in points]) for side in (1, 2))
        start = np.concatenate([[0], size.cumsum()[:-1]])
        for _ in range(_TRIES):
            todo = np.flatnonzero(~ok)
            if not len(todo):
                break
            of = pair_of[todo]
            sample = draw_subsets(size[of], model.minimal, rng) + start[of, None]
            models[todo], ok[todo] = model.fit(x1[sample], x2[sample])
    return _kept(models, pairs[pair_of], ok, kind)


def _kept(models: FloatArray, pair: IntArray, ok: BoolArray, kind: ModelKind) -> Hypotheses:
    return Hypotheses(models[ok], pair[ok], kind)
