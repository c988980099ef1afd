"""Time of reading, validating and scoring 22 clips x 10 seeds, every metric, from a folder of CSV files.

Run: pytest benchmarks/bench_scoring.py --benchmark-timer=time.process_time
The clips have as many evaluated trajectories as KT3DMoSeg together (10,427) and two to five motions.
"""

from __future__ import annotations

import numpy as np
import pytest

from kt3dmoseg.types import Clip, Labels, Trajectories
from mseg.evaluation import SubmissionMeta, score_submission, write_submission

SIZES = np.linspace(158, 790, 22).astype(int)
SEEDS = 10


def clip(i: int) -> Clip:
    rng = np.random.default_rng(i)
    xy = rng.uniform(0, 370, (SIZES[i], 20, 2))
    label = 1 + np.arange(SIZES[i]) % (2 + i % 4)
    dense = Trajectories(xy, np.ones(xy.shape[:2], dtype=np.bool_))
    return Clip(f"clip{i:02}", dense, np.arange(SIZES[i]), Labels(label, background=1))


@pytest.fixture(scope="module")
def submission(tmp_path_factory):
    clips = {c.name: c for c in map(clip, range(22))}
    rng = np.random.default_rng(0)
    runs = {
        seed: {
            name: np.where(rng.random(len(c.labels)) < 0.1, rng.integers(1, 4, len(c.labels)), c.labels.label)
            for name, c in clips.items()
        }
        for seed in range(SEEDS)
    }
    folder = write_submission(tmp_path_factory.mktemp("s"), clips.values(), runs, SubmissionMeta("m"))
    return folder, clips


def test_score(benchmark, submission):
    scores = benchmark.pedantic(score_submission, args=submission, rounds=3, warmup_rounds=1)
    assert scores.matrix().shape == (22, SEEDS)
