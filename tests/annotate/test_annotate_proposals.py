"""Proposals: what moves by itself, KITTI's boxes, masks, and those of other packages."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from kt3dmoseg import synthetic
from kt3dmoseg.annotate import Annotation, KeyFrame, proposals
from kt3dmoseg.annotate.formats.masks import encode_rle, mask_of
from kt3dmoseg.annotate.proposals import outline, residual, tracklets
from kt3dmoseg.catalog import Drive, Entry
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.io.images import write_png
from kt3dmoseg.neighbours import alike, near_pairs
from kt3dmoseg.types import Labels, Trajectories
from mseg.proposals import propose as propose_mseg

SIZE, FRAMES = (400, 200), 8


def tracks(seed=0):
    """A camera that drives forward through points, and a close group of points that crosses to the right."""
    rng = np.random.default_rng(seed)
    ground = rng.uniform((-12, -4, 8), (12, 3, 40), (900, 3))
    walker = rng.uniform((-2.5, -1, 12), (-0.5, 1, 12.5), (120, 3))
    points = np.concatenate([ground, walker])
    xy = np.empty((len(points), FRAMES, 2))
    for frame in range(FRAMES):
        at = points - (0, 0, 0.5 * frame)
        at[len(ground) :, 0] += 0.25 * frame
        xy[:, frame] = 250 * at[:, :2] / at[:, 2:] + (200, 100)
    xy += rng.normal(0, 0.05, xy.shape)
    visible = ((xy > 0) & (xy < np.array(SIZE) - 1)).all(axis=2)
    moving = np.arange(len(points)) >= len(ground)
    return Trajectories(np.where(visible[..., None], xy, np.nan), visible, image_size=SIZE), moving


def request(trajectories, **options):
    annotation = Annotation("clip", SIZE, FRAMES)
    return proposals.Request("clip", annotation, trajectories, (), **options)


def test_residual_finds_what_moves_by_itself():
    trajectories, moving = tracks()
    taken = residual.moving_groups(trajectories) > 1
    seen = trajectories.lengths > 3
    assert taken[moving & seen].mean() > 0.9
    assert taken[~moving & seen].mean() < 0.1
    assert not (residual.moving_groups(trajectories.select(~moving)) > 1).any()


def test_neighbours_move_alike_in_either_order():
    trajectories, _ = tracks()
    pairs = near_pairs(trajectories, np.arange(len(trajectories)))
    found = alike(trajectories, pairs)
    assert 0.1 < found.mean() < 0.9
    np.testing.assert_array_equal(found, alike(trajectories, pairs[:, ::-1]))


def test_residual_finds_what_moves_before_a_camera_at_rest():
    xy = np.random.default_rng(0).uniform((5, 5), (395, 195), (300, 1, 2)) + np.zeros((1, FRAMES, 1))
    xy[:40] = xy[:40] * 0.1 + (100, 100) + np.arange(FRAMES)[:, None] * (2.0, 0.0)
    still = Trajectories(xy, np.ones(xy.shape[:2], bool), image_size=SIZE)
    assert (residual.moving_groups(still) > 1).tolist() == [True] * 40 + [False] * 260


def test_residual_goes_on_where_no_epipolar_geometry_is_found():
    xy = np.random.default_rng(0).normal(70, 3, (16, 120, 2))  # OpenCV 5 raises at some of the pairs
    found = residual.moving_groups(Trajectories(xy, np.ones((16, 120), bool)))
    assert set(found) <= {0, 1}


def test_residual_needs_trajectories():
    trajectories, _ = tracks()
    with pytest.raises(InvalidValueError, match="trajectories"):
        residual.moving_groups(trajectories.select(np.arange(9)))


def test_proposals_take_numbers_that_are_free_and_leave_out_what_is_there():
    trajectories, _ = tracks()
    asked = request(trajectories)
    (first, *_) = proposals.propose("mseg", asked)
    there = replace(asked, annotation=replace(asked.annotation, objects=(first,)))
    assert proposals.propose("mseg", there) == []
    corner = KeyFrame(0, polygons=(((380, 180), (399, 180), (399, 199)),))
    elsewhere = replace(asked.annotation, objects=(replace(first, key_frames=(corner,)),))
    (again,) = proposals.propose("mseg", replace(asked, annotation=elsewhere))
    assert again.id > first.id
    assert again.motion > first.motion


def test_labels_of_another_package_become_regions(monkeypatch):
    trajectories, moving = tracks()

    def third_party(asked):
        return Labels(np.where(moving, 5, 1), background=1, names={5: "walker"})

    monkeypatch.setattr(proposals.PROPOSERS, "load", lambda name: third_party)
    (item,) = proposals.propose("anything", request(trajectories))
    assert (item.name, item.motion) == ("walker", 1)
    mask = mask_of([np.array(p) for p in item.key_frames[0].polygons], SIZE)
    x, y = np.rint(trajectories.xy[moving & trajectories.visible[:, 0], 0]).astype(int).T
    assert mask[y, x].mean() > 0.85
    assert mask.mean() < 0.1


@pytest.mark.parametrize(("spacing", "found"), [(8, 2), (30, 1)])
def test_movers_that_one_label_holds_are_proposed_one_by_one(spacing, found):
    """Where trajectories lie too far apart to tell, the label is one proposal."""
    xy = np.stack(np.meshgrid(np.arange(0, 400, spacing), np.arange(0, 200, spacing)), axis=-1).reshape(
        -1, 1, 2
    )
    moving = (xy[:, 0, 1] < 100) & (np.abs(xy[:, 0, 0] - 200) > 40)
    still = Trajectories(np.repeat(xy, FRAMES, axis=1), np.ones((len(xy), FRAMES), bool), image_size=SIZE)
    labels = Labels(np.where(moving, 2, 1), background=1)
    items = proposals.objects_from_labels(still, labels, Annotation("clip", SIZE, FRAMES))
    assert len(items) == found


@pytest.mark.parametrize(("every", "first", "last"), [(30, 3, 2), (50, 2, 3)])
def test_mseg_proposes_what_moves_by_itself_the_surest_first(every, first, last):
    trajectories, walker = tracks()
    second = trajectories.xy[~walker][::every].copy()  # a few of the scene's points that drift
    second = second * 0.1 + (330, 30) + np.arange(FRAMES)[:, None] * (-4.0, 2.5)
    xy = np.concatenate([trajectories.xy, second])
    seen = np.isfinite(xy[..., 0])
    label = propose_mseg(request(Trajectories(xy, seen, image_size=SIZE))).label
    assert (label[: len(walker)][walker & (trajectories.lengths > 3)] == first).mean() > 0.9
    assert (label[: len(walker)][~walker] > 1).mean() < 0.02
    assert (label[len(walker) :][trajectories.lengths[~walker][::every] > 3] == last).mean() > 0.9
    assert (propose_mseg(request(trajectories.select(~walker))).label == 1).all()
    with pytest.raises(KT3DMoSegError, match="50"):
        propose_mseg(request(trajectories.select(np.arange(9))))


def projected(points):
    """Trajectories of points (N, F, 3) in front of the camera."""
    xy = 250 * points[..., :2] / points[..., 2:] + (200, 100)
    xy += np.random.default_rng(0).normal(0, 0.02, xy.shape)
    visible = ((xy > 0) & (xy < np.array(SIZE) - 1)).all(axis=2)
    return Trajectories(np.where(visible[..., None], xy, np.nan), visible, image_size=SIZE)


def street(seed=0):
    """A camera that drives over a road between two walls, (N, F, 3) in its axes."""
    rng = np.random.default_rng(seed)
    road = rng.uniform((-5, 1.6, 10), (5, 1.6, 40), (600, 3))
    walls = rng.uniform((5, -3, 12), (6, 1.6, 40), (400, 3)) * (
        rng.choice((-1, 1), (400, 1)) * (1, 0, 0) + (0, 1, 1)
    )
    return np.concatenate([road, walls])[:, None] - (0, 0, 1.0) * np.arange(FRAMES)[:, None]


def test_mseg_proposes_what_would_float_before_the_ground():
    """An oncoming car stays on its epipolar lines: without the ground it is something static, nearer by."""
    car = np.random.default_rng(1).uniform((-1.9, 0.6, 14), (-0.4, 1.5, 14.5), (30, 3))[:, None]
    front, xy = projected(car - (0, 0, 1.7) * np.arange(FRAMES)[:, None]).xy, projected(street()).xy.copy()
    xy[((xy > front.min(axis=0) - 1) & (xy < front.max(axis=0) + 1)).all(axis=2)] = np.nan
    xy = np.concatenate([xy, front])
    trajectories = Trajectories(xy, np.isfinite(xy[..., 0]), image_size=SIZE)
    label = propose_mseg(request(trajectories)).label
    assert (label[-30:] > 1).mean() > 0.8
    assert (label[:-30] > 1).mean() < 0.02
    without = trajectories.select(np.arange(600, len(xy)))
    assert (propose_mseg(request(without)).label == 1).all()


def test_mseg_takes_what_slides_along_edges_for_static_where_it_sees_the_frames(tmp_path):
    rng = np.random.default_rng(0)
    picture = rng.integers(0, 256, SIZE[::-1]).astype(np.uint8)
    picture[20:60] = np.repeat(rng.integers(0, 256, 10), 4)[:, None]  # stripes
    paths = tuple(tmp_path / f"{k}.png" for k in range(FRAMES))
    for path in paths:
        write_png(path, cv2.GaussianBlur(picture, (0, 0), 1))
    xy = projected(street()).xy
    sliding = rng.uniform((150, 25), (230, 55), (60, 1, 2)) + np.arange(FRAMES)[:, None] * (2.0, 0.0)
    xy = np.concatenate([xy, sliding])
    asked = request(Trajectories(xy, np.isfinite(xy[..., 0]), image_size=SIZE))
    assert (propose_mseg(asked).label[-60:] > 1).all()
    assert (propose_mseg(replace(asked, frames=paths)).label == 1).all()
    for path in paths:  # of another size
        write_png(path, picture[:-1])
    assert (propose_mseg(replace(asked, frames=paths)).label[-60:] > 1).all()


def test_outline_follows_concave_shapes():
    corner = [(x, y) for x in range(40, 120, 8) for y in range(40, 120, 8) if x < 64 or y < 64]
    mask = mask_of([np.array(p) for p in outline(np.array(corner, float), SIZE)], SIZE)
    assert mask[44, 112]
    assert mask[112, 44]
    assert not mask[100, 100]


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    root = tmp_path_factory.mktemp("kitti")
    options = synthetic.SceneOptions(width=320, height=120, frames=8, objects=2, samples=1, seed=3)
    scene = synthetic.make_scene(options)
    return root, scene, synthetic.write_drive(scene, root)


def tracklet_request(drive, frames):
    root, _, _ = drive
    annotation = Annotation("clip", (320, 120), 8)
    some = Trajectories(np.zeros((1, 8, 2)), np.ones((1, 8), bool))
    return proposals.Request("clip", annotation, some, tuple(frames), kitti=root)


def check_boxes(found, scene):
    """Every vehicle that shows some size lies in the proposed region around it."""
    labels = scene.ids(0)
    boxes = np.zeros(labels.shape, bool)
    for item in found:
        boxes |= mask_of([np.array(p) for p in item.key_frames[0].polygons], (320, 120))
    assert (labels > 1).sum() > 100
    assert boxes[labels > 1].mean() > 0.9


def test_tracklets_of_a_drive(drive):
    _, scene, folder = drive
    frames = sorted((folder / "image_00" / "data").glob("*.png"))
    check_boxes(proposals.propose("tracklets", tracklet_request(drive, frames)), scene)


def test_tracklets_of_frames_that_were_copied_elsewhere(drive, tmp_path, monkeypatch):
    _, scene, folder = drive
    frames = [
        Path(shutil.copy(file, tmp_path / f"{k + 1:06d}.png"))
        for k, file in enumerate(sorted((folder / "image_00" / "data").glob("*.png")))
    ]
    entry = Entry("clip", Drive("2011_09_26", 1), 0, 8, numbers=tuple(range(8)))
    monkeypatch.setattr(tracklets.catalog, "load", lambda: {"clip": entry})
    check_boxes(proposals.propose("tracklets", tracklet_request(drive, frames)), scene)
    by_bytes = SimpleNamespace(drive=Drive("2011_09_26", 1), camera=0, numbers=None)
    monkeypatch.setattr(tracklets.catalog, "load", lambda: {"clip": by_bytes})
    check_boxes(proposals.propose("tracklets", tracklet_request(drive, frames)), scene)
    frames[3].write_bytes(b"another picture")
    with pytest.raises(InvalidValueError, match="000004"):
        proposals.propose("tracklets", tracklet_request(drive, frames))
    hollow = replace(tracklet_request(drive, frames), clip="other")
    with pytest.raises(InvalidValueError, match="catalog"):
        proposals.propose("tracklets", hollow)
    with pytest.raises(InputFileError, match="kitti=FOLDER"):
        proposals.propose("tracklets", replace(hollow, kitti=None))


def mask_request(folder):
    return proposals.Request("clip", Annotation("clip", (8, 4), 2), None, (), masks=folder)


def test_masks_as_mots_text_or_the_reason_why_not(tmp_path):
    with pytest.raises(InputFileError, match="masks=FOLDER"):
        proposals.propose("masks", mask_request(None))
    with pytest.raises(InputFileError, match="none"):
        proposals.propose("masks", mask_request(tmp_path))
    pixels = np.zeros((4, 8), bool)
    pixels[1:3, 2:5] = True
    (tmp_path / "clip.txt").write_text(f"1 1007 1 4 8 {encode_rle(pixels)}\n")
    (item,) = proposals.propose("masks", mask_request(tmp_path))
    assert (item.kind, item.motion, item.key_frames[1].frame) == ("car", 7, 1)
    assert item.key_frames[1].polygons == (((1.5, 0.5), (4.5, 0.5), (4.5, 2.5), (1.5, 2.5)),)


def test_masks_of_neither_format_are_refused_for_the_first_reason(tmp_path):
    (tmp_path / "clip").mkdir()
    cv2.imwrite(str(tmp_path / "clip" / "00000.png"), np.zeros((9, 9), np.uint8))
    with pytest.raises(FileFormatError, match="8x4"):
        proposals.propose("masks", mask_request(tmp_path))
