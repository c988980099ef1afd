"""tools/truth.py scores tracks and labels: on a drive in KITTI's layouts, whose truth is known exactly."""

import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kt3dmoseg import Clip, Labels, Trajectories, save
from kt3dmoseg.synthetic import SceneOptions, make_scene

TOOLS = Path(__file__).parents[2] / "tools"
FRAME = 3  # whose truth is written


@pytest.fixture(scope="module")
def tools():
    sys.path.insert(0, str(TOOLS))
    try:
        import export_truth
        import truth

        yield truth.main, export_truth.main
    finally:
        sys.path.remove(str(TOOLS))


@pytest.fixture(scope="module")
def world(tools, tmp_path_factory):
    root = tmp_path_factory.mktemp("world")
    options = {"width": 480, "height": 144, "frames": 6, "objects": 3, "samples": 1}
    assert tools[1]([str(root), *(f"--{name}={value}" for name, value in options.items())]) == 0
    scene = make_scene(SceneOptions(**options))
    x, y = np.meshgrid(np.arange(4, 480, 6), np.arange(4, 144, 6))
    points = np.c_[x.ravel(), y.ravel(), np.full(x.size, FRAME)]
    tracks, labels = scene.trajectories(points), scene.labels(points)
    return root, Clip("exact", tracks, np.arange(len(tracks)), labels)


@pytest.fixture
def score(tools, world, tmp_path, capsys):
    def run(clip, kind, *more):
        save(clip, tmp_path / "clip.h5")
        folders = {"tracklets": "raw"}
        kitti = world[0] / folders.get(kind, f"{kind}/training")
        code = tools[0]([kind, str(tmp_path / "clip.h5"), f"--kitti={kitti}", *more])
        said = capsys.readouterr()
        if code:
            return said.err
        rows = [re.split(r"\s{2,}", line) for line in said.out.splitlines()]
        return {row[0]: row[1:] for row in rows if len(row) == 7}

    return run


PLACES = {
    "sceneflow": ["--index", f"{FRAME}=0"],
    "tracking": [],
    "tracklets": ["--drive=2011_09_26_0001"],
}


def percent(cell):
    return float(cell.rstrip("%"))


@pytest.mark.parametrize("kind", PLACES)
def test_exact_labels_agree_with_the_truth_and_a_wrong_one_is_found(world, score, kind):
    clip = world[1]
    rows = score(clip, kind, *PLACES[kind])
    assert percent(rows["all"][-1]) > 99
    assert int(rows["moving"][0]) > 40
    objects = [name for name in rows if name.startswith("exact ")]
    assert len(objects) == 3
    label = np.where(clip.labels.label == 2, 1, clip.labels.label)
    wrong = score(replace(clip, labels=Labels(label, 1)), kind, *PLACES[kind])
    shares = sorted(percent(wrong[name][-1]) for name in objects)
    assert shares[0] < 2
    assert shares[1] > 90


def test_errors_of_tracks_are_measured_in_the_camera_of_the_clip(world, score):
    clip = world[1]
    rows = score(clip, "sceneflow", *PLACES["sceneflow"])
    assert float(rows["all"][1]) < 0.05
    assert percent(rows["all"][3]) > 99
    xy = clip.dense.xy.copy()
    xy[:, FRAME + 1, 0] += 2
    visible = np.isfinite(xy).all(axis=2) & (xy[..., 0] < 479)
    xy[~visible] = np.nan
    moved = replace(clip, dense=Trajectories(xy, visible, image_size=clip.dense.image_size))
    rows = score(moved, "sceneflow", *PLACES["sceneflow"])
    assert float(rows["all"][1]) == pytest.approx(2, abs=0.05)
    assert rows["all"][3] == "0.0%"


def test_the_truth_of_camera_2_lies_where_camera_0_sees_it(world):
    import truth

    depth = make_scene(SceneOptions(width=480, height=144, frames=6, objects=3)).depth(FRAME)
    right = []
    for camera in (0, 2):
        found = truth.surface(world[0] / "sceneflow" / "training", 0, camera)
        x, y = np.rint(found.xy).astype(int).T
        inside = (x >= 0) & (x < 480)
        seen = depth[y[inside], x[inside]]
        right.append(np.mean(np.abs(seen / found.depth[inside] - 1) < 0.01))
    assert right[0] > 0.97
    assert right[1] < right[0] - 0.03


def test_masks_and_boxes_of_tracking_name_the_same_objects(world, score, monkeypatch):
    import truth

    by_masks = score(world[1], "tracking")
    monkeypatch.setattr(
        truth,
        "in_masks",
        lambda boxes, tracks, folder, start, P: truth.in_boxes(
            boxes, P["P0"][:3, :3], world[1].dense.image_size
        ),
    )
    by_boxes = score(world[1], "tracking")
    assert int(by_boxes["moving"][0]) < int(by_masks["moving"][0])
    assert percent(by_boxes["moving"][-1]) > 99


def test_the_tracker_alone_is_scored_on_the_multi_view_frames(tools, world, capsys):
    assert tools[0](["pairs", "0", f"--kitti={world[0] / 'sceneflow/training'}"]) == 0
    median = re.search(r"^all +\d+ +(\S+)", capsys.readouterr().out, re.MULTILINE)
    assert 0.01 < float(median[1]) < 0.5


@pytest.mark.parametrize(
    ("kind", "more", "expected"),
    [
        ("sceneflow", ["--drive=2011_09_26_0020"], "a drive that KITTI 2015 has"),
        ("sceneflow", ["--drive=2011_09_26_0009"], "found {'exact': '0..5'}"),
        ("sceneflow", ["--index", "3=7"], "000007_10.png"),
        ("tracking", ["--sequence=0001"], "0001.txt"),
        ("tracklets", [], "date"),
    ],
)  # fmt: skip
def test_truth_that_is_not_there_is_one_line(world, score, kind, more, expected):
    message = score(world[1], kind, *more)
    assert expected in message
    assert message.count("\n") == 1


def test_labels_that_do_not_name_the_background_are_refused(world, score):
    clip = replace(world[1], labels=Labels(world[1].labels.label))
    assert "background" in score(clip, "tracking")
