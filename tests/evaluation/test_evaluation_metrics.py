from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment
from sklearn.metrics import adjusted_rand_score, normalized_mutual_info_score, precision_recall_fscore_support

from kt3dmoseg.errors import InvalidValueError
from mseg.evaluation import classification_error
from mseg.evaluation.contingency import best_assignment, contingency
from mseg.evaluation.metrics import all_metrics, per_motion

labels = st.lists(st.tuples(st.integers(0, 4), st.integers(0, 5)), min_size=1, max_size=60).filter(
    lambda pairs: any(t for t, _ in pairs)
)


def split(pairs):
    array = np.array(pairs)
    return array[:, 0], array[:, 1]


def test_every_metric_has_a_worked_example():
    for metric in all_metrics().values():
        assert ">>>" in (metric.function.__doc__ or ""), metric.title


@given(pairs=labels)
def test_metrics_are_numbers_no_worse_than_the_worst(pairs):
    table = contingency(*split(pairs))
    for name, metric in all_metrics().items():
        value, worst = metric(table), metric.worst(len(table.motions))
        assert np.isfinite(value), name
        if name != "count_error":  # too many groups may be more wrong than none
            assert value <= worst if metric.better == "lower" else value >= worst, name


@given(pairs=labels, background=st.integers(1, 4))
def test_nothing_beats_the_truth(pairs, background):
    truth, pred = split(pairs)
    exact = contingency(truth, truth, background=background)
    found = contingency(truth, pred, background=background)
    for name, metric in all_metrics().items():
        perfect, value = metric(exact), metric(found)
        assert perfect <= value + 1e-12 if metric.better == "lower" else perfect >= value - 1e-12, name


@given(pairs=labels, seed=st.integers(0, 1000))
def test_numbers_of_groups_mean_nothing(pairs, seed):
    truth, pred = split(pairs)
    new = np.concatenate([[0], 1 + np.random.default_rng(seed).permutation(5)])
    table, renamed = contingency(truth, pred), contingency(truth, new[pred])
    for name, metric in all_metrics().items():
        assert metric(table) == pytest.approx(metric(renamed)), name


@given(pairs=labels, seed=st.integers(0, 1000))
def test_order_of_trajectories_means_nothing(pairs, seed):
    truth, pred = split(pairs)
    order = np.random.default_rng(seed).permutation(len(truth))
    table, shuffled = contingency(truth, pred), contingency(truth[order], pred[order])
    for name, metric in all_metrics().items():
        assert metric(table) == metric(shuffled), name


@given(pairs=labels)
def test_unlabelled_trajectories_do_not_count(pairs):
    truth, pred = split(pairs)
    kept = truth > 0
    assert classification_error(truth, pred) == classification_error(truth[kept], pred[kept])


@given(pairs=labels)
def test_partitions_as_scikit_learn(pairs):
    truth, pred = split(pairs)
    truth, pred = truth[truth > 0], pred[truth > 0]
    table = contingency(truth, pred)
    assert all_metrics()["adjusted_rand"](table) == pytest.approx(adjusted_rand_score(truth, pred), abs=1e-12)
    expected = normalized_mutual_info_score(truth, pred)
    assert all_metrics()["nmi"](table) == pytest.approx(expected, abs=1e-7)


@given(pairs=labels)
def test_motions_as_scikit_learn(pairs):
    """With groups renamed to the motions they are assigned to, it is classification."""
    truth, pred = split(pairs)
    truth, pred = truth[truth > 0], pred[truth > 0]
    table = contingency(truth, pred)
    names = {
        int(table.groups[j]): int(m) for m, j in zip(table.motions, table.assignment, strict=False) if j >= 0
    }
    renamed = np.array([names.get(int(p), 99) for p in pred])
    p, r, f, _ = precision_recall_fscore_support(truth, renamed, labels=table.motions, zero_division=0)
    found = per_motion(table)
    np.testing.assert_allclose(found["precision"], p)
    np.testing.assert_allclose(found["recall"], r)
    np.testing.assert_allclose(found["f_measure"], f)
    assert classification_error(truth, pred) == pytest.approx(np.mean(truth != renamed))


