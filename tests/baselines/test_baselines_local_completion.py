import numpy as np
import pytest

from mseg.completion import complete, complete_locally

FRAMES = 16


def bodies(rng, n=30):
    """Four rigid bodies under an affine camera that part: trajectories (2F, 4n), of rank over ten."""
    columns = []
    t = np.linspace(0, 1, FRAMES)[:, None, None]
    for turn, right, down in ((0.5, 1, 1), (-0.4, -1, 1), (0.8, 1, -1), (-0.7, -1, -1)):
        points = rng.uniform(-40, 40, size=(3, n))
        x = np.cos(turn * t) * points[0] + np.sin(turn * t) * points[2] + right * (50 + 30 * t)
        y = points[1] + 0.5 * np.sin(2 * turn * t) * points[2] + down * (50 + 40 * t**2)
        columns.append(np.concatenate([x, y], axis=1).reshape(2 * FRAMES, n))
    return np.hstack(columns) + 300


def windowed(rng, matrix, share=0.6, shortest=6):
    """Hide all of a column but some frames in a row."""
    seen = np.ones(matrix.shape, dtype=bool)
    for column in np.flatnonzero(rng.random(matrix.shape[1]) < share):
        length = rng.integers(shortest, FRAMES)
        start = rng.integers(0, FRAMES - length + 1)
        seen[: 2 * start, column] = seen[2 * (start + length) :, column] = False
    return np.where(seen, matrix, np.nan)


def misfit(filled, gaps, truth):
    return float(np.median(np.abs(filled - truth)[np.isnan(gaps)]))


def test_motions_are_not_mixed_where_one_subspace_mixes_them(rng):
    truth = bodies(rng)
    gaps = windowed(rng, truth + rng.normal(scale=0.2, size=truth.shape))
    local, shared = complete_locally(gaps), complete(gaps, 5)
    assert misfit(local.matrix, gaps, truth) < 0.75 * misfit(shared.matrix, gaps, truth)
    assert local.rms < 0.5
    assert local.undetermined == 0


def test_seen_entries_are_kept_and_none_is_missing(rng):
    gaps = windowed(rng, bodies(rng, 10), share=0.9, shortest=2)
    filled = complete_locally(gaps).matrix
    seen = np.isfinite(gaps)
    np.testing.assert_array_equal(filled[seen], gaps[seen])
    assert np.isfinite(filled).all()


def test_complete_data_pass_through(rng):
    truth = bodies(rng, 5)
    result = complete_locally(truth)
    np.testing.assert_array_equal(result.matrix, truth)
    assert result.convergence.converged


def test_order_and_origin_do_not_matter(rng):
    gaps = windowed(rng, bodies(rng, 12))
    order = rng.permutation(gaps.shape[1])
    once = complete_locally(gaps).matrix
    np.testing.assert_allclose(complete_locally(gaps[:, order]).matrix, once[:, order], atol=0.01)
    np.testing.assert_allclose(complete_locally(gaps - 1000).matrix, once - 1000, atol=0.01)


def test_a_column_without_a_neighbour_keeps_the_first_completion(rng):
    truth = bodies(rng, 6)
    truth[:, 0] += np.linspace(0, 60, 2 * FRAMES)
    gaps = truth.copy()
    gaps[2:, 0] = np.nan
    result = complete_locally(gaps)
    assert result.undetermined == 1
    np.testing.assert_allclose(result.matrix[:, 0], complete(gaps, 5).matrix[:, 0])


@pytest.mark.parametrize("columns", [1, 2, 3])
def test_few_or_repeated_columns(columns):
    line = np.repeat(np.arange(6.0)[:, None], columns, axis=1)
    line[4:, 0] = np.nan
    if columns == 1:
        line = np.nan_to_num(line)
    assert np.isfinite(complete_locally(line).matrix).all()
