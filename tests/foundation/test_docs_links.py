"""What the README and the docs point to exists."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from kt3dmoseg import __version__

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    *sorted(ROOT.glob("*.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "docs").rglob("*.ipynb")),
    *sorted((ROOT / "annotations").glob("*.md")),
]
PLACES = "kt3dmoseg|mseg|tools|docs|tests|benchmarks|annotations|results"


def text_of(page):
    """The Markdown of a page; of a notebook, that of its cells."""
    if page.suffix != ".ipynb":
        return page.read_text()
    cells = json.loads(page.read_text())["cells"]
    return "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")


def links_of(page):
    """What a page links to within the repository: pairs of a file and an anchor, either may be empty."""
    links = re.findall(r"\]\(([^)\s]+)\)", text_of(page))
    return [link.partition("#")[::2] for link in links if "://" not in link]


def anchors_of(page):
    """The anchors of a page's headings, as GitHub and the site make them."""
    headings = re.findall(r"^#+ (.+)$", text_of(page), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_and_paths_lead_somewhere(page):
    lost, text = [], text_of(page)
    for link, anchor in links_of(page):
        target = page.parent / link if link else page
        if not target.exists() or (anchor and anchor not in anchors_of(target)):
            lost.append(f"{link}#{anchor}")
    paths = re.findall(rf"`((?:{PLACES})/[\w./-]+)`", text)
    lost += [path for path in paths if not (ROOT / path).exists()]
    assert not lost


def test_every_page_and_figure_is_linked_from_another_page():
    files = {file for suffix in ("md", "ipynb") for file in (ROOT / "docs").rglob(f"*.{suffix}")}
    files |= set((ROOT / "docs" / "figures").iterdir())
    linked = {(page.parent / link).resolve() for page in PAGES for link, _ in links_of(page) if link}
    assert files - {ROOT / "docs" / "index.md"} <= linked


def test_pictures_are_described_and_of_bearable_size():
    pictures = [found for page in PAGES for found in re.findall(r"!\[([^\]]*)\]\(", text_of(page))]
    assert len(pictures) > 10
    assert all(len(description.split()) >= 3 for description in pictures)
    assert max(file.stat().st_size for file in (ROOT / "docs" / "figures").iterdir()) <= 1.5e6


def test_there_are_at_most_1400_lines_written_by_hand():
    lines = 0
    for page in [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]:
        text = re.sub(r"<!-- table:.*?<!-- end of table -->", "", page.read_text(), flags=re.DOTALL)
        text = re.sub(r"^```\{.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE)  # what the site generates
        lines += len(text.splitlines()) * (page.name != "baselines-results.md")  # which is generated as well
    assert lines <= 1400


def test_version_is_the_same_everywhere():
    cited = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(), flags=re.MULTILINE)
    assert cited[1] == __version__
    assert f"## {__version__}" in (ROOT / "CHANGELOG.md").read_text()
