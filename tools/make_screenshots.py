"""Take the pictures of the labelling page and of a report for the README; everything in them is synthetic.

kt3dmoseg demo -o demo-out
python tools/make_screenshots.py demo-out -o docs/figures
"""

from __future__ import annotations

import argparse
import io
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import browser
from PIL import Image
from playwright.sync_api import Page, sync_playwright

CLIP = "2011_09_26_drive_0002"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("demo", type=Path, help="folder that `kt3dmoseg demo` filled")
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/figures"))
    given = parser.parse_args()
    with labelling(given.demo) as address, sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=browser.find(), args=["--no-sandbox"])
        page = chromium.new_page(viewport={"width": 1300, "height": 700})
        page.goto(address)
        page.get_by_text("leaving car").first.wait_for()
        save(page, given.output / "labelling.webp")
        page = chromium.new_page(viewport={"width": 1100, "height": 1400})
        page.goto((given.demo / "report-subset.html").resolve().as_uri())
        save(page, given.output / "report.webp")


@contextmanager
def labelling(demo: Path) -> Iterator[str]:
    """Serve the labelling page of a clip; yields its address."""
    paths = [str(demo / "dataset" / f"{CLIP}.h5"), str(demo / "frames")]
    command = [sys.executable, "-m", "kt3dmoseg", "label", *paths, "--no-browser"]
    command += ["--annotations", str(demo / "annotations")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as server:
        assert server.stdout is not None
        try:
            lines = (re.search(r"http://\S+", line) for line in server.stdout)
            yield next(match[0] for match in lines if match)
        finally:
            server.terminate()


def save(page: Page, path: Path) -> None:
    page.wait_for_timeout(3000)  # flow and trajectories arrive after the page
    Image.open(io.BytesIO(page.screenshot())).convert("RGB").save(path, quality=70, method=6)
    print(path)


if __name__ == "__main__":
    main()
