"""Scores as JSON and back, so that they can be kept, compared and ranked without the data."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.files import read_bytes
from mseg.evaluation.contingency import Contingency
from mseg.evaluation.metrics.motions import (
    f_per_motion,
    iou_per_motion,
    precision_per_motion,
    recall_per_motion,
)
from mseg.evaluation.protocol import Protocol, list_protocols, load_protocol
from mseg.evaluation.results import ClipScore, Provenance, ScoreTable
from mseg.evaluation.submission import SubmissionMeta

FORMAT = "mseg-scores"
VERSION = 1
_LIMIT = 64 << 20


def to_json(scores: ScoreTable) -> dict[str, Any]:
    """Give all scores as JSON values; fractions stay fractions."""
    groups = {}
    for group, names in scores.groups():
        summaries = {metric: scores.summary(metric, names) for metric in scores.metrics} if names else {}
        groups[group.name] = {
            "title": group.title,
            "clips": len(names),
            "clips_in_full": group.n_clips,
            "metrics": {m: _summary(s) for m, s in summaries.items()},
        }
    return {
        "format": FORMAT,
        "version": VERSION,
        "benchmark": scores.benchmark.name,
        "coverage": scores.benchmark.coverage(scores.names),
        "complete": scores.complete,
        "meta": asdict(scores.meta),
        "provenance": asdict(scores.provenance),
        "seeds": scores.seeds,
        "groups": groups,
        "clips": [_clip(score) for score in scores.clips],
        "problems": [problem.as_dict() for problem in scores.problems],
    }


def from_json(content: str, where: str = "scores") -> ScoreTable:
    """Read what `to_json` wrote; contingency tables are not kept.

    Raises
    ------
    FileFormatError
        When it is something else.
    """
    try:
        raw = json.loads(content)
        if raw["format"] != FORMAT or raw["version"] != VERSION:
            raise ValueError("another format or version")
        meta = {**raw["meta"], "authors": tuple(raw["meta"]["authors"])}
        clips = tuple(ClipScore(**_checked(clip)) for clip in raw["clips"])
        _check_grid(clips)
        name = raw["benchmark"]
        protocol: Protocol | None = load_protocol(name) if name in list_protocols() else None
        return ScoreTable(clips, SubmissionMeta(**meta), protocol, Provenance(**raw["provenance"]))
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise FileFormatError(
            where,
            expected="scores as 'mseg score --json' writes them",
            found=str(error)[:120] or type(error).__name__,
        ) from None


def load_scores(path: str | os.PathLike[str]) -> ScoreTable:
    """Read a file written by ``mseg score --json``."""
    return from_json(read_bytes(path, _LIMIT).decode("utf-8", "replace"), os.fspath(path))


def _clip(score: ClipScore) -> dict[str, Any]:
    return {
        "clip": score.clip,
        "seed": score.seed,
        "n_motions": score.n_motions,
        "n": score.n,
        "n_found": score.n_found,
        "prevalence": score.prevalence,
        "reason": score.reason,
        "values": dict(score.values),
        "motions": _motions(score.table) if score.table is not None else [],
    }


def _motions(table: Contingency) -> list[dict[str, Any]]:
    """Give every motion with its group, its confusion and its own scores; for readers, not read back."""
    columns = {
        "precision": precision_per_motion(table),
        "recall": recall_per_motion(table),
        "f_measure": f_per_motion(table),
        "iou": iou_per_motion(table),
    }
    return [
        {
            "motion": int(motion),
            "n": int(table.sizes[i]),
            "group": int(table.groups[table.assignment[i]]) if table.assignment[i] >= 0 else None,
            "background": table.background == i,
            "outliers": int(table.unassigned[i]),
            "confusion": {str(g): int(c) for g, c in zip(table.groups, table.counts[i], strict=True)},
            **{name: float(values[i]) for name, values in columns.items()},
        }
        for i, motion in enumerate(table.motions)
    ]


def _summary(summary: Any) -> dict[str, Any]:  # noqa: ANN401  # Summary; asdict of a NamedTuple field
    out = asdict(summary)
    out["interval"] = list(summary.interval)
    return out


def _checked(clip: Mapping[str, Any]) -> dict[str, Any]:
    numbers = [clip["seed"], clip["n"], clip["n_motions"], clip["n_found"], clip["prevalence"]]
    if not all(math.isfinite(v) for v in (*numbers, *clip["values"].values())) or not clip["values"]:
        raise ValueError("a value that is no number")
    return {key: value for key, value in clip.items() if key != "motions"}


def _check_grid(clips: tuple[ClipScore, ...]) -> None:
    keys = {(c.clip, c.seed) for c in clips}
    full = len({c.clip for c in clips}) * len({c.seed for c in clips})
    if not clips or len(keys) != len(clips) or len(clips) != full:
        raise ValueError("not every clip for every seed, once")
    if len({tuple(c.values) for c in clips}) != 1:
        raise ValueError("clips with different metrics")
