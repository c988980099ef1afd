"""The examples in docstrings are true."""

import doctest
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FILES = [
    path.relative_to(ROOT).with_suffix("")
    for package in ("kt3dmoseg", "mseg")
    for path in sorted((ROOT / package).rglob("*.py"))
    if ">>> " in path.read_text()
]
MODULES = [".".join(path.parts).removesuffix(".__init__") for path in FILES]


@pytest.mark.parametrize("module", MODULES)
def test_examples_give_what_they_say(module):
    assert not doctest.testmod(import_module(module)).failed
