"""How close our trajectories are to the 2018 release, and to the truth of synthetic drives.

Usage: python tools/tracker_fidelity.py [--flow dis] [--clips CLIP ...] [--scenes 4]
       [--track NAME=VALUE ...] [-o OUT.md]

Prints Markdown tables. The first compares the default tracks with the released ones: every one of them is
started at its first point and followed without stops, and compared after 1, 5 and 10
frames; then the clip is tracked as usual and start cells, number and mean length are compared. The
next two compare the default and the reliable tracks of synthetic drives with the exact ones. The last lists
which of the aims set for the tracker are reached, and by which tracks. docs/tracking.md explains the columns.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

import tracker_release
import tracker_truth
from tqdm import tqdm
from tracker_aims import aims, table
from tracker_truth import Kinds

from kt3dmoseg import load
from kt3dmoseg.files import write_text
from kt3dmoseg.flow import Flow, create
from kt3dmoseg.options import parse_assignments
from kt3dmoseg.synthetic import SceneOptions, make_scene

RAYS = 3  # squared: per pixel; with more of them the pictures hardly change (docs/synthetic.md)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    root = os.environ.get("KT3DMOSEG_DATA", Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--data", type=Path, default=Path(root), help="folder that holds kt3dmoseg/")
    parser.add_argument("--flow", default="dis")
    parser.add_argument("-p", action="append", default=[], metavar="NAME=VALUE", help="parameter of the flow")
    parser.add_argument(
        "--track",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="an option of the tracker; the tables are then of these tracks only",
    )
    parser.add_argument(
        "--clips", nargs="*", help="default: every released clip; none: --clips without names"
    )
    parser.add_argument("--scenes", type=int, default=4, help="number of synthetic drives")
    parser.add_argument("--cache", metavar="FOLDER", help="keep the flow of real clips here (4 MB a field)")
    parser.add_argument("-o", "--output")
    arguments = parser.parse_args()
    flow = create(arguments.flow, **parse_assignments(arguments.p))
    given = parse_assignments(arguments.track)
    kinds: Kinds = {"given": given} if given else {"default": {}, "reliable": {"reliable": True}}
    data = arguments.data / "kt3dmoseg"
    parts = [f"`{flow}` {given or ''}\n"]
    release = released(data, arguments.clips, flow, arguments.cache, kinds, parts)
    truth = true(arguments.scenes, flow, kinds, parts)
    parts += ["## Aims\n", aims(release, truth)]
    text = "\n".join(parts)
    if arguments.output:
        write_text(arguments.output, text)
    sys.stdout.write(text)


def released(
    data: Path, clips: list[str] | None, flow: Flow, cache: str | None, kinds: Kinds, parts: list[str]
) -> dict[str, dict[str, float]]:
    """Compare the first kind of tracks with the release, clip by clip; add the table to `parts`."""
    known = sorted(p.name.removesuffix("_Tracks.mat") for p in (data / "release").glob("*_Tracks.mat"))
    kind, total, rows = next(iter(kinds)), tracker_release.Release(), []
    for name in tqdm(known if clips is None else clips, disable=None):
        clip = load(data / "release" / f"{name}_Tracks.mat")
        one = tracker_release.compare(clip, data / "frames" / name, flow, cache, kinds[kind])
        total.add(one)
        rows.append(tracker_release.row(name, one))
    if not rows:
        return {}
    rows.append(tracker_release.row("**all**", total))
    parts += [f"## Against the release: {kind} tracks\n", table(tracker_release.HEAD, rows)]
    return {kind: total.figures()}


def true(scenes: int, flow: Flow, kinds: Kinds, parts: list[str]) -> dict[str, dict[str, float]]:
    """Compare each kind of tracks with the truth, drive by drive; add the tables to `parts`."""
    totals = {kind: tracker_truth.Truth() for kind in kinds}
    rows: dict[str, list[list[str]]] = {kind: [] for kind in kinds}
    for seed in tqdm(range(scenes), disable=None):
        scene = make_scene(SceneOptions(seed=seed, samples=RAYS))
        for kind, one in tracker_truth.against_truth(scene, flow, kinds).items():
            totals[kind].add(one)
            rows[kind].append(tracker_truth.row(f"seed {seed}", one))
    if not scenes:
        return {kind: {} for kind in kinds}
    for kind, total in totals.items():
        rows[kind].append(tracker_truth.row("**all**", total))
        parts += [f"## Against the truth: {kind} tracks\n", table(tracker_truth.HEAD, rows[kind])]
    return {kind: total.figures() for kind, total in totals.items()}


if __name__ == "__main__":
    main()