@given(st.integers(1, 5), st.data())
def test_error_is_that_of_the_search_over_permutations(k, data):
    """The Hopkins155 code tries every renumbering of 1..K."""
    n = data.draw(st.integers(k, 40))
    truth = np.array(
        [*range(1, k + 1), *data.draw(st.lists(st.integers(1, k), min_size=n - k, max_size=n - k))]
    )
    pred = np.array(data.draw(st.lists(st.integers(1, k), min_size=n, max_size=n)))
    by_search = min(np.mean(truth != np.array((0, *p))[pred]) for p in permutations(range(1, k + 1)))
    assert classification_error(truth, pred) == pytest.approx(by_search)


@pytest.mark.parametrize(
    ("truth", "pred", "error"),
    [
        ([1, 1, 2, 2], [2, 2, 1, 1], 0 / 4),
        ([1, 1, 1, 1, 2, 2], [1, 1, 3, 3, 2, 2], 2 / 6),  # one group too many: the left-over is wrong
        ([1, 1, 1, 2, 2, 3], [1, 1, 1, 1, 1, 1], 3 / 6),  # one group: only the largest motion is right
        ([1, 1, 2, 2], [0, 1, 2, 2], 1 / 4),  # outlier: wrong
        ([1, 1, 2, 2], [0, 0, 0, 0], 4 / 4),
        ([0, 0, 1, 2], [1, 2, 3, 4], 0 / 2),  # truth 0: not counted
        ([7, 7, 9], [0, 7, 9], 1 / 3),
        (np.array([[1], [1], [2]]), np.array([[1.0, 1.0, 2.0]]), 0),  # MATLAB's shapes and doubles
    ],
)
def test_error_by_hand(truth, pred, error):
    assert classification_error(truth, pred) == pytest.approx(error)


def test_many_groups_cost_nothing(rng):
    truth, pred = rng.integers(1, 40, 5000), rng.integers(1, 400, 5000)
    assert 0 < classification_error(truth, pred) < 1


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (5, 1), (4, 4), (3, 9), (9, 3), (6, 6), (7, 12), (5, 0)])
def test_assignment_is_the_best_there_is(shape, rng):
    """Small tables are searched, large ones solved; both are optimal."""
    for _ in range(20):
        counts = rng.integers(0, 9, shape)
        chosen = best_assignment(counts)
        taken = chosen[chosen >= 0]
        assert len(set(taken.tolist())) == len(taken)
        rows, columns = linear_sum_assignment(counts, maximize=True)
        assert counts[chosen >= 0, taken].sum() == counts[rows, columns].sum()


def test_tie_goes_to_the_larger_overlap():
    # Group 0 or 1 for motion 0 agree on two each; group 1 holds nothing else.
    assert best_assignment(np.array([[2, 2], [0, 0]])).tolist() == [0, -1]
    assert best_assignment(np.array([[2, 2, 0], [3, 0, 5]])).tolist() == [1, 2]


def test_a_tie_does_not_depend_on_numbers_where_there_are_outliers():
    for first, second in ((1, 2), (2, 1)):
        table = contingency([first] * 8 + [second] * 2, [1, 1, *[0] * 6, 1, 1])
        assert all_metrics()["iou"](table) == pytest.approx(0.25)


def test_background_against_moving():
    truth = [1] * 6 + [2] * 3 + [3] * 3
    pred = [1] * 5 + [2] + [2] * 3 + [1] + [3] * 2
    table = contingency(truth, pred, background=1)
    # One of the background is called moving, one moving is called background.
    assert all_metrics()["moving_error"](table) == pytest.approx(2 / 12)
    assert all_metrics()["moving_f"](table) == pytest.approx(2 * 5 / (2 * 5 + 1 + 1))


@pytest.mark.parametrize(
    ("truth", "pred", "word"),
    [
        ([1, 2], [1, 2, 3], "2 labels"),
        ([0, 0], [1, 2], "at least one label"),
        ([1, 2], [1, -1], "labels >= 0"),
        ([1, 2], [1, 1.5], "whole numbers"),
        ([1, 2], [1, float("nan")], "NaN"),
        ([1, 2], ["a", "b"], "vector of labels"),
        ([1, 2], [[1, 2], [1, 2]], "vector of labels"),
    ],
)
def test_what_is_no_labels_is_refused(truth, pred, word):
    with pytest.raises(InvalidValueError, match=word):
        classification_error(truth, pred)


def test_the_function_contingency_does_not_hide_its_module():
    import mseg.evaluation.contingency as module

    assert module.contingency is contingency
