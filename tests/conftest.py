"""Fixtures that every test may use."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

_HERE = Path(__file__).parent
sys.path.insert(0, str(_HERE.parent / "tools"))

# No test depends on how fast the machine is.
settings.register_profile("kt3dmoseg", deadline=None)
settings.load_profile("kt3dmoseg")


@pytest.fixture(scope="session")
def data_root() -> Path:
    """The real data: KT3DMOSEG_DATA, or ../shared/data next to the checkout.

    A test that needs it is skipped only where there is none and the environment names none.
    """
    named = os.environ.get("KT3DMOSEG_DATA")
    root = Path(named) if named else _HERE.parent.parent / "shared" / "data"
    if root.is_dir():
        return root.resolve()
    if named:
        pytest.fail(f"KT3DMOSEG_DATA={named}: no such folder")
    pytest.skip("real data not here; set KT3DMOSEG_DATA to run this test")


@pytest.fixture(scope="module")  # playwright runs an event loop, which other modules must not meet
def browser():
    """A headless Chromium or Chrome; its tests are skipped where there is none, but never in CI."""
    from browser import find

    path = find()
    if not path:
        missing = "no Chromium or Chrome here: python3 tools/start.py test finds or installs one"
        pytest.fail(missing) if os.environ.get("CI") else pytest.skip(missing)
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        # A name that is not localhost: over plain http browsers trust such a page with less.
        names = "--host-resolver-rules=MAP team.example 127.0.0.1"
        yield playwright.chromium.launch(executable_path=path, args=["--no-sandbox", names])


@pytest.fixture(scope="session")
def axe() -> str:
    """The script of axe-core; its tests are skipped where npm cannot fetch it, but never in CI."""
    from browser import axe

    script = axe()
    if not script:
        missing = "axe-core is not here, and npm cannot fetch it"
        pytest.fail(missing) if os.environ.get("CI") else pytest.skip(missing)
    return script


@pytest.fixture
def plugin(tmp_path, monkeypatch):
    """A function that installs a package of one module behind an entry point of a group."""

    def install(group: str, name: str, target: str, source: str) -> None:
        folder = tmp_path / "installed" / name
        (info := folder / f"their_{name}-1.0.dist-info").mkdir(parents=True)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: their-{name}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[{group}]\n{name} = {target}\n")
        module = target.partition(":")[0]
        (folder / f"{module}.py").write_text(source)
        monkeypatch.delitem(sys.modules, module, raising=False)  # of another test
        monkeypatch.syspath_prepend(folder)

    return install


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)
