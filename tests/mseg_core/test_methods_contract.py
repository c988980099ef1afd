"""What every registered method owes its callers."""

from __future__ import annotations

import dataclasses
import inspect
import pickle
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import mseg
from kt3dmoseg.errors import KT3DMoSegError
from kt3dmoseg.options import describe
from kt3dmoseg.types import Clip, Labels, Trajectories
from mseg.errors import SegmentationError
from mseg.evaluation import classification_error
from mseg.kernels import kernel_cache
from mseg.methods import METHODS

pytestmark = pytest.mark.parametrize("method", METHODS.names())


@pytest.fixture(scope="module")
def tiny(make_clip) -> Clip:
    return make_clip(points=16)


@pytest.fixture(scope="module")
def kernels(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("kernels")


@pytest.fixture
def shared(kernels) -> Iterator[None]:
    """Kernels of a clip are made for the first method that has them, not for each."""
    with kernel_cache(kernels):
        yield


def test_is_a_described_frozen_dataclass(method):
    cls = METHODS.load(method)
    assert dataclasses.is_dataclass(cls)
    made = cls()
    with pytest.raises(dataclasses.FrozenInstanceError):
        made.anything = 1
    text = " ".join((inspect.getdoc(cls) or "").split())
    assert all(part in text for part in ("Source:", "Input:", "umber of motions", "Cost:")), text
    assert all(text for _, _, text in describe(cls))
    assert pickle.loads(pickle.dumps(made)) == made


def test_labels_every_evaluated_trajectory(method, tiny):
    result = mseg.segment(tiny, method, n_motions=2, seed=1)
    assert result.labels.shape == (len(tiny.evaluated),)
    assert result.labels.dtype == np.int64
    assert set(result.labels.tolist()) <= {0, 1, 2}


@pytest.fixture(scope="module")
def scaled(make_clip) -> Callable[[float], Clip]:
    """A clip in an image of 2000 x 1000 pixels, and the same in other units."""
    xy = np.array(make_clip(points=40, frames=12).dense.xy) * 3

    def scale(factor: float) -> Clip:
        size = (round(2000 * factor), round(1000 * factor))
        trajectories = Trajectories(xy * factor, np.isfinite(xy[..., 0]), image_size=size)
        return Clip("scaled", trajectories, np.arange(len(xy)), Labels(np.ones(len(xy), dtype=np.int64)))

    return scale


@pytest.mark.usefixtures("shared")
@pytest.mark.parametrize("factor", [0.001, 10.0])
def test_the_unit_of_coordinates_does_not_matter(method, factor, scaled):
    pixels, other = (mseg.segment(scaled(by), method, n_motions=2).labels for by in (1.0, factor))
    assert classification_error(pixels + 1, other + 1) <= 0.03


@pytest.mark.usefixtures("shared")
def test_whole_numbers_of_numpy_are_numbers(method, tiny):
    small, plain = (
        mseg.segment(tiny, method, n_motions=kind(2), seed=kind(200)).labels for kind in (np.uint8, int)
    )
    np.testing.assert_array_equal(small, plain)


def test_no_outliers_where_none_are_asked_for(method, tiny):
    if method == "alc":
        pytest.skip("outliers are part of ALC")
    assert mseg.segment(tiny, method, n_motions=2).labels.min() >= 1


def test_same_seed_same_labels_and_the_truth_is_not_looked_at(method, tiny):
    other = tiny.with_labels(Labels(np.ones(len(tiny.evaluated), dtype=np.int64)))
    first, second = (mseg.segment(clip, method, n_motions=2, seed=3).labels for clip in (tiny, other))
    np.testing.assert_array_equal(first, second)


def _clip(xy: np.ndarray) -> Clip:
    visible = np.isfinite(xy).all(axis=2)
    return Clip("degenerate", Trajectories(xy, visible), np.arange(len(xy)), Labels(np.ones(len(xy), int)))


def _set(index: object, value: object) -> Callable[[np.ndarray], np.ndarray]:
    def change(xy: np.ndarray) -> np.ndarray:
        xy[index] = value
        return xy

    return change


CASES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "never visible": _set(3, np.nan),
    "nothing visible": _set(slice(None), np.nan),
    "duplicated": lambda xy: np.concatenate([xy, xy[:1], xy[:1], xy[:1]]),
    "all identical": lambda xy: np.repeat(xy[:1], 24, axis=0),
    "all standing still in one place": _set(slice(None), 7.0),
    "each standing still": lambda xy: np.repeat(xy[:, :1], xy.shape[1], axis=1),
    "on the same line in all frames": lambda xy: xy * (1, 0),
    "collinear": lambda xy: np.stack([xy[..., 0], 2 * xy[..., 0]], axis=2),
    "too few points": lambda xy: xy[:2],
    "two frames": lambda xy: xy[:, :2],
    "one frame": lambda xy: xy[:, :1],
    "no points": lambda xy: xy[:0],
}


@pytest.mark.usefixtures("shared")
@pytest.mark.parametrize("case", CASES)
def test_degenerate_clips_give_labels_or_a_reason(method, case, make_clip):
    clip = _clip(CASES[case](np.array(make_clip(points=12).dense.xy)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            labels = mseg.segment(clip, method, n_motions=2, seed=0).labels
        except SegmentationError as error:
            assert "\n" not in str(error)
        else:
            assert labels.shape == (len(clip.evaluated),)
            assert set(labels.tolist()) <= {0, 1, 2}


def test_more_motions_than_points(method, make_clip):
    clip = _clip(np.array(make_clip(points=5).dense.xy))
    try:
        labels = mseg.segment(clip, method, n_motions=11, seed=0).labels
    except SegmentationError:
        return
    assert labels.shape == (10,)


def test_the_number_of_motions_is_found_or_asked_for(method, tiny):
    try:
        assert mseg.segment(tiny, method).labels.min() >= 0
    except KT3DMoSegError as error:
        assert "n_motions" in str(error)
        assert "n_motions=" in str(error)


def test_bad_numbers_of_motions_are_refused(method, tiny):
    with pytest.raises(KT3DMoSegError, match="n_motions"):
        mseg.segment(tiny, method, n_motions=0)


def test_misspelt_parameters_are_refused(method, tiny):
    with pytest.raises(KT3DMoSegError, match="no_such_option"):
        mseg.segment(tiny, method, n_motions=2, no_such_option=1)
