"""Trajectories kept as runs: the same to every caller as dense ones, in the memory of their points."""

from __future__ import annotations

import pickle
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kt3dmoseg.io import hdf5
from kt3dmoseg.tracking.tracker import RunTrajectories
from kt3dmoseg.types import Clip, Labels, Trajectories


def _lives(draw):
    frames = draw(st.integers(2, 8))
    starts = sorted(draw(st.lists(st.integers(0, frames - 1), max_size=12)))
    return frames, [(s, draw(st.integers(s + 1, frames))) for s in starts]


@st.composite
def stores(draw):
    """Positions frame by frame, the number of trajectories, and the same as dense arrays."""
    frames, lives = _lives(draw)
    rng = np.random.default_rng(0)
    xy = np.full((len(lives), frames, 2), np.nan)
    store = []
    for frame in range(frames):
        ids = rng.permutation([k for k, (start, end) in enumerate(lives) if start <= frame < end])
        ids = ids.astype(np.int64)
        xy[ids, frame] = rng.random((len(ids), 2))
        store.append((ids, xy[ids, frame]))
    return store, len(lives), xy


@given(stores(), st.integers(0, 4))
def test_runs_are_the_dense_arrays(made, min_length):
    store, count, xy = made
    tracks = RunTrajectories(store, count, min_length, (64, 48))
    kept = np.isfinite(xy[..., 0]).sum(axis=1) >= min_length
    dense = Trajectories(xy[kept], np.isfinite(xy[kept, :, 0]), image_size=(64, 48))
    assert isinstance(tracks, Trajectories)
    assert (len(tracks), tracks.n_frames, tracks.image_size) == (len(dense), dense.n_frames, (64, 48))
    np.testing.assert_array_equal(tracks.lengths, dense.lengths)
    np.testing.assert_array_equal(tracks.track_id, dense.track_id)
    with pytest.raises(IndexError):
        tracks.at(dense.n_frames)
    for frame in range(-1, dense.n_frames):
        for found, wanted in zip(tracks.at(frame), dense.at(frame), strict=True):
            np.testing.assert_array_equal(found, wanted)
    for found, wanted in zip(tracks.block(1, 3), dense.block(1, 3), strict=True):
        np.testing.assert_array_equal(found, wanted)
    rows = np.arange(len(dense))[::-2]
    np.testing.assert_array_equal(tracks.select(rows).xy, dense.select(rows).xy)
    np.testing.assert_array_equal(tracks.select(rows).track_id, dense.select(rows).track_id)
    mask = dense.lengths > 2
    np.testing.assert_array_equal(tracks.select(mask).visible, dense.select(mask).visible)
    np.testing.assert_array_equal(tracks.xy, dense.xy)
    np.testing.assert_array_equal(tracks.visible, dense.visible)
    again = pickle.loads(pickle.dumps(tracks))
    np.testing.assert_array_equal(again.xy, dense.xy)
    for array in (tracks.xy, tracks.visible, tracks.track_id):
        assert not array.flags.writeable


def test_a_long_clip_is_written_in_the_memory_of_its_points(tmp_path):
    frames, alive, life = 1000, 60, 12
    store, count = [], frames * alive // life
    for frame in range(frames):
        ids = np.arange(count)[(np.arange(count) * life // alive <= frame)]
        ids = ids[frame < ids * life // alive + life]
        store.append((ids, np.full((len(ids), 2), float(frame))))
    tracemalloc.start()
    dense = RunTrajectories(store, count, 5, (640, 480))
    clip = Clip("long", dense, np.arange(len(dense)), Labels(np.zeros(len(dense), dtype=np.int64)))
    hdf5.write(clip, tmp_path / "long.h5")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < len(dense) * frames * 16 / 4  # a quarter of what the dense array takes
    read = hdf5.read(tmp_path / "long.h5")
    np.testing.assert_array_equal(read.dense.xy, dense.xy)
