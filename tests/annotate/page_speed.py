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

# The work of threads, by the browser's own trace: CPU time, which waiting for other programs does not change.
TRACED = ["disabled-by-default-devtools.timeline", "devtools.timeline", "toplevel", "viz"]
THREADS = {
    "CrRendererMain": "script_and_layout_ms",
    "CrGpuMain": "painting_ms",
    "VizCompositorThread": "painting_ms",
}


def cpu_per_frame(trace: bytes) -> dict[str, float]:
    """CPU time of the page's main thread and of painting, by the frames that were shown."""
    events = json.loads(trace)["traceEvents"]
    names = {(e["pid"], e["tid"]): e["args"]["name"] for e in events if e.get("name") == "thread_name"}
    frames = sum(e["name"] == "Display::DrawAndSwap" for e in events)
    spent = dict.fromkeys(THREADS.values(), 0.0)
    for event in events:
        kind = THREADS.get(names.get((event["pid"], event.get("tid")), ""))
        if kind and event["name"] == "ThreadControllerImpl::RunTask":
            spent[kind] += event.get("tdur", 0) / 1000
    return {"shown": frames, **{kind: round(time / max(1, frames), 2) for kind, time in spent.items()}}


def measure(count: int) -> dict[str, object]:
    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        folder = Path(name)
        write_clip(folder, "one", size=(1242, 375), frames=20, tracks=count)
        server = Server(folder, folder / "notes")
        browser = playwright.chromium.launch(executable_path=browsers.find(), args=["--no-sandbox"])
        try:
            out: dict[str, object] = {"trajectories": count}
            for kind in ("cold", "warm"):
                context = browser.new_context(viewport={"width": 1440, "height": 900})
                page = Page(context, server.address)
                out[f"first_picture_ms_{kind}"] = page.tab.evaluate(PICTURE)
            page.press("End")
            page.draw([(x, y) for x, y in CORNERS])
            page.until("labeller.state.regions?.[1]")
            corner = [(140, 130), (200, 180), (120, 110), (180, 150)]
            works = {
                "dragging": lambda: page.drag(*corner, steps=80),
                "panning": lambda: page.drag((600, 300), (700, 320), (500, 250), steps=80),
                "zooming": lambda: _zoom(page),
            }
            for name, work in works.items():
                page.tab.evaluate(COUNT)
                browser.start_tracing(page=page.tab, categories=TRACED)
                work()
                out[name] = cpu_per_frame(browser.stop_tracing()) | page.tab.evaluate(STOP)
            return out
        finally:
            browser.close()
            server.stop(signal.SIGKILL)


def _zoom(page: Page) -> None:
    page.tab.mouse.move(*page.at((600, 250)))
    page.tab.keyboard.down("Control")
    for k in range(80):
        page.tab.mouse.wheel(0, -4 if k % 40 < 20 else 4)
    page.tab.keyboard.up("Control")


if __name__ == "__main__":
    print(json.dumps(measure(5000), indent=1))
