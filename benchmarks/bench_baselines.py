"""Time of the methods on complete trajectories: 500 trajectories, 30 frames, three affine motions.

pytest benchmarks/bench_baselines.py
"""

from __future__ import annotations

import numpy as np
import pytest

import mseg.methods as methods
from kt3dmoseg.types import Clip, Labels, Trajectories
from mseg.completion import complete

_SIZES, _FRAMES = (250, 150, 100), 30


@pytest.fixture(scope="module")
def clip() -> Clip:
    rng = np.random.default_rng(0)
    blocks = []
    for size in _SIZES:
        shape = np.vstack([60 * rng.normal(size=(3, size)), np.ones(size)])
        drift = np.cumsum(rng.normal(size=(_FRAMES, 2, 4)) * (0.1, 0.1, 0.1, 5), axis=0)
        blocks.append(np.einsum("fij,jn->nfi", rng.normal(size=(2, 4)) + drift, shape))
    xy = np.concatenate(blocks) + 0.3 * rng.normal(size=(sum(_SIZES), _FRAMES, 2)) + 300
    visible = np.ones(xy.shape[:2], dtype=bool)
    labels = Labels(np.repeat(np.arange(1, 4), _SIZES))
    return Clip("bench", Trajectories(xy, visible, image_size=(640, 480)), np.arange(len(xy)), labels)


QUICK = ["lsa", "gpca", "ransac", "ssc", "lrr", "s3c", "rsim", "tlinkage", "tpv", "mssc", "rpa"]


@pytest.mark.parametrize("name", [*QUICK, "lrssc", "consistent", "alc"])
def test_method(benchmark, clip, name):
    benchmark.pedantic(methods.segment, args=(clip, name), kwargs={"n_motions": 3}, rounds=2)


def test_completion(benchmark, clip):
    rng = np.random.default_rng(1)
    matrix = clip.dense.xy.reshape(len(clip.dense), -1).T.copy()
    first = rng.integers(0, 21, size=matrix.shape[1])
    frame = np.arange(matrix.shape[0])[:, None] // 2
    matrix[(frame < first) | (frame >= first + 10)] = np.nan
    benchmark.pedantic(complete, args=(matrix, 5), rounds=2)
