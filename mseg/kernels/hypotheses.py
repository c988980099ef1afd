"""Hypotheses: models fitted to random minimal samples of the points of each frame pair."""

from __future__ import annotations

import numpy as np

from kt3dmoseg.types import BoolArray, FloatArray, IntArray, Trajectories
from mseg.geometry import MODELS, change_frame, frame_pair, hartley
from mseg.kernels.subsets import draw_subsets
from mseg.types import Hypotheses, ModelKind

_TRIES = 12


def sample_hypotheses(
    trajectories: Trajectories,
    kind: ModelKind,
    rng: np.random.Generator,
    *,
    per_pair: int = 500,
    gap: int = 1,
) -> Hypotheses:
    """Fit models to uniform minimal samples of every frame pair, all pairs at once.

    The points of a pair are normalised together (Hartley), and a fundamental matrix is made rank 2
    in that frame. Degenerate samples are drawn again, at most eleven times; then they are left out,
    so a pair may hold fewer models than asked for. A pair with fewer visible points than a minimal
    sample holds none.

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
    minimal = MODELS[kind].minimal
    pairs = [(f, f + gap) for f in range(trajectories.n_frames - gap)]
    usable = [pair for pair in pairs if len(frame_pair(trajectories, *pair).rows) >= minimal]
    if not usable:
        return Hypotheses(np.empty((0, 3, 3)), np.empty((0, 2), dtype=np.int64), kind)
    found = [frame_pair(trajectories, *pair) for pair in usable]
    size = np.array([len(pair.rows) for pair in found], dtype=np.int64)
    of = np.repeat(np.arange(len(found)), per_pair)
    x1, x2 = np.concatenate([pair.x1 for pair in found]), np.concatenate([pair.x2 for pair in found])
    models, ok = _fit(kind, x1, x2, size, of, rng)
    kept = of[ok]
    t1, t2 = np.stack([pair.t1 for pair in found])[kept], np.stack([pair.t2 for pair in found])[kept]
    pixels = change_frame(kind, models[ok], hartley.inverse(t1), hartley.inverse(t2))
    return Hypotheses(pixels, np.array(usable, dtype=np.int64)[kept], kind)


def _fit(
    kind: ModelKind,
    x1: FloatArray,
    x2: FloatArray,
    size: IntArray,
    of: IntArray,
    rng: np.random.Generator,
) -> tuple[FloatArray, BoolArray]:
    """Fit one model per entry of `of`, the pair whose `size` points it samples."""
    model = MODELS[kind]
    start = size.cumsum() - size
    models, ok = np.zeros((len(of), 3, 3)), np.zeros(len(of), dtype=np.bool_)
    for _ in range(_TRIES):
        todo = np.flatnonzero(~ok)
        if not len(todo):
            break
        pair = of[todo]
        sample = draw_subsets(size[pair], model.minimal, rng) + start[pair, None]
        models[todo], ok[todo] = model.fit_together(x1[sample], x2[sample])
    return models, ok
