"""Which aims of the tracker are reached, and by which tracks; a part of tracker_fidelity.py."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

# What it is called, name of the figure, least and most.
RELEASE_AIMS = (
    ("release, 1 frame: median <= 0.07 px", "1: median", 0, 0.07),
    ("release, 5 frames: median <= 0.27 px", "5: median", 0, 0.27),
    ("release, 10 frames: median <= 0.39 px", "10: median", 0, 0.39),
    ("release, 1 frame: within 1 px >= 0.96", "1: < 1 px", 0.96, 1),
    ("release, 5 frames: within 1 px >= 0.81", "5: < 1 px", 0.81, 1),
    ("release, 10 frames: within 1 px >= 0.77", "10: < 1 px", 0.77, 1),
    ("moving objects, 5 frames: within 1 px >= 0.72", "moving", 0.72, 1),
    ("the same, where LDOF has 0.81 on three other clips", "moving", 0.81, 1),
    ("first cells: recall >= 0.96", "first recall", 0.96, 1),
    ("first cells: precision >= 0.91", "first precision", 0.91, 1),
    ("later cells: recall >= 0.55", "later recall", 0.55, 1),
    ("number of trajectories within 6 %", "number", 0.94, 1.06),
    ("mean length within 3 %", "mean length", 0.97, 1.03),
)
TRUTH_AIMS = (
    ("truth, 10 frames: median <= 0.15 px", "median", 0, 0.15),
    ("truth, 10 frames: 95 % <= 1 px", "95 %", 0, 1),
    ("share slid to another object <= 0.005", "slid", 0, 0.005),
)


def table(head: list[str], rows: Iterable[list[str]]) -> str:
    """Give a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def aims(release: Mapping[str, Mapping[str, float]], truth: Mapping[str, Mapping[str, float]]) -> str:
    """Give the table of aims for kinds of tracks, with the figures of each kind that were measured.

    The release is compared with one kind of tracks, the truth with each.
    """
    kinds = list(truth)
    rows = []
    for measured, wanted in ((release, RELEASE_AIMS), (truth, TRUTH_AIMS)):
        for name, figure, least, most in wanted:
            found = {kind: measured.get(kind, {}).get(figure, np.nan) for kind in kinds}
            reached = [kind for kind, value in found.items() if least <= value <= most]
            cells = [f"{value:.4g}" if np.isfinite(value) else "-" for value in found.values()]
            known = np.isfinite(list(found.values())).any()
            rows.append([name, *cells, f"yes: {', '.join(reached)}" if reached else "no" if known else "-"])
    return table(["aim", *kinds, "reached"], rows)
