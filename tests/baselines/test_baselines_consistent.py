"""ConsistentMoSeg's shared affinity against its authors' code."""

import numpy as np
import pytest

from mseg.methods.consistent import ConsistentMoSeg, _component_factors

# Made by running the authors' MATLAB function (AAAI 2021, l1 = 0.001) in Octave 7.3 on the three views of
# `bands` with K = 2. Sweeps until convergence; residuals (squared change of C, of all D_v) of the first
# three sweeps and the last; entries (1, 2), (4, 5), (6, 7) and sum of C, and of the affinity.
REFERENCE = {
    0.015: (
        13,
        (67.6747716561, 0.0602424932183, 0.00204185810698, 0.00096878126781),
        (1.00477319449, 0.994544255608, 1.00591367632, 57.8818047791),
        (2.59057221079, 1.69035931784, 2.59082722913, 96.8748341261),
    ),
    0.2: (
        54,
        (67.6747716561, 5.91420721108, 0.00503053534984, 0.000980399907697),
        (0.969179856629, 0.483527494447, 0.966309209355, 38.4851243008),
        (2.59088610088, 1.67150708787, 2.59079398736, 91.1800170305),
    ),
}


def bands():
    """Three views of ten points: likeness falls with distance, with a step between points 4 and 5."""
    i, j = np.indices((10, 10))
    views = [np.exp(-abs(i - j) / width) + 0.3 * ((i < 4) == (j < 4)) for width in (1, 2, 3)]
    return np.array([np.where((view < 0.2) | (i == j), 0, view) for view in views])


def entries(matrix):
    return (matrix[0, 1], matrix[3, 4], matrix[5, 6], matrix.sum())


@pytest.mark.parametrize("weight", REFERENCE)
def test_every_sweep_is_that_of_the_authors(weight):
    sweeps, residuals, shared, affinity = REFERENCE[weight]
    c, d, convergence = ConsistentMoSeg(rank_weight=weight).solve(bands(), 2)
    assert convergence.converged
    assert convergence.iterations == sweeps
    assert entries(c) == pytest.approx(shared, rel=1e-9)
    assert entries(c * d.sum(axis=0)) == pytest.approx(affinity, rel=1e-9)
    for sweep, residual in zip((1, 2, 3, sweeps), residuals, strict=True):
        _, _, part = ConsistentMoSeg(rank_weight=weight, max_iterations=sweep).solve(bands(), 2)
        assert part.residual == pytest.approx(residual, rel=1e-7)


def test_pairs_without_weight_stay_apart():
    shared, specific, _ = ConsistentMoSeg().solve(bands(), 2)
    assert shared[0, 9] == 0
    assert (specific[:, 0, 9] == 1e-4).all()
    np.testing.assert_array_equal(specific, specific.transpose(0, 2, 1))


def laplacian(weights):
    return np.diag(weights.sum(axis=1)) - weights


def test_components_share_a_tie_evenly():
    factors, _ = _component_factors(np.zeros((4, 4)), 2)
    np.testing.assert_allclose(factors @ factors.T, np.eye(4) / 2, atol=1e-12)
    blocks = np.kron(np.eye(2), np.ones((3, 3)) - np.eye(3))
    factors, _ = _component_factors(laplacian(blocks), 2)
    np.testing.assert_allclose(factors @ factors.T, np.kron(np.eye(2), np.ones((3, 3)) / 3), atol=1e-9)


@pytest.mark.parametrize("parts", [2, 3, 4])
def test_large_graphs_take_the_same_eigenvectors(rng, parts):
    """Above the size that LAPACK gets, and with a tie where there are more components than clusters."""
    noise = rng.random((320, 320))
    weights = np.kron(np.eye(parts), np.ones((320 // parts,) * 2))
    weights = weights * (noise + noise.T)[: len(weights), : len(weights)]
    factors, start = _component_factors(laplacian(weights), 2)
    again, _ = _component_factors(laplacian(weights), 2, start)
    np.testing.assert_allclose(factors @ factors.T, again @ again.T, atol=1e-8)
    expected = np.kron(np.eye(parts), np.full((320 // parts,) * 2, 2 / parts / (320 // parts)))
    np.testing.assert_allclose(factors @ factors.T, expected, atol=1e-8)


def test_consistent_graph_falls_into_components(rng):
    block = np.kron(np.eye(2), np.ones((8, 8)))
    noise = [rng.random((16, 16)) * 0.05 for _ in range(3)]
    views = np.array([block + n + n.T for n in noise])
    shared, _, convergence = ConsistentMoSeg(rank_weight=0.2).solve(views, 2)
    assert convergence.iterations > 1
    np.testing.assert_array_equal(shared, shared.T)
    assert shared[:8, 8:].max() < 0.1 * shared[:8, :8].mean()
