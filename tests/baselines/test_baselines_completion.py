import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mseg.completion import _shrink_eigenvalues, _shrink_singular_values, complete, robust_pca, shrink


def low_rank(rng, depth=20, n=60, rank=3, holes=0.3):
    truth = rng.normal(size=(depth, rank)) @ rng.normal(size=(rank, n)) * 50 + 200
    seen = rng.random((depth, n)) >= holes
    seen[: 2 * rank + 2] = True
    return truth, np.where(seen, truth, np.nan)


@given(st.integers(0, 10_000))
@settings(max_examples=10, deadline=None)
def test_exact_low_rank_is_recovered(seed):
    truth, gaps = low_rank(np.random.default_rng(seed))
    result = complete(gaps, 4, tolerance=1e-9)
    assert result.convergence.converged
    np.testing.assert_allclose(result.matrix, truth, atol=0.05)
    assert result.rms < 0.01
    assert result.undetermined == 0


def test_seen_entries_are_kept_and_none_is_missing(rng):
    _, gaps = low_rank(rng, holes=0.5)
    gaps += rng.normal(size=gaps.shape)
    filled = complete(gaps, 4).matrix
    seen = np.isfinite(gaps)
    np.testing.assert_array_equal(filled[seen], gaps[seen])
    assert np.isfinite(filled).all()


def test_a_better_fit_than_filling_with_row_means_and_projecting(rng):
    truth, gaps = low_rank(rng, holes=0.5)
    means = np.nanmean(gaps, axis=1, keepdims=True)
    u, s, v = np.linalg.svd(np.where(np.isfinite(gaps), gaps, means) - means, full_matrices=False)
    naive = (u[:, :4] * s[:4]) @ v[:4] + means
    gap = np.isnan(gaps)
    ours = np.abs(complete(gaps, 4).matrix - truth)[gap].mean()
    assert ours < 0.05 * np.abs(naive - truth)[gap].mean()


def test_order_of_columns_does_not_matter(rng):
    _, gaps = low_rank(rng, n=30)
    order = rng.permutation(30)
    straight, shuffled = complete(gaps, 3).matrix, complete(gaps[:, order], 3).matrix
    np.testing.assert_allclose(shuffled, straight[:, order], rtol=1e-5)


def test_moving_and_scaling_the_data_moves_and_scales_the_result(rng):
    _, gaps = low_rank(rng)
    once, again = complete(gaps, 4).matrix, complete(7 * gaps - 1000, 4).matrix
    np.testing.assert_allclose(again, 7 * once - 1000, rtol=1e-4)


def test_complete_data_come_back_as_they_are(rng):
    matrix = rng.normal(size=(4, 6))
    assert complete(matrix, 2).matrix is matrix


def test_a_column_seen_once_is_counted_and_stays_finite(rng):
    _, gaps = low_rank(rng)
    gaps[1:, 5] = np.nan
    result = complete(gaps, 4)
    assert result.undetermined == 1
    assert np.isfinite(result.matrix).all()
    assert np.abs(result.matrix[:, 5]).max() < 1e5


def test_the_cap_on_iterations_is_reported(rng):
    _, gaps = low_rank(rng)
    assert not complete(gaps, 3, tolerance=0, max_iterations=1).convergence.converged


def test_robust_pca_separates_gross_errors(rng):
    truth = rng.normal(size=(80, 2)) @ rng.normal(size=(2, 90))
    errors = np.where(rng.random(truth.shape) < 0.05, 20.0, 0.0)
    result = robust_pca(truth + errors)
    assert result.convergence.converged
    np.testing.assert_allclose(result.low_rank, truth, atol=1e-3)
    np.testing.assert_allclose(result.sparse, errors, atol=1e-3)


def test_robust_pca_of_zeros_and_cap(rng):
    assert not robust_pca(np.zeros((3, 4))).low_rank.any()
    assert not robust_pca(rng.normal(size=(5, 6)), max_iterations=2).convergence.converged


def test_symmetric_data_are_shrunk_by_eigenvalues(rng):
    half = rng.normal(size=(30, 30))
    matrix = half + half.T
    np.testing.assert_allclose(
        _shrink_eigenvalues(matrix, 3.0), _shrink_singular_values(matrix, 3.0), atol=1e-10
    )
    low_rank = np.outer(half[0], half[0])
    result = robust_pca(low_rank + 20 * np.eye(30)[::-1])
    assert result.convergence.converged
    np.testing.assert_allclose(result.low_rank, low_rank, atol=1e-3)


def test_shrinking_by_hand():
    np.testing.assert_array_equal(shrink(np.array([-3.0, -0.5, 0.0, 2.0]), 1.0), [-2, 0, 0, 1])
    diagonal = _shrink_singular_values(np.diag([5.0, 2.0, 0.5]), 1.0)
    np.testing.assert_allclose(diagonal, np.diag([4.0, 1.0, 0.0]), atol=1e-12)
