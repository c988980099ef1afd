"""The background subsample."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.tracking import subsample_background
from kt3dmoseg.types import Labels


@given(
    label=st.lists(st.integers(0, 4), max_size=200),
    seed=st.integers(0, 99),
    fraction=st.floats(0, 1),
)
def test_what_always_holds(label, seed, fraction):
    labels = Labels(np.array(label, dtype=np.int64), background=1)
    rows = subsample_background(labels, np.random.default_rng(seed), fraction)
    assert (np.diff(rows) > 0).all()
    foreground = np.flatnonzero(labels.label > 1)
    assert set(foreground) <= set(rows.tolist())
    kept = labels.label[rows]
    assert (kept != 0).all()
    total = int((labels.label == 1).sum())
    assert (kept == 1).sum() <= max(1, round(fraction * total))
    again = subsample_background(labels, np.random.default_rng(seed), fraction)
    np.testing.assert_array_equal(rows, again)


def test_small_motions_are_left_out_and_the_draw_stays(rng):
    labels = Labels(np.repeat([1, 2, 3, 0], [500, 4, 5, 20]), background=1)
    seeds = [np.random.default_rng(3) for _ in range(2)]
    every, large = (subsample_background(labels, r, smallest=k) for r, k in zip(seeds, (1, 5), strict=True))
    assert (labels.label[every] == 2).sum() == 4
    np.testing.assert_array_equal(large, every[labels.label[every] != 2])


def test_share_is_that_of_a_draw_with_replacement(rng):
    labels = Labels(np.full(200_000, 3), background=3)
    share = len(subsample_background(labels, rng)) / len(labels)
    assert share == pytest.approx(1 - np.exp(-0.1), abs=0.002)


def test_edges(rng):
    empty = subsample_background(Labels(np.zeros(5, dtype=np.int64)), rng)
    assert empty.shape == (0,)
    assert empty.dtype == np.int64
    few = Labels(np.array([1, 1, 2]), background=1)
    assert len(subsample_background(few, rng)) == 2
    assert subsample_background(few, rng, fraction=0).tolist() == [2]


def test_refusals(rng):
    with pytest.raises(InvalidValueError, match=r"labels\.background"):
        subsample_background(Labels(np.array([1, 2])), rng)
    with pytest.raises(InvalidValueError, match="fraction"):
        subsample_background(Labels(np.array([1, 2]), background=1), rng, fraction=1.5)
