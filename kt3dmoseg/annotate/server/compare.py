"""Two annotators' labellings side by side, for the page."""

from __future__ import annotations

from typing import Any

import numpy as np

from kt3dmoseg.annotate.agreement import agree
from kt3dmoseg.annotate.labelling import LabelledTracks
from kt3dmoseg.types import Trajectories

_SHOWN = 2_000


def comparison(trajectories: Trajectories, mine: LabelledTracks, theirs: LabelledTracks) -> dict[str, Any]:
    """Return agreement, kappa and the differing trajectories, alike ones together, with where to look."""
    result = agree(mine.labels.label, theirs.labels.label)
    differences = []
    rows = [int(row) for _, _, group in result.groups() for row in group]
    for row in rows[:_SHOWN]:
        seen = np.flatnonzero(trajectories.visible[row])
        if len(seen):
            frame = int(seen[len(seen) // 2])
            differences.append(
                {
                    "row": row,
                    "frame": frame,
                    "xy": np.round(trajectories.xy[row, frame], 1).tolist(),
                    "mine": _name(mine, row),
                    "theirs": _name(theirs, row),
                }
            )
    return {
        "trajectories": len(trajectories),
        "agreement": result.agreement,
        "both": result.both,
        "kappa": result.kappa,
        "different": len(result.differences),
        "differences": differences,
    }


def _name(labelled: LabelledTracks, row: int) -> str:
    label = int(labelled.labels.label[row])
    return labelled.labels.names.get(label, f"motion {label - 1}") if label else "unlabelled"
