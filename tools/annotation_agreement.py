"""Compare our annotations with the released labels, over the released evaluated trajectories.

    tools/annotation_agreement.py --release ../shared/data/kt3dmoseg/release

labels every released trajectory with annotations/<clip>.json, matches our motions with the released
ones, and prints Markdown: one line per clip, then per clip its motions and where the two differ. With
--other DIR, a second set of annotations replaces the released labels.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kt3dmoseg import io
from kt3dmoseg.annotate import LabelledTracks, label_tracks_detailed, load_annotation
from kt3dmoseg.annotate.agreement import Agreement, agree
from kt3dmoseg.annotate.labelling import REASONS
from kt3dmoseg.errors import InputFileError, KT3DMoSegError
from kt3dmoseg.files import write_text
from kt3dmoseg.types import Clip

GOAL = 0.98
FLOOR = 0.95


@dataclass(frozen=True, eq=False)
class Comparison:
    """One clip: the released clip, our labelling of all its trajectories, and the comparison."""

    clip: Clip
    ours: LabelledTracks
    theirs: Mapping[int, str]
    result: Agreement


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--annotations", type=Path, default=Path("annotations"))
    parser.add_argument("--release", type=Path, required=True, help="folder of labelled clips")
    parser.add_argument("--other", type=Path, help="compare with these annotations instead")
    parser.add_argument("--clip", action="append", help="only this clip; may be repeated")
    parser.add_argument("--examples", type=int, default=8, help="differing trajectories shown per group")
    parser.add_argument("--json", action="store_true", help="the table as JSON")
    parser.add_argument("-o", "--output", type=Path, help="write to this file instead of the terminal")
    arguments = parser.parse_args(argv)
    try:
        found = _compare_all(arguments)
    except KT3DMoSegError as error:
        print(f"annotation_agreement: {error}", file=sys.stderr)
        return error.exit_code
    text = _json(found) if arguments.json else _markdown(found, arguments.examples)
    if arguments.output:
        write_text(arguments.output, text)
    else:
        print(text, end="")
    return 0


def _compare_all(arguments: argparse.Namespace) -> list[Comparison]:
    paths = io.dataset_paths(arguments.release)
    names = [name for name in paths if not arguments.clip or name in arguments.clip]
    there = [name for name in names if (arguments.annotations / f"{name}.json").exists()]
    for name in sorted(set(names) - set(there)):
        print(f"annotation_agreement: {name} is not annotated", file=sys.stderr)
    if not there:
        raise InputFileError(f"{arguments.annotations}", expected="<clip>.json", found="none of the clips")
    return [_compare(io.load(paths[name]), name, arguments) for name in there]


def _compare(clip: Clip, name: str, arguments: argparse.Namespace) -> Comparison:
    ours = label_tracks_detailed(clip.dense, load_annotation(arguments.annotations / f"{name}.json"))
    labels, names = clip.labels.label, {int(m): f"label {m}" for m in clip.labels.motions}
    if arguments.other:
        other = label_tracks_detailed(clip.dense, load_annotation(arguments.other / f"{name}.json")).labels
        labels, names = other.label[clip.evaluated], dict(other.names)
    return Comparison(clip, ours, names, agree(ours.labels.label[clip.evaluated], labels))


def _markdown(found: list[Comparison], examples: int) -> str:
    lines = [
        "| clip | evaluated | agreement | where both label | kappa | unlabelled | motions (ours / theirs) |",
        "|---|--:|--:|--:|--:|--:|--:|",
        *(_row(c) for c in found),
    ]
    shares = [c.result.agreement for c in found]
    low = [f"{c.clip.name} ({c.result.agreement:.1%})" for c in found if c.result.agreement < FLOOR]
    lines += [
        "",
        f"{len(found)} clips, mean agreement {np.mean(shares):.2%} (goal {GOAL:.0%}), "
        f"where both label {np.mean([c.result.both for c in found]):.2%}; "
        f"under {FLOOR:.0%}: {', '.join(low) or 'none'}.",
    ]
    for comparison in found:
        lines += ["", *_section(comparison, examples)]
    return "\n".join(lines) + "\n"


def _row(c: Comparison) -> str:
    ours = c.ours.labels.label[c.clip.evaluated]
    unlabelled = int(np.sum(ours == 0))
    motions = f"{len(np.unique(ours[ours > 0]))} / {len(np.unique(c.result.b[c.result.b > 0]))}"
    return (
        f"| {c.clip.name} | {len(ours)} | {c.result.agreement:.2%} | {c.result.both:.2%} "
        f"| {c.result.kappa:.3f} | {unlabelled} | {motions} |"
    )


def _section(c: Comparison, examples: int) -> list[str]:
    """Print, for one clip, the agreement on each motion and where the two sides differ."""
    back = {theirs: mine for mine, theirs in c.result.matching.items()}
    lines = [f"## {c.clip.name}", "", "| theirs | ours | trajectories | we agree |", "|---|---|--:|--:|"]
    for label, name in c.theirs.items():
        rows = c.result.b == label
        if rows.any():
            mine = _our_name(c, back.get(label))
            lines.append(f"| {name} | {mine} | {rows.sum()} | {np.mean(c.result.a[rows] == label):.1%} |")
    for a, b, rows in c.result.groups():
        mine = _our_name(c, back.get(a, _original(c, rows[0])))
        theirs = c.theirs.get(b, "unlabelled")
        lines += ["", f"**{len(rows)}** ours: {mine}, theirs: {theirs}", ""]
        lines += [f"* {_where(c, int(row))}" for row in rows[:examples]]
        if len(rows) > examples:
            lines.append(f"* and {len(rows) - examples} more")
    return lines


def _our_name(c: Comparison, label: int | None) -> str:
    if not label:
        return "unlabelled" if label == 0 else "nothing"
    return c.ours.labels.names.get(label, f"label {label}")


def _original(c: Comparison, row: int) -> int:
    return int(c.ours.labels.label[c.clip.evaluated[row]])


def _where(c: Comparison, row: int) -> str:
    """Name a trajectory, where it is in the middle of its life, and how our votes fell."""
    dense_row = c.clip.evaluated[row]
    seen = np.flatnonzero(c.clip.dense.visible[dense_row])
    if not len(seen):
        return f"row {row} (track {c.clip.dense.track_id[dense_row]}): never visible"
    frame = int(seen[len(seen) // 2])
    x, y = c.clip.dense.xy[dense_row, frame]
    votes = c.ours.votes[dense_row]
    votes_of = ", ".join(
        f"{_candidate(name)} {votes[k]:.1f}" for k, name in enumerate(c.ours.candidates) if votes[k] > 0
    )
    reason = REASONS[c.ours.reason[dense_row]]
    return (
        f"row {row} (track {c.clip.dense.track_id[dense_row]}): frame {frame} at ({x:.0f}, {y:.0f}), "
        f"seen {seen[0]}..{seen[-1]}, votes {votes_of or 'none'} ({reason})"
    )


def _candidate(motion: int | str) -> str:
    return "background" if motion == 0 else f"motion {motion}"


def _json(found: list[Comparison]) -> str:
    rows = [
        {
            "clip": c.clip.name,
            "evaluated": len(c.clip.evaluated),
            "agreement": c.result.agreement,
            "both": c.result.both,
            "kappa": c.result.kappa,
            "differences": c.result.differences.tolist(),
        }
        for c in found
    ]
    return json.dumps(rows, indent=1) + "\n"


if __name__ == "__main__":
    raise SystemExit(main())
