"""How close our trajectories are to the 2018 release, and to the truth of synthetic drives.

Usage: python tools/tracker_fidelity.py [--flow dis] [--clips CLIP ...] [--scenes 4]
       [--track NAME=VALUE ...] [-o OUT.md]
       python tools/tracker_fidelity.py --scenes 4 --write-frames FRAMES
       python tools/tracker_fidelity.py --tracks NAME=FOLDER [NAME=FOLDER ...] [--clips CLIP ...] [--scenes 4]

Prints Markdown tables. The first compares the default tracks with the released ones: every one of them is
started at its first point and followed without stops, and compared after 1, 5 and 10
frames; then the clip is tracked as usual and start cells, number and mean length are compared. The
next two compare the default and the reliable tracks of synthetic drives with the exact ones. The last lists
which of the aims set for the tracker are reached, and by which tracks. docs/tracking.md explains the columns.

With --tracks the same tables are of the tracks of any trackers: CLIP.npz (or another format) for the release
and scene_0.npz, scene_1.npz, ... for the drives, whose frames --write-frames writes; clips without are left
out. Tracks of others start elsewhere: of the released ones those are compared that have one of theirs within
2 px of their start, from there on; the last column is their share.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import cv2
import numpy as np
import tracker_release
import tracker_truth
from tqdm import tqdm
from tracker_aims import aims, table
from tracker_truth import Kinds

from kt3dmoseg import load
from kt3dmoseg.files import write_text
from kt3dmoseg.flow import Flow, create
from kt3dmoseg.frames import FrameFolder
from kt3dmoseg.options import parse_assignments
from kt3dmoseg.pipeline.inputs import find_tracks, read_tracks
from kt3dmoseg.synthetic import SceneOptions, make_scene
from kt3dmoseg.types import Clip, Trajectories

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
    parser.add_argument(
        "--tracks", nargs="+", default=[], metavar="NAME=FOLDER", help="tracks of these trackers"
    )
    parser.add_argument(
        "--write-frames", type=Path, metavar="FOLDER", help="write the drives' frames; no table"
    )
    parser.add_argument("-o", "--output")
    arguments = parser.parse_args()
    if arguments.write_frames:
        write_frames(arguments.write_frames, arguments.scenes)
        return
    flow = create(arguments.flow, **parse_assignments(arguments.p))
    given = parse_assignments(arguments.track)
    kinds: Kinds = {"given": given} if given else {"default": {}, "reliable": {"reliable": True}}
    data = arguments.data / "kt3dmoseg"
    parts = [f"`{flow}` {given or ''}\n"]
    if arguments.tracks:
        theirs = {name: Path(folder) for name, folder in parse_assignments(arguments.tracks).items()}
        parts, release, truth = [], {}, {}
        for name, folder in theirs.items():
            release |= foreign(data, arguments.clips, folder, name, parts)
            truth[name] = foreign_truth(arguments.scenes, folder, name, parts)
    else:
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
    kind = next(iter(kinds))
    return _pooled(
        kind,
        parts,
        (
            (clip.name, tracker_release.compare(clip, data / "frames" / clip.name, flow, cache, kinds[kind]))
            for clip in released_clips(data, clips)
        ),
    )


def released_clips(data: Path, clips: list[str] | None) -> Iterator[Clip]:
    known = sorted(p.name.removesuffix("_Tracks.mat") for p in (data / "release").glob("*_Tracks.mat"))
    for name in tqdm(known if clips is None else clips, disable=None):
        yield load(data / "release" / f"{name}_Tracks.mat")


def _pooled(
    kind: str, parts: list[str], compared: Iterable[tuple[str, tracker_release.Release]]
) -> dict[str, dict[str, float]]:
    total, rows = tracker_release.Release(), []
    for name, one in compared:
        total.add(one)
        rows.append(tracker_release.row(name, one))
    if not rows:
        return {}
    rows.append(tracker_release.row("**all**", total))
    parts += [f"## Against the release: {kind} tracks\n", table(tracker_release.HEAD, rows)]
    return {kind: total.figures()}


def foreign(
    data: Path, clips: list[str] | None, folder: Path, name: str, parts: list[str]
) -> dict[str, dict[str, float]]:
    """Compare a tracker's files with the release, clip by clip; add the table to `parts`."""
    compared = []
    for clip in released_clips(data, clips):
        tracks = tracks_of(folder, clip.name, FrameFolder(data / "frames" / clip.name).frames("luma"))
        if tracks is not None:
            compared.append((clip.name, tracker_release.compare_tracks(clip, tracks)))
    return _pooled(name, parts, compared)


def foreign_truth(scenes: int, folder: Path, name: str, parts: list[str]) -> dict[str, float]:
    """Compare a tracker's files with the truth, drive by drive; add the table to `parts`."""
    total, rows = tracker_truth.Truth(), []
    for seed in tqdm(range(scenes), disable=None):
        scene = make_scene(SceneOptions(seed=seed, samples=RAYS))
        tracks = tracks_of(folder, f"scene_{seed}", scene.frames())
        if tracks is not None:
            one = tracker_truth.compare(scene, tracks)
            total.add(one)
            rows.append(tracker_truth.row(f"seed {seed}", one))
    if not rows:
        return {}
    rows.append(tracker_truth.row("**all**", total))
    parts += [f"## Against the truth: {name} tracks\n", table(tracker_truth.HEAD, rows)]
    return total.figures()


def tracks_of(folder: Path, name: str, frames: Iterable[np.ndarray]) -> Trajectories | None:
    """Read a clip's tracks through the gate of `kt3dmoseg build --tracks`; None where there are none."""
    [path] = find_tracks([name], folder) if any(folder.glob(f"{name}*")) else [None]
    if path is None:
        return None
    pictures = list(frames)
    return read_tracks(path, iter(pictures), range(len(pictures)), tracker_release.MIN_LENGTH)[0]


def write_frames(folder: Path, scenes: int) -> None:
    for seed in tqdm(range(scenes), disable=None):
        target = folder / f"scene_{seed}"
        target.mkdir(parents=True, exist_ok=True)
        for number, frame in enumerate(make_scene(SceneOptions(seed=seed, samples=RAYS)).frames()):
            cv2.imwrite(str(target / f"{number:06d}.png"), frame)


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
