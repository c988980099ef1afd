"""Label clips through the labelling page, as a person would who knows the truth, and count what it takes.

For each mover of `annotations/` (no shadows), in its key frame nearest to the middle: a box (two clicks; its
sides are off by up to 3 px), then clicks in the middle of the largest error, until the overlap is 0.9 or five
are used. Frames without it are set outside. Then at most two corrections in frames in which the region
overlaps by less than 0.9: of those between the same two drawn frames, where they are most, the middle one. A
correction is at most two clicks: in the middle of the largest error, or where the region overlaps by less
than 0.7 a box. Things that are drawn to be rejected or in front are left out.

python tools/measure_labelling.py DATA/kt3dmoseg/frames DATA/kt3dmoseg/release [CLIP ...]

With a proposer's name for the frames, its proposals on empty annotations are counted instead: shown, true
(half of the trajectories inside are of one mover), movers of 16 trajectories and more,
those among the true. The folder `frames` lies beside the release.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

import browser
import cv2
import numpy as np
from playwright.sync_api import BrowserContext, sync_playwright

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "annotate"))

from labeller_page import Page, Server  # noqa: E402

import kt3dmoseg  # noqa: E402
from kt3dmoseg.annotate import AnnotatedObject, Annotation, load_annotation  # noqa: E402
from kt3dmoseg.annotate.formats.masks import mask_of  # noqa: E402
from kt3dmoseg.annotate.geometry import arrays, bounds  # noqa: E402
from kt3dmoseg.annotate.labelling import label_tracks_detailed  # noqa: E402
from kt3dmoseg.annotate.propagation import Region, TrackMotion, propagate  # noqa: E402
from kt3dmoseg.annotate.proposals import PROPOSERS, Request, propose  # noqa: E402
from kt3dmoseg.io.images import frame_paths  # noqa: E402
from kt3dmoseg.types import BoolArray, Trajectories  # noqa: E402

Regions = dict[int, list[Region]]

CLICKS, CORRECTIONS, CORRECTING, ENOUGH, ROUGHLY, OFF = 5, 2, 2, 0.9, 0.7, 3.0
DONE = "labeller.state.done.length"
SUMMARY = """{} movers, medians: clicks {:g}, corrections {:g}, with theirs {:g} clicks; overlap in the
outlined frame {:.3f}, in all frames drawn by hand {:.3f}, in all {:.3f}; agreement of clips {:.4f}"""


def overlap(a: BoolArray, b: BoolArray) -> float:
    """Return the intersection over the union of two masks."""
    return float((a & b).sum() / max(1, (a | b).sum()))


def worst_place(found: BoolArray, truth: BoolArray) -> tuple[tuple[int, int], bool] | None:
    """Return the middle of the largest wrong part, and whether it is missing."""
    best: tuple[int, Any] = (0, None)
    for wrong, adds in ((truth & ~found, True), (found & ~truth, False)):
        _, parts, stats, _ = cv2.connectedComponentsWithStats(wrong.astype(np.uint8))
        if len(stats) > 1 and stats[1:, 4].max() > best[0]:
            part = np.pad(parts == 1 + stats[1:, 4].argmax(), 1).astype(np.uint8)
            depth = cv2.distanceTransform(part, cv2.DIST_L2, 5)[1:-1, 1:-1]
            y, x = np.unravel_index(depth.argmax(), depth.shape)
            best = (stats[1:, 4].max(), ((int(x), int(y)), adds))
    return best[1]


class Labeller:
    """Somebody who knows the regions of a clip, at its page."""

    def __init__(self, context: BrowserContext, address: str, truth: Annotation, regions: Regions) -> None:
        self.page, self.size = Page(context, f"{address}?clip={truth.clip}"), truth.image_size
        self.rng = np.random.default_rng(0)
        self.regions, self.frames = regions, truth.n_frames

    def mask(self, polygons: Sequence[Any]) -> BoolArray:
        """Return the pixels of a region."""
        return mask_of(arrays(polygons), self.size)

    def go_to(self, frame: int) -> None:
        """Go to a frame by keys."""
        self.page.press("Home", *["ArrowRight"] * frame)
        self.page.until(f"labeller.state.frame === {frame}")

    def edit(self, action: Callable[[], object]) -> None:
        """Do something, and wait until it has changed the document."""
        before = self.page.value(DONE)
        action()
        self.page.until(f"{DONE} > {before} && !labeller.state.making", 60)

    def asked(self, what: str) -> dict[str, Any]:
        """Return what the server answers the page about the present document: regions or labels."""
        answer: dict[str, Any] = self.page.value(
            f"fetch('/api/clips/' + labeller.state.clip.name + '/{what}', {{ method: 'POST', headers: "
            "{ 'content-type': 'application/json' }, body: JSON.stringify(labeller.state.doc) })"
            ".then(answer => answer.json())"
        )
        return answer

    def box(self, polygons: Sequence[Any]) -> None:
        """Drag a box around a region."""
        left, top, right, bottom = np.array(bounds(polygons)) + self.rng.uniform(-OFF, OFF, 4)
        last = np.array(self.size) - 1
        low, high = np.clip([left, top], 0, last), np.clip([right, bottom], 0, last)
        self.edit(lambda: self.page.drag(low, high))

    def outline(
        self, frame: int, polygons: Sequence[Any], clicks: int, carried: Sequence[Any] = ()
    ) -> tuple[int, float]:
        """Outline by a box and clicks, or correct what is carried; return the clicks used and the overlap."""
        exact, found, used = self.mask(polygons), carried, 0
        while True:
            iou = overlap(self.mask(found), exact)
            place = worst_place(self.mask(found), exact)
            if used and (iou >= ENOUGH or used >= clicks or not place):
                return used, iou
            if not used and (iou < ROUGHLY or not place):
                self.box(polygons)
                used = 2
            else:
                (point, adds), used = place, used + 1
                keyboard = self.page.tab.keyboard
                None if adds else keyboard.down("Alt")
                self.edit(lambda at=point: self.page.click(at))
                None if adds else keyboard.up("Alt")
            item = "labeller.state.doc.objects.find(o => o.id === labeller.state.selected)"
            found = self.page.value(f"{item}.key_frames.find(k => k.frame === {frame}).polygons")

    def label(self, item: AnnotatedObject) -> tuple[int, int, int, float, float, float]:
        """Label an object: clicks, corrections, clicks with theirs, and overlaps: first, by hand, all."""
        truth = self.regions[item.id]
        seen = [k for k, region in enumerate(truth) if region.visibility == "visible" and region.polygons]
        frame = min((k for k in seen if truth[k].key), key=lambda k: abs(k - seen[len(seen) // 2]))
        self.go_to(frame)
        self.page.press("Shift+O")
        clicks, first = self.outline(frame, truth[frame].polygons, CLICKS)
        in_all = clicks
        if self.page.value("labeller.state.doc.objects.at(-1).motion") != item.motion:
            self.edit(lambda: self.page.press(str(item.motion)))
        if seen[0] > 0:
            self.go_to(seen[0])
            self.edit(lambda: self.page.press("Shift+E"))
        if seen[-1] + 1 < self.frames:
            self.go_to(seen[-1] + 1)
            self.edit(lambda: self.page.press("e"))
        drawn = {frame}
        for corrections in range(CORRECTIONS + 1):
            regions = self.asked("regions")["regions"][str(self.page.value("labeller.state.selected"))]
            exact = {k: self.mask(truth[k].polygons) for k in seen}
            ious = {k: overlap(self.mask(regions[k]["polygons"]), exact[k]) for k in seen}
            loose = [k for k in seen if k not in drawn and ious[k] < ENOUGH]
            if not loose or corrections == CORRECTIONS:
                break
            stretches = (list(frames) for _, frames in groupby(loose, lambda k: sum(d < k for d in drawn)))
            longest = max(stretches, key=len)
            drawn.add(middle := longest[len(longest) // 2])
            self.go_to(middle)
            carried = regions[middle]["polygons"]
            in_all += self.outline(middle, truth[middle].polygons, CORRECTING, carried)[0]
        by_hand = float(np.median([ious[k] for k in seen if truth[k].key]))
        return clicks, corrections, in_all, first, by_hand, float(np.median(list(ious.values())))


def proposals(proposer: str, name: str, path: Path) -> tuple[int, int, int, int]:
    """Count a clip's proposals: shown, true, movers, those found; see the module."""
    dense, truth = kt3dmoseg.load(path).dense, load_annotation(ROOT / "annotations" / f"{name}.json")
    tracks = Trajectories(dense.xy, dense.visible, dense.track_id, truth.image_size)
    empty, exact = truth.emptied(), label_tracks_detailed(tracks, truth).labels.label
    frames = tuple(frame_paths(path.parents[1] / "frames" / name))
    items, right = propose(proposer, Request(name, empty, tracks, frames)), []
    for item in items:
        alone = replace(empty, objects=(replace(item, motion=1),))
        inside = exact[label_tracks_detailed(tracks, alone).labels.label == 2]
        sizes = np.bincount(inside, minlength=3)[2:]
        right += [2 + int(sizes.argmax())] if 2 * sizes.max() >= len(inside) > 0 else []
    movers = 2 + np.flatnonzero(np.bincount(exact, minlength=3)[2:] >= 16)
    counts = len(items), len(right), len(movers), len(np.intersect1d(movers, right))
    print(name, *counts, flush=True)
    return counts


