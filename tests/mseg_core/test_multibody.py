"""The method that finds the motions: their number, small ones, outliers, and what it reports."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_array

import mseg
from kt3dmoseg.types import Clip, Labels, Trajectories
from mseg.evaluation import classification_error
from mseg.methods.multibody import _Body, _Scene

SIZE = (1242, 375)
FOCAL = 720.0


def drive(seed, movers, *, background=150, frames=12, noise=0.1):
    """A forward drive past a scene of all depths, with cars (points, sideways, forwards, x, z)."""
    rng = np.random.default_rng(seed)

    def project(points, shift):
        at = points[None] - shift[:, None]
        return at[..., :2] / at[..., 2:] * FOCAL + np.array(SIZE) / 2

    # The camera brakes: beside a steady camera, a car that drives ahead at a steady speed is like a static
    # object farther away.
    times = np.arange(frames)[:, None]
    camera = (0.9 * times - 0.04 * times**2) * np.array([0.0, 0.0, 1.0])
    z = rng.uniform(10, 50, background)
    x = rng.uniform(-0.8, 0.8, background) * z
    scene = np.column_stack([x, rng.uniform(-0.15, 0.2, background) * z, z])
    images, labels = [project(scene, camera)], [np.ones(background, dtype=np.int64)]
    for k, (count, sideways, forwards, x0, z0) in enumerate(movers):
        car = rng.uniform((-1, -1, -2), (1, 0.8, 2), (count, 3)) + np.array([x0, 0.6, z0])
        motion = times * np.array([sideways, 0.0, forwards])
        images.append(project(car, camera - motion))
        labels.append(np.full(count, k + 2, dtype=np.int64))
    xy = np.concatenate(images, axis=1).swapaxes(0, 1)
    xy = xy + rng.normal(0, noise, xy.shape)
    tracks = Trajectories(xy, np.ones(xy.shape[:2], dtype=np.bool_), image_size=SIZE)
    return Clip(f"drive{seed}", tracks, np.arange(len(xy)), Labels(np.concatenate(labels)))


SCENES = {
    "the static scene alone": [],
    "a car that crosses": [(40, 0.4, 0.0, -4, 18)],
    "a car ahead, along the epipolar lines": [(30, 0.0, 0.5, 1, 12)],
    "a small mover": [(10, -0.3, 0.1, 5, 20)],
    "three cars": [(40, 0.35, 0.1, -6, 18), (25, 0.0, 0.9, 2, 14), (20, -0.5, 0.0, 8, 25)],
}


@pytest.mark.parametrize("name", SCENES)
def test_number_and_motions_are_found(name):
    clip = drive(1, SCENES[name])
    result = mseg.segment(clip, "multibody")
    assert result.report["n_motions"] == clip.n_motions
    assert classification_error(clip.labels.label, result.labels) <= 0.02


def four_atoms(costs):
    """A scene of four atoms, and bodies that have these costs."""
    atoms = np.repeat(np.arange(4), 6)
    points = Trajectories(np.zeros((24, 10, 2)), np.ones((24, 10), dtype=np.bool_), image_size=SIZE)
    scene = _Scene(points, csr_array((24, 24)), atoms, np.random.default_rng(0))
    scene.noise = 1.0
    return scene, [_Body(9 * np.expm1(np.array(row)[atoms]), 1.0) for row in costs]


def test_two_bodies_are_found_that_no_single_swap_leads_to():
    # Body 0 explains all a little, 1 and 2 a half each, 3 what lies between; from 0 one comes to 0 and 3.
    scene, bodies = four_atoms([[1, 1, 1, 1], [0.1, 0.1, 9, 9], [9, 9, 0.1, 0.1], [9, 0, 0, 9]])
    choices = scene._choose(bodies, 3)
    assert sorted(choices[2].bodies) == [1, 2]
    assert choices[2].group.tolist() in ([0, 0, 1, 1], [1, 1, 0, 0])


@pytest.mark.parametrize("neighbour", [0, 1])
def test_an_atom_that_fits_no_body_follows_its_neighbours(neighbour):
    scene, bodies = four_atoms([[0, 9, 8, 9], [9, 0, 9, 9]])
    scene.atom_edges[2, :2] = scene.atom_edges[:2, 2] = 1.0 + np.eye(2)[neighbour]
    scene.atom_edges[3, 2] = scene.atom_edges[2, 3] = 9.0  # which fits none itself
    choice = scene._choose(bodies, 2)[2]
    assert choice.bodies[choice.group[2]] == choice.bodies[choice.group[3]] == neighbour


@pytest.mark.parametrize("seed", range(3))
def test_what_only_shifts_before_a_camera_that_stands_still_is_a_motion_of_its_own(seed):
    """Its body explains still points, too, as points far away."""
    rng, frames = np.random.default_rng(seed), np.arange(12)[None]
    still = rng.uniform((0, 0), (640, 360), (100, 2))[:, None] + np.zeros((1, 12, 1))
    x, y, depth = rng.uniform((-1, -1, 10), (1, 1, 12), (100, 3)).T[..., None]
    near = depth - 0.2 * frames
    moving = np.stack([400 * (x + 0.15 * frames) / near + 320, 400 * y / near + 180], axis=2)
    xy = np.concatenate([still, moving]) + rng.normal(0, 0.01, (200, 12, 2))
    tracks = Trajectories(xy, np.ones((200, 12), dtype=bool), image_size=(640, 360))
    found = mseg.segment(tracks, "multibody", seed=seed)
    assert classification_error(np.repeat([1, 2], 100), found.labels) <= 0.02
    assert found.report["n_motions"] == 2


@pytest.mark.parametrize(("frames", "still"), [(4, 0), (5, 60)])
def test_short_lives_do_not_show_that_the_camera_is_still(frames, still):
    rng, xy = np.random.default_rng(0), np.full((80, 12, 2), np.nan)
    xy[:60, :frames] = rng.uniform(0, 300, (60, 1, 2))
    xy[60:] = rng.uniform(0, 300, (20, 1, 2)) + 5 * np.arange(12)[:, None]
    tracks = Trajectories(xy, np.isfinite(xy[..., 0]), image_size=SIZE)
    assert _Scene(tracks, csr_array((80, 80)), np.arange(80) % 4, rng).still.sum() == still


def test_the_number_is_that_asked_for():
    clip = drive(2, SCENES["three cars"])
    for number in (1, 2, 3, 4):
        result = mseg.segment(clip, "multibody", n_motions=number)
        assert len(np.unique(result.labels)) == number == result.report["n_motions"]


def test_the_report_says_how_sure_it_is():
    report = mseg.segment(drive(1, SCENES["a car that crosses"]), "multibody").report
    costs = dict(report["costs"])
    least = costs.pop(report["n_motions"])
    assert report["margin"] == pytest.approx(min(costs.values()) - least)
    assert report["margin"] > 0
    # Residuals of 0.1 px in both coordinates of twelve frames, in pixels.
    assert 0.03 < report["noise"] < 0.3


def test_trajectories_that_fit_nothing_can_be_outliers():
    clip = drive(3, SCENES["a car that crosses"])
    xy = np.array(clip.dense.xy)
    xy[:6] = np.random.default_rng(0).uniform(0, 300, xy[:6].shape)
    wild = Clip("wild", Trajectories(xy, clip.dense.visible, image_size=SIZE), clip.evaluated, clip.labels)
    assert mseg.segment(wild, "multibody", n_motions=2).labels.min() == 1
    labels = mseg.segment(wild, "multibody", n_motions=2, reject_outliers=True).labels
    assert (labels[:6] == 0).all()
    assert (labels[6:] == 0).mean() < 0.03


def test_no_image_size_is_needed():
    clip = drive(4, SCENES["three cars"])
    bare = Clip("bare", Trajectories(clip.dense.xy, clip.dense.visible), clip.evaluated, clip.labels)
    result = mseg.segment(bare, "multibody", n_motions=4)
    assert classification_error(clip.labels.label, result.labels) <= 0.02
