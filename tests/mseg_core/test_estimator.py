"""The estimator is one of scikit-learn's, and gives what `mseg.segment` gives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.cluster import KMeans
from sklearn.utils.estimator_checks import check_estimator

import mseg
from kt3dmoseg.errors import InvalidValueError, UnknownNameError
from kt3dmoseg.types import Trajectories

# What scikit-learn checks with tables that hold no trajectories, and why each check does not apply.
NOT_FOR_TRAJECTORIES = {
    "check_dtype_object": "its values lie between 0 and 1: no pixels, which is refused",
}


@dataclass(frozen=True)
class Places:
    """Cluster positions; the checks draw blobs of points, in which no real method finds motions."""

    def segment(self, clip, *, n_motions, rng):
        xy = clip.evaluated_trajectories.xy.reshape(len(clip.evaluated), -1)
        means = KMeans(n_motions, random_state=int(rng.integers(99)))
        return mseg.Segmentation(means.fit_predict(np.nan_to_num(xy)) + 1)


class LikePixels(mseg.MotionSegmenter):
    """Most checks draw 1, 3 or 5 columns of numbers near 0: one column more, and a hundred times that."""

    def fit(self, X, y=None):
        if isinstance(X, np.ndarray) and X.ndim == 2 and X.dtype.kind in "fiu" and len(X):
            X = 100 * np.column_stack([X, X[:, : X.shape[1] % 2]])
        return super().fit(X)


def test_scikit_learn_takes_it_for_one_of_its_clusterers():
    estimator = LikePixels(Places(), n_motions=3)
    done = check_estimator(estimator, expected_failed_checks=NOT_FOR_TRAJECTORIES, on_skip=None)
    assert sum(each["status"] == "passed" for each in done) > 35


def moving(rng):
    """Forty points in six frames, of which the second half goes the other way."""
    steps = np.repeat([1.0, -2.0], 20)[:, None, None] * np.arange(6)[:, None] * [1.0, 0.3]
    return rng.uniform(50, 200, (40, 1, 2)) + steps


def test_a_table_an_array_and_trajectories_give_the_labels_of_segment(rng):
    xy = moving(rng)
    estimator = mseg.MotionSegmenter("ssc", n_motions=2, random_state=3)
    expected = mseg.segment(xy, "ssc", n_motions=2, seed=3)
    for given in (xy, xy.reshape(40, -1), Trajectories(xy, np.ones((40, 6), bool))):
        labels = clone(estimator).fit_predict(given)
        assert labels.tolist() == (expected.labels - 1).tolist()
    assert estimator.fit(xy).segmentation_.labels.tolist() == expected.labels.tolist()


def test_outliers_are_minus_one(rng):
    class Method:
        def segment(self, clip, *, n_motions, rng):
            return mseg.Segmentation(np.arange(40) % 3 * 2)

    assert mseg.MotionSegmenter(Method()).fit_predict(moving(rng)).tolist()[:4] == [-1, 0, 1, -1]


def test_gaps_are_nan_and_x_without_y_is_refused(rng):
    table = moving(rng).reshape(40, -1)
    table[0, :2] = np.nan
    assert len(mseg.MotionSegmenter("one_motion").fit(table).labels_) == 40
    with pytest.raises(InvalidValueError, match=r"X: expected an even number of columns, .*, found shape"):
        mseg.MotionSegmenter("one_motion").fit(table[:, :-1])


def test_masked_values_of_a_table_are_not_visible(rng):
    xy = moving(rng)
    hidden = np.zeros_like(xy, dtype=bool)
    hidden[::5, 2] = True
    estimator = mseg.MotionSegmenter("subset", n_motions=2, parameters={"hypotheses": 20})
    masked = estimator.fit_predict(np.ma.array(xy, mask=hidden).reshape(40, -1))
    assert masked.tolist() == estimator.fit_predict(np.where(hidden, np.nan, xy).reshape(40, -1)).tolist()
    with pytest.raises(InvalidValueError, match="visible: expected no masked values"):
        mseg.segment(xy, visible=np.ma.array(np.ones((40, 6)), mask=hidden[..., 0]))


def test_parameters_are_those_of_the_method(rng):
    with pytest.raises(UnknownNameError, match="rows"):
        mseg.MotionSegmenter("ssc", n_motions=2, parameters={"rows": "all"}).fit(moving(rng))
    with pytest.raises(InvalidValueError, match="parameters: expected a mapping"):
        mseg.MotionSegmenter("ssc", n_motions=2, parameters=["alpha"]).fit(moving(rng))
