"""The figures of tools/tracker_fidelity.py, on tracks whose errors are known."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from kt3dmoseg.synthetic import SceneOptions, make_scene
from kt3dmoseg.types import Clip, Labels, Trajectories

TOOLS = Path(__file__).parents[2] / "tools"


@pytest.fixture
def tool(monkeypatch):
    monkeypatch.syspath_prepend(TOOLS)
    return lambda part: import_module(f"tracker_{part}")


def moved(tracks, shift):
    """The same tracks, off by `shift` in every frame after the first."""
    drift = np.arange(tracks.n_frames)[:, None] > 0
    return Trajectories(tracks.xy + drift * np.asarray(shift), tracks.visible, image_size=tracks.image_size)


def test_errors_against_the_truth_are_those_that_were_made(tool):
    truth = tool("truth")
    scene = make_scene(SceneOptions(width=160, height=96, frames=11, objects=1, seed=1, speed=3.0, noise=0.0))
    x, y = np.meshgrid(np.arange(30, 130, 12.0), np.arange(40, 60, 8.0))
    exact = scene.trajectories(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1))
    exact = exact.select(exact.visible.all(axis=1))
    assert len(exact) > 10
    wanted = {"median": 0, "95 %": 0, "< 1 px": 1, "slid": 0}
    assert truth.compare(scene, exact).figures() == pytest.approx(wanted, abs=1e-9)
    found = truth.compare(scene, moved(exact, (0.3, 0.4))).figures()
    assert found["median"] == pytest.approx(0.5)
    assert found["95 %"] == pytest.approx(0.5)
    far = truth.compare(scene, moved(exact, (0, -35))).figures()
    assert far["< 1 px"] == 0
    assert far["slid"] > 0


def test_tracks_of_others_are_compared_from_the_starts_that_they_come_near(tool):
    release = tool("release")
    cells = np.stack(np.divmod(np.arange(60), 10), axis=1) * 16.0
    xy = cells[:, None] + np.arange(12)[:, None] * (2.0, 0.5)
    visible = np.ones((60, 12), bool)
    visible[30:, :3] = False
    xy[~visible] = np.nan
    clip = Clip("a", Trajectories(xy, visible), np.arange(60), Labels(np.ones(60, int), 1))
    begin = visible.argmax(axis=1)
    off = np.where(np.arange(12)[:, None] > begin[:, None, None], (0.3, 0.4), 0)  # from its start on
    theirs = Trajectories((xy + off + (1.0, -1.0))[::-1][:45], visible[::-1][:45])
    found = release.compare_tracks(clip, theirs)
    assert found.matched.tolist() == [45, 60]
    assert found.figures()["5: median"] == pytest.approx(0.5)
    assert found.figures()["number"] == pytest.approx(45 / 60)


def test_aims_name_the_tracks_that_reach_them(tool):
    release = {"default": {"5: median": 0.2, "first recall": 0.95}}
    truth = {"default": {"median": 0.3, "slid": 0.004}, "reliable": {"median": 0.1, "slid": 0.0}}
    text = tool("aims").aims(release, truth)
    rows = {
        cells[1]: cells[2:5] for cells in ([c.strip() for c in line.split("|")] for line in text.splitlines())
    }
    assert rows["release, 5 frames: median <= 0.27 px"] == ["0.2", "-", "yes: default"]
    assert rows["first cells: recall >= 0.96"] == ["0.95", "-", "no"]
    assert rows["first cells: precision >= 0.91"] == ["-", "-", "-"]
    assert rows["truth, 10 frames: median <= 0.15 px"] == ["0.3", "0.1", "yes: reliable"]
    assert rows["share slid to another object <= 0.005"] == ["0.004", "0", "yes: default, reliable"]
