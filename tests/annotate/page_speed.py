"""Figures of the labelling page: first picture, frames per second while dragging with many trajectories.

Not a test: run ``python tests/annotate/page_speed.py`` and read.
"""

from __future__ import annotations

import json
import signal
import sys
import tempfile
from pathlib import Path

from annotation_scenes import write_clip
from labeller_page import CORNERS, Page, Server
from playwright.sync_api import sync_playwright

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))
import browser as browsers

PICTURE = """() => {
  const loaded = performance.getEntriesByType('resource').find((e) => e.name.endsWith('/frames/0'));
  const paint = performance.getEntriesByName('first-contentful-paint')[0];
  return Math.round(Math.max(loaded.responseEnd, paint.startTime));
}"""

COUNT = """() => {
  window.times = [];
  const tick = (now) => { times.push(now); window.counting = requestAnimationFrame(tick); };
  requestAnimationFrame(tick);
}"""

STOP = """() => {
  cancelAnimationFrame(counting);
  const gaps = times.slice(1).map((t, i) => t - times[i]).sort((a, b) => a - b);
  const at = (share) => gaps[Math.floor(share * (gaps.length - 1))];
  const fps = 1000 * gaps.length / (times.at(-1) - times[0]);
  return { frames: gaps.length, fps, median_ms: at(0.5), p95_ms: at(0.95) };
}"""

# The page's own work for one frame of each kind, without waiting for the screen; the least of 30.
COST = """() => {
  const cost = (run) => Math.min(...Array.from({ length: 30 }, () => {
    const start = performance.now();
    run();
    return performance.now() - start;
  }));
  return {
    regions_ms: cost(() => labeller.drawRegions()),
    trajectories_ms: cost(() => labeller.drawTracks()),
    picture_ms: cost(() => labeller.drawPicture()),
  };
}"""


def measure(count: int) -> dict[str, object]:
    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        folder = Path(name)
        write_clip(folder, "one", size=(1242, 375), frames=20, tracks=count)
        server = Server(folder, folder / "notes")
        browser = playwright.chromium.launch(executable_path=browsers.find(), args=["--no-sandbox"])
        try:
            out: dict[str, object] = {"trajectories": count}
            for kind in ("cold", "warm"):
                context = browser.new_context(viewport={"width": 1280, "height": 720})
                page = Page(context, server.address)
                out[f"first_picture_ms_{kind}"] = page.tab.evaluate(PICTURE)
            page.press("End")
            page.draw([(x, y) for x, y in CORNERS])
            page.until("labeller.state.regions?.[1]")
            corner = [(140, 130), (200, 180), (120, 110), (180, 150)]
            out["dragging"] = _timed(page, lambda: page.drag(*corner, steps=80))
            out["panning"] = _timed(page, lambda: page.drag((600, 300), (700, 320), (500, 250), steps=80))
            out["cost"] = page.tab.evaluate(COST)
            return out
        finally:
            browser.close()
            server.stop(signal.SIGKILL)


def _timed(page: Page, work) -> dict[str, float]:
    page.tab.evaluate(COUNT)
    work()
    return page.tab.evaluate(STOP)


if __name__ == "__main__":
    print(json.dumps(measure(5000), indent=1))
