"""The drives of the synthetic benchmark: planned alike in both halves, measured and labelled exactly."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from kt3dmoseg import synthetic
from kt3dmoseg.io import load
from kt3dmoseg.pipeline import SyntheticDrive, build_synthetic
from kt3dmoseg.synthetic import SceneOptions, make_drive, measure_drive, plan_drives
from kt3dmoseg.synthetic.drives import _collide
from kt3dmoseg.synthetic.scene import Layout, Scene
from kt3dmoseg.synthetic.street import street
from kt3dmoseg.synthetic.vehicles import Drive, Vehicle
from kt3dmoseg.types import Trajectories
from mseg.benchmark.runner import recipe
from mseg.evaluation import load_protocol

PUBLIC, TEST = plan_drives()[:100], plan_drives()[100:]


def filmed(camera: Drive, *drives: Drive, frames: int = 11) -> Scene:
    """Film cars from a car that does not nod."""
    cars = [Vehicle("car", "car", drive) for drive in drives]
    faces = street(np.random.default_rng(0), 10.0, 30.0, (-20.0, 60.0))
    return Scene(
        SceneOptions(width=310, height=94, frames=frames, samples=1), Layout(camera, cars, faces, shake=0.0)
    )


def test_both_halves_have_the_same_numbers_of_everything():
    assert len({plan.name for plan in (*PUBLIC, *TEST)}) == 200
    assert plan_drives() == [*PUBLIC, *TEST]
    for what in ("motions", "camera"):
        counts = [Counter(getattr(plan, what) for plan in half) for half in (PUBLIC, TEST)]
        assert counts[0].keys() == counts[1].keys()
    assert Counter(p.motions for p in PUBLIC) == Counter(p.motions for p in TEST)
    assert not {plan.name for plan in plan_drives(1)} & {plan.name for plan in plan_drives()}


def test_a_plan_makes_the_same_drive_again_with_its_number_of_vehicles():
    for plan in PUBLIC[:2]:
        first, second = make_drive(plan), make_drive(plan)
        assert len(first.vehicles) == plan.motions - 1
        assert [v.drive for v in first.vehicles] == [v.drive for v in second.vehicles]
        assert np.array_equal(first.ids(3), second.ids(3))
        assert set(np.unique(first.ids(first.n_frames // 2))) <= set(range(plan.motions + 1))


def test_motion_along_the_epipolar_lines_is_measured_as_such():
    camera = Drive(0.0, 5.0, speed=6.0)
    along = measure_drive(filmed(camera, Drive(0.0, 17.0, speed=8.0)))
    across = measure_drive(filmed(camera, Drive(0.0, 17.0, yaw=0.6, speed=8.0)))
    assert along["epipolar"] < 1e-6 < 1.0 < along["motion"]
    assert across["epipolar"] > 2.0
    assert measure_drive(filmed(camera)).keys() == {"depth"}


def test_a_camera_that_only_turns_has_no_epipolar_lines_but_the_rotation():
    found = measure_drive(filmed(Drive(0.0, 5.0, yaw_rate=0.1), Drive(0.0, 17.0, speed=2.0)))
    assert found["epipolar"] == found["motion"] > 0
    still = measure_drive(filmed(Drive(0.0, 5.0, yaw_rate=0.1), Drive(0.0, 17.0)))
    assert still["motion"] == pytest.approx(0.0, abs=1e-9)
    assert still["standing"] == 1.0


def test_a_vehicle_moves_only_during_its_time():
    drive = Drive(0.0, 0.0, speed=5.0, during=(0.0, np.inf))
    assert np.array_equal(drive.pose(-0.4), drive.pose(0.0))
    assert drive.pose(0.2)[2, 3] == pytest.approx(1.0)
    found = measure_drive(filmed(Drive(0.0, 5.0), Drive(0.0, 17.0, speed=5.0, during=(0.0, np.inf))))
    assert found["standing"] == pytest.approx(0.5)


def test_vehicles_side_by_side_pass_and_those_that_overlap_collide():
    car = Vehicle("car", "car", Drive(0.0, 0.0))
    assert not _collide(car, Vehicle("truck", "truck", Drive(-3.5, 0.5)), 0.0)
    assert _collide(car, Vehicle("truck", "truck", Drive(-3.5, 0.5, yaw=np.pi / 2)), 0.0)
    assert _collide(car, Vehicle("car", "car", Drive(0.5, 4.0)), 0.0)


def test_a_trajectory_that_slides_from_one_object_to_another_has_no_label():
    scene = filmed(Drive(0.0, 5.0), Drive(0.0, 17.0, speed=2.0))
    drive = SyntheticDrive(PUBLIC[0])
    drive.__dict__["scene"] = scene
    y, x = np.argwhere(scene.ids(0) == 2).mean(axis=0)
    xy = np.full((3, 11, 2), (x, y))
    xy[1] = 3.0
    xy[2, 6:] = 3.0
    assert drive.label(Trajectories(xy, np.ones((3, 11), dtype=bool))).label.tolist() == [2, 1, 0]


def test_the_benchmark_is_built_once_and_keeps_what_was_measured(tmp_path, monkeypatch):
    scene = filmed(Drive(0.0, 5.0, speed=3.0), Drive(0.5, 14.0, yaw=0.3, speed=5.0), frames=6)
    monkeypatch.setattr("kt3dmoseg.synthetic.drives.make_drive", lambda plan: scene)
    wanted = {"part": "public", "first": 1, "workers": 1}
    (made,) = build_synthetic(tmp_path, **wanted)
    assert (made.name, made.status) == ("synth_p001", "built")
    (again,) = build_synthetic(tmp_path, **wanted)
    assert again.status == "up to date"
    clip = load(made.path)
    assert clip.n_motions == 2
    assert clip.provenance["attributes"] == {"camera": PUBLIC[0].camera} | dict(measure_drive(scene))
    rounded = replace(clip, dense=replace(clip.dense, xy=clip.dense.xy + 1e-4))
    assert recipe({"a": rounded}) == recipe({"a": clip}) != ""
    assert recipe({"a": clip, "b": replace(clip, provenance={})}) == ""
    before = SyntheticDrive(PUBLIC[0]).inspect().description
    monkeypatch.setattr(synthetic, "ALGORITHM_VERSION", 0)
    assert SyntheticDrive(PUBLIC[0]).inspect().description != before


def test_a_cluster_builds_the_same_clips(tmp_path, monkeypatch):
    distributed = pytest.importorskip("distributed")
    scene = filmed(Drive(0.0, 5.0, speed=3.0), Drive(0.5, 14.0, yaw=0.3, speed=5.0), frames=6)
    monkeypatch.setattr("kt3dmoseg.synthetic.drives.make_drive", lambda plan: scene)
    wanted = {"part": "public", "first": 1}
    (here,) = build_synthetic(tmp_path / "here", workers=1, **wanted)
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        (there,) = build_synthetic(tmp_path / "there", dask=cluster.scheduler_address, **wanted)
    assert (there.status, there.reason) == ("built", "new")
    assert there.path.read_bytes() == here.path.read_bytes()


def test_the_protocol_knows_what_the_drives_are():
    protocol = load_protocol("synth")
    plans = {plan.name: plan for plan in (*PUBLIC, *TEST)}
    assert all(protocol.holds(name) for name in plans)
    assert not protocol.holds(plan_drives(1)[0].name)
    for name, values in protocol.attributes.items():
        assert values["camera"] == plans[name].camera
        assert values.keys() <= {axis.name for axis in protocol.axes}
    name = next(name for name, plan in plans.items() if plan.motions == 3)
    measured = measure_drive(make_drive(plans[name]))
    for axis, value in measured.items():
        assert protocol.attributes[name][axis] == pytest.approx(value, rel=1e-3)
