"""Time of everything the tracker does apart from the flow: structure, seeding, linking, tests, layout.

Run: pytest benchmarks/bench_tracks.py --benchmark-timer=time.process_time --benchmark-columns=min,median
`test_ten_pairs` is ten pairs of frames with all their live tracks, `test_flow_pair` the two fields that one
of them needs. Less than a tenth is wanted, so the former should take less time than the latter.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from kt3dmoseg import flow
from kt3dmoseg.synthetic import SceneOptions, make_scene
from kt3dmoseg.tracking import track
from kt3dmoseg.tracking.tracker import RunTrajectories


@pytest.fixture(scope="module")
def pair():
    cv2.setNumThreads(1)
    scene = make_scene(SceneOptions(frames=2, samples=1))
    return scene.frame(0), scene.frame(1)


def test_flow_pair(benchmark, pair):
    benchmark.pedantic(flow.flow_pair, args=(flow.create("dis"), *pair), rounds=5, warmup_rounds=1)


@pytest.mark.parametrize("options", [{}, {"reliable": True}], ids=["default", "reliable"])
def test_ten_pairs(benchmark, pair, options):
    there, back = flow.flow_pair(flow.create("dis"), *pair)

    def fields(a, b):
        return there if a is pair[0] else back

    frames = [pair[k % 2] for k in range(11)]
    benchmark.pedantic(track, args=(frames, fields), kwargs=options, rounds=5, warmup_rounds=1)


def test_layout_of_1000_frames(benchmark):
    """100,000 positions in a clip of 1,000 frames."""
    positions = []
    rng = np.random.default_rng(0)
    for frame in range(1000):
        ids = np.arange(4 * frame, 4 * frame + 100)
        positions.append((ids, rng.uniform(0, 300, (100, 2))))
    benchmark.pedantic(RunTrajectories, args=(positions, 4_096, 5, (1242, 375)), rounds=5)
