"""What the README and the docs point to exists."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from kt3dmoseg import __version__

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    *sorted(ROOT.glob("*.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "annotations").glob("*.md")),
]
PLACES = "kt3dmoseg|mseg|tools|docs|tests|benchmarks|annotations|results"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_and_paths_lead_somewhere(page):
    text = page.read_text()
    links = [link.partition("#")[0] for link in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in link]
    lost = [link for link in links if link and not (page.parent / link).exists()]
    paths = re.findall(rf"`((?:{PLACES})/[\w./-]+)`", text)
    lost += [path for path in paths if not (ROOT / path).exists()]
    assert not lost


def test_every_page_is_linked_from_another():
    pages = set((ROOT / "docs").rglob("*.md"))
    linked = {
        (page.parent / link).resolve()
        for page in pages
        for link in re.findall(r"\]\(([\w./-]+\.md)", page.read_text())
        if (page.parent / link).resolve() != page
    }
    assert pages - {ROOT / "docs" / "index.md"} <= linked


def test_version_is_the_same_everywhere():
    cited = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(), flags=re.MULTILINE)
    assert cited[1] == __version__
    assert f"## {__version__}" in (ROOT / "CHANGELOG.md").read_text()
