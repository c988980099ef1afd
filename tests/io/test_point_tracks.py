"""Tracks as point trackers and their benchmarks store them."""

from __future__ import annotations

import numpy as np
import pytest

from kt3dmoseg.cli import main
from kt3dmoseg.errors import FileFormatError, InvalidValueError
from kt3dmoseg.io import load, save
from kt3dmoseg.io.formats import convert
from kt3dmoseg.io.point_tracks import WRITTEN, write_layout
from kt3dmoseg.types import Clip, Labels, Trajectories

COUNT, FRAMES, WIDTH, HEIGHT = 40, 9, 320, 240
_F, _CX, _CY = 300.0, 160.0, 120.0


@pytest.fixture
def tracks(rng):
    """Points that move a little, some of them hidden for a while, as trackers report them."""
    start, step = rng.uniform(30, 200, (COUNT, 1, 2)), rng.uniform(-3, 3, (COUNT, 1, 2))
    xy, visible = start + step * np.arange(FRAMES)[:, None], rng.random((COUNT, FRAMES)) > 0.2
    return xy, visible


def _layouts(xy, seen):
    depth = np.linspace(5, 50, COUNT)[:, None, None]
    logit, low = np.where(seen, -4.0, 4.0), np.full(seen.shape, -4.0)
    space = np.concatenate([(xy - (_CX, _CY)) / _F * depth, depth + 0 * xy[..., :1]], axis=2)
    turned, flags = xy.swapaxes(0, 1), seen.T
    return {
        "cotracker": {"pred_tracks": turned[None], "pred_visibility": flags[None]},
        "cotracker, one number each": {
            "pred_tracks": turned[None],
            "pred_visibility": flags[None, ..., None],
        },
        "cotracker, no batch": {"pred_tracks": turned, "pred_visibility": flags * 0.9},
        "cotracker, short names": {"tracks": turned[None], "visibility": flags[None]},
        "tracks first": {"tracks": xy, "visibility": seen},
        "tapir": {"tracks": xy + 0.5, "visibles": seen},
        "tapir, batch": {"tracks": xy[None] + 0.5, "visibles": seen[None]},
        "tapir, logits": {"tracks": xy + 0.5, "occlusion": logit, "expected_dist": low},
        "tapir, inexact": {"tracks": xy + 0.5, "occlusion": low, "expected_dist": logit},
        "kubric": {"target_points": xy + 0.5, "occluded": ~seen, "query_points": np.zeros((COUNT, 3))},
        "pointodyssey": {"trajs_2d": turned, "visibs": flags, "valids": np.ones(flags.shape)},
        "pointodyssey, invalid": {"trajs_2d": turned, "visibs": 1 + 0 * flags, "valids": flags},
        "tapvid-3d": {
            "tracks_XYZ": space.swapaxes(0, 1),
            "visibility": flags,
            "fx_fy_cx_cy": np.array([_F, _F, _CX, _CY]),
            "images_jpeg_bytes": np.array([b"a picture"] * FRAMES, dtype=object),
        },
    }


@pytest.mark.parametrize("name", list(_layouts(np.zeros((COUNT, FRAMES, 2)), np.ones((COUNT, FRAMES), bool))))
def test_every_layout_gives_the_same_trajectories(tracks, tmp_path, name):
    xy, visible = tracks
    np.savez(tmp_path / "a.npz", **_layouts(xy, visible)[name])
    found = load(tmp_path / "a.npz").dense
    np.testing.assert_array_equal(found.visible, visible)
    np.testing.assert_allclose(found.xy[visible], xy[visible], atol=1e-9)


@pytest.mark.parametrize("layout", WRITTEN)
def test_what_is_written_as_a_tracker_does_is_read_again(tracks, tmp_path, layout):
    xy, visible = tracks
    xy = xy.round(9) + 5e-10  # halfway: the last bits decide which way they are rounded
    dense = Trajectories(np.where(visible[..., None], xy, np.nan), visible, image_size=(WIDTH, HEIGHT))
    save(Clip("a", dense, np.arange(COUNT), Labels(np.zeros(COUNT, int))), tmp_path / "a.h5")
    assert "coordinates" not in convert(tmp_path / "a.h5", tmp_path / "b.npz", layout=layout)
    with np.load(tmp_path / "b.npz") as stored:
        assert all(np.isfinite(stored[name]).all() for name in stored)
    found = load(tmp_path / "b.npz")
    assert found.provenance["format"] == layout
    np.testing.assert_allclose(found.dense.xy, dense.xy, atol=1e-9)


def test_a_clip_of_no_frames_is_written_in_every_layout(tmp_path):
    none = Trajectories(np.zeros((3, 0, 2)), np.zeros((3, 0), dtype=bool), image_size=(64, 48))
    clip = Clip("none", none, np.arange(3), Labels(np.zeros(3, dtype=int)))
    for layout in WRITTEN:
        write_layout(clip, tmp_path / f"{layout}.npz", layout)


def test_layouts_that_do_not_fit_are_refused(tracks, tmp_path, capsys):
    xy, visible = tracks
    dense = Trajectories(np.where(visible[..., None], xy, np.nan), visible)
    clip = Clip("a", dense, np.arange(COUNT), Labels(np.zeros(COUNT, int)))
    with pytest.raises(InvalidValueError, match="image_size: expected that of the frames, found none"):
        write_layout(clip, tmp_path / "a.npz", "tap-vid")
    save(clip, tmp_path / "a.h5")
    for target, layout in (("b.npz", "tapvid-3d"), ("b.h5", "tapir")):
        assert main(["convert", str(tmp_path / "a.h5"), str(tmp_path / target), "--layout", layout]) == 2
        assert "layout: expected cotracker, tapir" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"pred_tracks": np.zeros((2, FRAMES, COUNT, 2))}, "or a batch of one such video, found shape"),
        ({"pred_tracks": np.zeros((FRAMES, COUNT, 3))}, "frames and tracks x 2"),
        ({"pred_visibility": np.ones((COUNT, FRAMES))}, r"pred_visibility: expected shape \(9, 40\)"),
        ({"pred_visibility": np.full((FRAMES, COUNT), np.nan)}, "pred_visibility: expected 0 to 1"),
    ],
)
def test_arrays_of_another_shape_or_value_are_named(tracks, tmp_path, changes, message):
    xy, visible = tracks
    arrays = {"pred_tracks": xy.swapaxes(0, 1), "pred_visibility": visible.T}
    np.savez(tmp_path / "a.npz", **arrays | changes)
    with pytest.raises(FileFormatError, match=message):
        load(tmp_path / "a.npz")


def test_an_order_of_axes_that_does_not_show_is_not_guessed(rng, tmp_path):
    points = rng.uniform(0, 200, (COUNT, FRAMES, 2))  # as far from frame to frame as from track to track
    np.savez(tmp_path / "a.npz", tracks=points, visibility=np.ones(points.shape[:2]))
    with pytest.raises(FileFormatError, match=r"axes that show in how points move, .* pred_tracks"):
        load(tmp_path / "a.npz")
