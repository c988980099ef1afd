"""Make the pictures of the docs (the page, a report, ten seconds of a clip), and the page's keys in the docs.

Everything in the pictures is synthetic.

kt3dmoseg demo -o demo-out
python tools/make_screenshots.py demo-out -o docs/figures
"""

from __future__ import annotations

import argparse
import io
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import browser
import numpy as np
from PIL import Image
from playwright.sync_api import Page, sync_playwright

import kt3dmoseg
from kt3dmoseg.synthetic import SceneOptions, make_scene

CLIP = "2011_09_26_drive_0002"
DOCS = Path(__file__).resolve().parents[1] / "docs" / "labelling.md"
KEYS = """() => import("/static/keys.js").then(({ KEYS }) => Object.entries(KEYS)
  .flatMap(([group, keys]) => keys.map(({ shown, text }) => [group, shown, text])))"""
FRAMES, RATE = 50, 5  # of the animation: ten seconds


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("demo", type=Path, help="folder that `kt3dmoseg demo` filled")
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/figures"))
    given = parser.parse_args()
    animate(given.output / "clip.webp")
    with labelling(given.demo) as address, sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=browser.find(), args=["--no-sandbox"])
        page = chromium.new_page(viewport={"width": 1300, "height": 700}, color_scheme="dark")
        page.goto(address)
        page.get_by_text("leaving car").first.wait_for()
        before, rest = DOCS.read_text(encoding="utf-8").split("<!-- table: keys -->")
        DOCS.write_text(f"{before}{keys_table(page)}{rest[rest.index('<!-- end') :]}", encoding="utf-8")
        page.keyboard.press("]")
        save(page, given.output / "labelling.webp")
        page = chromium.new_page(viewport={"width": 1100, "height": 1050})
        page.goto((given.demo / "report-subset.html").resolve().as_uri() + "#overlays")
        save(page, given.output / "report.webp")


def keys_table(page: Page) -> str:
    """Return the keys of the labelling page as a table in Markdown, from the page's own table of them."""
    rows = [f"| {group} | `{shown}` | {text} |" for group, shown, text in page.evaluate(KEYS)]
    return "\n".join(["<!-- table: keys -->", "| for | key | what it does |", "|---|---|---|", *rows, ""])


def animate(path: Path) -> None:
    """Show the tracks of a drive, coloured by the exact motion of the point where each starts."""
    scene = make_scene(SceneOptions(width=621, height=188, frames=FRAMES, objects=3))
    frames = scene.frames()
    tracks = kt3dmoseg.track(frames)
    start = tracks.visible.argmax(axis=1)
    points = np.column_stack([tracks.xy[np.arange(len(tracks)), start], start])
    clip = kt3dmoseg.Clip("clip", tracks, np.arange(len(tracks)), scene.labels(points))
    with tempfile.TemporaryDirectory() as folder:
        kt3dmoseg.save(clip, f"{folder}/clip.h5")
        for number, frame in enumerate(frames):
            Image.fromarray(frame).save(f"{folder}/{number:03d}.png")
        shown = kt3dmoseg.show(f"{folder}/clip.h5", folder, output=f"{folder}/shown", scale=2, trail=6)
        first, *others = (Image.open(picture).convert("RGB").resize((828, 250)) for picture in sorted(shown))
    options = {"duration": 1000 // RATE, "loop": 0, "quality": 40, "method": 6}
    first.save(path, save_all=True, append_images=others, **options)
    print(path, path.stat().st_size >> 10, "kB")


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
