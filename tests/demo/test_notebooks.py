"""The notebooks of the docs run, and say in words what the stored outputs say."""

from __future__ import annotations

import os
import re
from importlib.util import find_spec

import pytest

if not os.environ.get("CI") and not (find_spec("nbclient") and find_spec("ipykernel")):
    pytest.skip("needs nbclient and ipykernel, which the extra test has", allow_module_level=True)

import nbformat
from run_notebooks import FOLDER, executed

NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def said(notebook):
    """The texts and the kinds of all outputs, without figures: these may differ in the last digits."""
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    bundles = [dict(output.get("data", {"text/plain": output.get("text")})) for output in outputs]
    pictures = [bundle.pop("image/jpeg", None) is not None for bundle in bundles]
    texts = [bundle.get("text/html", bundle["text/plain"]) for bundle in bundles]
    return pictures, [re.sub(r"[\d.±+-]+", "#", re.sub(r"<[^>]+>|\s", "", text)) for text in texts]


def test_there_are_five_notebooks():
    assert len(NOTEBOOKS) == 5


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs_and_says_what_is_stored(path):
    stored = nbformat.read(path, as_version=4)
    pictures, texts = said(stored)
    assert any(pictures)
    assert said(executed(path)) == (pictures, texts)
