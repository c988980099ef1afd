"""Frozen behaviour: arrays of a built clip, labels of every method, what every command prints.

A change that is meant: raise the ALGORITHM_VERSION of the part whose numbers changed, write the frozen
files again with ``python tests/golden/scenario.py``, and read the diff.
"""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
import scenario
from scipy.optimize import linear_sum_assignment

import mseg

FROZEN = json.loads(scenario.METHODS.read_text())
CHANGED = (
    "numbers changed: raise the ALGORITHM_VERSION of the part that changed, then run tests/golden/scenario.py"
)
CLIPS = scenario.method_clips()


@pytest.fixture(scope="session")
def session(tmp_path_factory):
    return scenario.run_session(tmp_path_factory.mktemp("session"))


def test_a_built_clip_keeps_its_arrays(tmp_path):
    clip, frozen = scenario.built_clip(tmp_path), scenario.frozen_clip()
    with np.load(scenario.CLIP) as stored:
        assert stored["version"].tolist() == scenario.build_versions(), "run tests/golden/scenario.py"
        # Other versions of OpenCV round differently: a few tracks start or end elsewhere.
        slack = 1 if str(stored["opencv"]) == cv2.__version__ else 40
    assert len(clip.dense) == pytest.approx(len(frozen.dense), rel=0.001 * slack), CHANGED
    apart = nearest_start(clip.dense, frozen.dense)
    assert np.median(apart) < 0.001 * slack, CHANGED
    assert (apart < 0.02 * slack).mean() > 0.97, CHANGED
    assert clip.n_motions == frozen.n_motions
    assert len(clip.evaluated) == pytest.approx(len(frozen.evaluated), abs=3), CHANGED
    counts = [np.bincount(each.labels.label, minlength=4) for each in (clip, frozen)]
    assert np.abs(counts[0] - counts[1]).max() <= 2, CHANGED


def nearest_start(tracks, others):
    """Give for each track the mean distance of its two ends to those of the nearest of the others."""
    ends = [
        np.hstack([each.xy[rows, first], each.xy[rows, last]])
        for each in (tracks, others)
        for rows, first, last in [spans(each)]
    ]
    return np.linalg.norm(ends[0][:, None] - ends[1][None], axis=2).min(axis=1) / 2


def spans(tracks):
    first = tracks.visible.argmax(axis=1)
    last = tracks.n_frames - 1 - tracks.visible[:, ::-1].argmax(axis=1)
    return np.arange(len(tracks)), first, last


@pytest.mark.parametrize("method", FROZEN["labels"])
def test_a_method_keeps_its_labels(method):
    assert FROZEN["versions"] == scenario.method_versions(), "run tests/golden/scenario.py"
    for name, clip in CLIPS.items():
        found, frozen = scenario.labels_of(method, clip), FROZEN["labels"][method][name]
        if not frozen.isdecimal():
            assert found == frozen
        else:
            assert disagreement(found, frozen) <= 1 + 0.02 * len(frozen), f"{method} on {name}: {CHANGED}"


def disagreement(found, frozen):
    a, b = (np.array([*map(int, text)]) for text in (found, frozen))
    table = np.zeros((10, 10))
    np.add.at(table, (a, b), 1)
    return len(a) - table[linear_sum_assignment(-table)].sum()


def test_every_method_is_frozen():
    assert sorted(FROZEN["labels"]) == sorted(mseg.methods.list())


@pytest.mark.parametrize("name", scenario.SESSION)
def test_a_command_prints_what_it_printed(session, name):
    assert session[name] == scenario.file_of(name).read_text()
