"""Servers and tabs for the tests of the labelling page."""

from __future__ import annotations

import shutil
import signal

import numpy as np
import pytest
from annotation_scenes import write_clip
from labeller_page import LIMIT, Page, Server


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    folder = tmp_path_factory.mktemp("clips")
    np.save(folder / "moving.npy", write_clip(folder, "one"))
    write_clip(folder, "two", frames=3, tracks=50)
    return folder


@pytest.fixture
def moving(clips):
    """Which trajectories of the clip "one" are on the box that moves."""
    return np.load(clips / "moving.npy").tolist()


@pytest.fixture(scope="module")
def running(clips, tmp_path_factory):
    """One server for all tests that leave it alone; it keeps nothing of an annotation but its file."""
    notes = tmp_path_factory.mktemp("shared") / "notes"
    server = Server(clips, notes)
    server.notes = notes
    yield server
    server.stop(signal.SIGKILL)


@pytest.fixture
def shared(running):
    shutil.rmtree(running.notes, ignore_errors=True)
    return running


@pytest.fixture
def server(clips, tmp_path):
    """A server that the test may kill."""
    own = Server(clips, tmp_path / "notes")
    own.notes = tmp_path / "notes"
    yield own
    own.stop(signal.SIGKILL)


@pytest.fixture
def context(browser):
    made = browser.new_context(viewport={"width": 1280, "height": 720}, accept_downloads=True)
    made.set_default_timeout(1000 * LIMIT)
    yield made
    made.close()


@pytest.fixture
def page(context, shared):
    made = Page(context, shared.address)
    yield made
    assert made.errors == []
    made.settle()  # a save on its way would be somebody else's in the next test
