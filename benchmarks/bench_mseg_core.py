"""Times of the steps of the paper's method: ``pytest benchmarks/bench_mseg_core.py``.

With KT3DMOSEG_DATA, or ../shared/data, on Seq005_Clip01; else on random points of its size.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from kt3dmoseg.io import load
from kt3dmoseg.types import Clip, Labels, Trajectories
from mseg.clustering.kmeans import kmeans
from mseg.clustering.spectral import GraphLaplacian, smallest_eigenvectors
from mseg.kernels import sample_hypotheses, sparsify, view_kernel
from mseg.methods import segment
from mseg.methods.paper import CoReg, Subset

KINDS = ("affine", "homography", "fundamental")
MOTIONS = 3


@pytest.fixture(scope="session")
def clip() -> Clip:
    root = Path(os.environ.get("KT3DMOSEG_DATA", Path(__file__).parents[2] / "shared" / "data"))
    path = root / "kt3dmoseg" / "release" / "Seq005_Clip01_Tracks.mat"
    if path.is_file():
        return load(path)
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, 400, size=(646, 1, 2)) + rng.normal(scale=2, size=(646, 20, 2)).cumsum(axis=1)
    labels = Labels(rng.integers(1, MOTIONS + 1, size=646))
    return Clip("random", Trajectories(xy, np.ones((646, 20), dtype=bool)), np.arange(646), labels)


@pytest.fixture(scope="session")
def kernels(clip):
    points = clip.evaluated_trajectories
    rng = np.random.default_rng(0)
    return [sparsify(view_kernel(points, sample_hypotheses(points, kind, rng)), 8.0) for kind in KINDS]


@pytest.mark.parametrize("kind", KINDS)
def test_hypotheses(benchmark, clip, kind):
    points = clip.evaluated_trajectories
    benchmark(lambda: sample_hypotheses(points, kind, np.random.default_rng(0)))


@pytest.mark.parametrize("kind", KINDS)
def test_kernel(benchmark, clip, kind):
    points = clip.evaluated_trajectories
    hypotheses = sample_hypotheses(points, kind, np.random.default_rng(0))
    benchmark(lambda: view_kernel(points, hypotheses))


def test_arithmetic_of_a_kernel(benchmark, clip):
    """The product of 0/1 marks that a kernel cannot do without, over visible points only."""
    sizes = [len(clip.evaluated_trajectories.pair(f, f + 1)[0]) for f in range(clip.n_frames - 1)]
    marks = [np.ones((size, 500), dtype=np.float32) for size in sizes]
    benchmark(lambda: [m @ m.T for m in marks])


def test_sparsify(benchmark, clip):
    points = clip.evaluated_trajectories
    kernel = view_kernel(points, sample_hypotheses(points, "affine", np.random.default_rng(0)))
    benchmark(lambda: sparsify(kernel, 8.0))


@pytest.mark.parametrize("method", [CoReg(), Subset()])
def test_fusion(benchmark, kernels, method):
    laplacians = [GraphLaplacian(kernel) for kernel in kernels]
    benchmark(lambda: method.fuse(laplacians, MOTIONS))


def test_embedding(benchmark, kernels):
    laplacian = GraphLaplacian(kernels[0])
    benchmark(lambda: smallest_eigenvectors(laplacian, MOTIONS))


def test_kmeans(benchmark, kernels):
    points = CoReg().fuse([GraphLaplacian(kernel) for kernel in kernels], MOTIONS).joint()
    benchmark(lambda: kmeans(points, MOTIONS, np.random.default_rng(0), n_restarts=100))


@pytest.mark.parametrize("method", ["keradd", "coreg", "subset"])
def test_method(benchmark, clip, method):
    benchmark(lambda: segment(clip, method, n_motions=MOTIONS))
