"""The examples run, and do what they are there to show."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


@pytest.fixture
def example(monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLES)
    return lambda name: importlib.import_module(name).main


def test_segment_and_score(example):
    errors = example("segment_and_score")()
    assert errors["keradd"] < 0.01 < errors["one_motion"]


def test_track_a_folder(example):
    tracks = example("track_a_folder")()
    assert len(tracks) > 100
    assert tracks.lengths.mean() > 4


def test_your_own_method(example, capsys):
    assert 0 < example("your_own_method")() < 1
    assert "velocity: error" in capsys.readouterr().out
