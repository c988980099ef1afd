"""Time of everything the tracker does besides the flow: structure, seeding, linking, tests, layout.

Run: pytest benchmarks/bench_tracks.py --benchmark-columns=min,median,rounds
`test_pair` is one pair of frames with all its live tracks; `test_flow_pair` the two flow fields that it
needs: the former should stay below a tenth of the latter.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from kt3dmoseg import flow
from kt3dmoseg.synthetic import SceneOptions, make_scene
from kt3dmoseg.tracks import TrackOptions
from kt3dmoseg.tracks.linking import step
from kt3dmoseg.tracks.seeding import new_seeds
from kt3dmoseg.tracks.store import TrackStore

OPTIONS = TrackOptions()


@pytest.fixture(scope="module")
def pair():
    cv2.setNumThreads(1)
    scene = make_scene(SceneOptions(frames=2, samples=1))
    return scene.frame(0), scene.frame(1)


def test_flow_pair(benchmark, pair):
    benchmark.pedantic(flow.flow_pair, args=(flow.create("dis"), *pair), rounds=5, warmup_rounds=1)


def test_pair(benchmark, pair):
    a, b = pair
    forward, backward = flow.flow_pair(flow.create("dis"), a, b)
    live = new_seeds(a, np.zeros((0, 2)), OPTIONS)

    def advance():
        target, alive = step(live, forward, backward, OPTIONS)
        return new_seeds(b, target[alive], OPTIONS)

    benchmark.pedantic(advance, rounds=20, warmup_rounds=2)


def test_layout_of_1000_frames(benchmark):
    """100,000 positions in a clip of 1,000 frames."""
    store = TrackStore()
    rng = np.random.default_rng(0)
    for frame in range(1000):
        ids = np.arange(4 * frame, 4 * frame + 100)
        store.append(ids, rng.uniform(0, 300, (100, 2)))
    benchmark.pedantic(store.finish, args=(4_096, 5, (1242, 375)), rounds=5)