def main() -> None:
    frames, release, *wanted = sys.argv[1:]
    clips = {path.stem.removesuffix("_Tracks"): path for path in sorted(Path(release).glob("*_Tracks.mat"))}
    rows: list[Any] = []
    agreements: list[float] = []
    if frames in PROPOSERS.names():
        counts = np.sum([proposals(frames, name, clips[name]) for name in wanted or clips], axis=0)
        print("shown {}, true {}; movers {}, found {}".format(*counts))
        return
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        (Path(folder) / "frames").symlink_to(Path(frames).resolve())
        (Path(folder) / "tracks").symlink_to(Path(release).resolve())
        server = Server(Path(folder), Path(folder) / "notes")
        chromium = playwright.chromium.launch(executable_path=browser.find(), args=["--no-sandbox"])
        context = chromium.new_context(viewport={"width": 1440, "height": 900})
        try:
            for name in wanted or clips:
                done, agreement = one_clip(context, server.address, name, clips[name])
                rows, agreements = rows + done, [*agreements, agreement]
        finally:
            server.stop()
    print(SUMMARY.format(len(rows), *np.median(rows, axis=0), np.median(agreements)))


def one_clip(context: BrowserContext, address: str, name: str, path: Path) -> tuple[list[Any], float]:
    """Label the movers of a clip; return what each took, and the agreement of the labels."""
    clip, truth = kt3dmoseg.load(path), load_annotation(ROOT / "annotations" / f"{name}.json")
    dense = clip.dense
    tracks = Trajectories(dense.xy, dense.visible, dense.track_id, truth.image_size)
    regions = propagate(truth, TrackMotion(tracks))
    exact = label_tracks_detailed(tracks, truth, regions=regions).labels.label
    at_work = Labeller(context, address.split("?")[0], truth, regions)
    rows = []
    for item in truth.objects:
        if item.motion not in ("reject", 0) and not item.name.startswith("shadow"):
            rows.append(at_work.label(item))
            print(name, item.name, *np.round(rows[-1], 3), flush=True)
    at_work.page.saved()
    found = np.array(at_work.asked("labels")["label"])
    counted = np.isin(np.arange(len(found)), clip.evaluated) & (exact > 0)
    agreement = float((found == exact)[counted].mean())
    print(name, f"{agreement:.4f} of {counted.sum()}", flush=True)
    at_work.page.tab.close()
    return rows, agreement


if __name__ == "__main__":
    main()
