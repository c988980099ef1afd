"""Labels of all trajectories, from those of some; labels of pixels, from those of trajectories."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

import kt3dmoseg
import mseg
from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import Labels, Trajectories
from mseg import methods
from mseg.benchmark import predict
from mseg.evaluation.validation import validate_submission
from mseg.spreading import dense_mask, spread_labels


@pytest.fixture
def clip(make_clip):
    """Three boxes, of which every second trajectory is evaluated, out of order."""
    whole = make_clip(points=40, motions=3, missing=0.1)
    rows = np.random.default_rng(0).permutation(len(whole.dense))[::2]
    return replace(whole, evaluated=rows, labels=Labels(whole.labels.label[rows])), whole.labels.label


def test_evaluated_rows_keep_their_labels(clip):
    clip, truth = clip
    every = mseg.segment(clip, "subset", n_motions=3, rows="all")
    evaluated = mseg.segment(clip, "subset", n_motions=3)
    assert np.array_equal(every.rows, np.arange(len(clip.dense)))
    assert np.array_equal(every.labels[clip.evaluated], evaluated.labels)
    assert np.array_equal(every.evaluated_labels(clip), evaluated.labels)
    assert np.array_equal(evaluated.evaluated_labels(clip), evaluated.labels)
    assert every.report["trajectories_segmented"] == len(clip.evaluated)
    assert mseg.score(clip, every)["error"] == mseg.score(clip, evaluated)["error"]
    assert mseg.score(truth=truth, pred=every)["error"] <= 0.05
    table = every.to_dataframe(clip)
    assert np.array_equal(table["track"], clip.dense.track_id)


def test_of_many_a_sample_is_segmented(make_clip, monkeypatch):
    clip = make_clip(points=60, motions=2)
    monkeypatch.setattr(methods, "_MOST", 50)
    result = mseg.segment(clip, "subset", n_motions=2, rows="all")
    assert result.report["trajectories_segmented"] == 50
    assert mseg.score(clip, result)["error"] <= 0.05
    assert np.array_equal(result.labels, mseg.segment(clip, "subset", n_motions=2, rows="all").labels)


def test_rows_are_evaluated_or_all(make_clip):
    with pytest.raises(InvalidValueError, match="evaluated or all"):
        mseg.segment(make_clip(), "one_motion", rows="some")


def test_all_rows_are_compared_with_the_labels_that_are_known(make_clip):
    clip = make_clip(points=20)
    half = replace(clip, evaluated=np.arange(20), labels=Labels(clip.labels.label[:20]))
    found = mseg.segment(half, "subset", n_motions=clip.n_motions, rows="all")
    shown, labels = found._on(half)
    assert len(shown.evaluated) == len(labels) == len(clip.dense)
    np.testing.assert_array_equal(shown.labels.label[:20], half.labels.label)
    assert not shown.labels.label[20:].any()


def test_nothing_evaluated_spreads_to_nothing(make_clip):
    clip = replace(
        make_clip(points=4), evaluated=np.zeros(0, dtype=int), labels=Labels(np.zeros(0, dtype=int))
    )
    assert not mseg.segment(clip, "one_motion", rows="all").labels.any()


def test_labels_of_another_clip_are_refused(clip, make_clip):
    found = mseg.segment(make_clip(points=2), "one_motion", rows="all")
    with pytest.raises(InvalidValueError):
        mseg.score(clip[0], found)


def test_motion_counts_more_than_position():
    """Two layers that lie on each other and move in opposite directions."""
    rng = np.random.default_rng(1)
    start, layer = rng.uniform(0, 100, (200, 1, 2)), np.arange(200) % 2
    steps = np.arange(6)[None, :, None] * np.where(layer, 2.0, -2.0)[:, None, None]
    tracks = Trajectories(start + steps, np.ones((200, 6), dtype=bool))
    rows = np.arange(100)
    assert np.array_equal(spread_labels(tracks, rows, layer[:100] + 4), layer + 4)


def test_short_lives_and_lonely_ones():
    xy = np.full((5, 6, 2), np.nan)
    xy[0], xy[1] = (10, 10), (90, 90)
    xy[2, 2], xy[3, 4:] = (88, 90), (11, 10)
    tracks = Trajectories(xy, np.isfinite(xy[..., 0]))
    assert spread_labels(tracks, np.array([1, 0]), np.array([7, 0])).tolist()[:4] == [0, 7, 7, 0]
    alone = np.full((3, 6, 2), np.nan)
    alone[0, :3] = alone[1, :3] = (5, 5)
    alone[2, 3:] = (80, 80)
    tracks = Trajectories(alone, np.isfinite(alone[..., 0]))
    assert spread_labels(tracks, np.array([0, 1]), np.array([3, 3])).tolist() == [3, 3, 3]
    # Outliers are no motion, however many they are.
    outliers = np.array([0, 0, 0, 7])
    seen = np.eye(5, dtype=bool)
    alone = Trajectories(np.where(seen[..., None], np.ones(2), np.nan), seen)
    assert spread_labels(alone, np.arange(4), outliers).tolist() == [0, 0, 0, 7, 7]


def test_memory_grows_linearly():
    def peak(count):
        rng = np.random.default_rng(0)
        xy = rng.uniform(0, 1000, (count, 1, 2)) + rng.normal(0, 1, (count, 6, 2)).cumsum(axis=1)
        tracks, rows = Trajectories(xy, np.ones((count, 6), dtype=bool)), np.arange(500)
        tracemalloc.start()
        spread_labels(tracks, rows, rows % 4)
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    small, large = peak(20_000), peak(40_000)
    assert large < 2.2 * small
    assert large < 40_000 * 1000


def test_a_mask_ends_at_the_edge():
    picture = np.full((120, 160), 50, dtype=np.uint8)
    picture[40:90, 50:120] = 200
    inside = picture > 100
    xy, labels = np.array([[5.0, 5.0], [150, 100], [70, 60], [10, 100]]), np.array([1, 1, 2, 1])
    for given in (picture, np.repeat(picture[..., None], 3, axis=2)):
        mask = dense_mask(given, xy, labels)
        assert (mask > 0).all()
        assert ((mask == 2) != inside).sum() < 0.2 * inside.sum()
    assert not dense_mask(picture, xy[:0], labels[:0]).any()


def test_a_run_writes_all_labels_next_to_the_submission(clip, tmp_path):
    clip, _ = clip
    kt3dmoseg.save(clip, tmp_path / "data" / "tiny.h5")
    out = predict(tmp_path / "data", tmp_path / "out", "affine", seeds=2, rows="all")
    assert validate_submission(out, tmp_path / "data").ok
    every = mseg.segment(clip, "affine", n_motions=3, seed=1, rows="all")
    text = (tmp_path / "out-all" / "seed-1" / "tiny.csv").read_text().split()
    assert text == [
        "track,label",
        *(f"{t},{v}" for t, v in zip(clip.dense.track_id, every.labels, strict=True)),
    ]
    before = (tmp_path / "out-all" / "seed-0" / "tiny.csv").read_bytes()
    (tmp_path / "out-all" / "seed-0" / "tiny.csv").unlink()
    predict(tmp_path / "data", tmp_path / "out", "affine", seeds=2, rows="all")
    assert (tmp_path / "out-all" / "seed-0" / "tiny.csv").read_bytes() == before
