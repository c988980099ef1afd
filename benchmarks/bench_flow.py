"""Time of the flow backends at KITTI's size, one thread; compare the medians of one run.

Run: pytest benchmarks/bench_flow.py --benchmark-columns=min,median,rounds
"""

from __future__ import annotations

import cv2
import pytest

from kt3dmoseg import flow
from kt3dmoseg.synthetic import SceneOptions, make_scene


@pytest.fixture(scope="module")
def pair():
    cv2.setNumThreads(1)
    scene = make_scene(SceneOptions(frames=2, samples=1))
    return scene.frame(0), scene.frame(1)


@pytest.mark.parametrize("name", ["dis_medium", "dis", "farneback"])
def test_flow(benchmark, pair, name):
    benchmark.pedantic(flow.create(name), args=pair, rounds=7, warmup_rounds=1)
