"""Fidelity to the release on one real clip stays above a floor, with the default flow."""

from __future__ import annotations

import numpy as np
import pytest

import kt3dmoseg
from kt3dmoseg.tracking import TrackOptions
from kt3dmoseg.tracking.linking import structured

CLIP = "Seq020_Clip01"
NO_STOPS = {"consistency_floor": float("inf"), "boundary_floor": float("inf")}


@pytest.fixture(scope="module")
def release(data_root):
    return kt3dmoseg.load(data_root / "kt3dmoseg" / "release" / f"{CLIP}_Tracks.mat")


@pytest.fixture(scope="module")
def frames(data_root):
    return sorted((data_root / "kt3dmoseg" / "frames" / CLIP).glob("*.png"))


@pytest.mark.data
def test_released_tracks_are_followed(release, frames):
    dense = release.dense
    rows = np.flatnonzero(dense.visible[:, 0] & dense.visible[:, 3])
    seeds = np.c_[dense.xy[rows, 0], np.zeros(len(rows))]
    ours = kt3dmoseg.track(frames[:4], seeds=seeds, **NO_STOPS)
    error = np.linalg.norm(ours.xy[:, 3] - dense.xy[rows, 3], axis=1)
    assert len(rows) > 1000
    assert np.median(error) < 0.2
    assert (error < 1).mean() > 0.97


@pytest.mark.data
def test_released_start_cells_have_structure(release, frames):
    """All but a few in a thousand released tracks start where we would start one."""
    from kt3dmoseg.io.images import read_frame

    starts = release.dense.xy[release.dense.visible[:, 0], 0]
    assert structured(read_frame(frames[0]), np.rint(starts), TrackOptions()).mean() > 0.995
    np.testing.assert_array_equal(starts % 8, 4)
