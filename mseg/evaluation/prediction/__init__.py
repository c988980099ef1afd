"""The content of one prediction file: two vectors, `track` and `label`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from kt3dmoseg.types import IntArray
from mseg.evaluation.prediction.arrays import Columns, parse_h5, parse_npz
from mseg.evaluation.prediction.csv import parse_csv
from mseg.evaluation.problems import Problem

_PARSERS: dict[str, Callable[[bytes], Columns]] = {".csv": parse_csv, ".npz": parse_npz, ".h5": parse_h5}
SUFFIXES = tuple(_PARSERS)


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a prediction file holds.

    Parameters
    ----------
    track, label : (n,) int64
        Ids of trajectories and their labels, in the order of the file; empty when unreadable.
    problems : list of Problem
        Everything that is wrong with the file by itself.
    """

    track: IntArray
    label: IntArray
    problems: list[Problem] = field(default_factory=list)


def parse_prediction(content: bytes, file: str, clip: str) -> Prediction:
    """Read a prediction file, telling everything that is wrong with it.

    Parameters
    ----------
    content : bytes
        The file.
    file : str
        Its name in the submission; the ending chooses the format.
    clip : str
        The clip it is for.
    """
    suffix = file[file.rfind(".") :]
    columns = _PARSERS[suffix](content)
    problems = [Problem(code, file, clip, *rest) for code, *rest in columns.problems]
    none = np.empty(0, dtype=np.int64)
    if columns.track is None or columns.label is None:
        return Prediction(none, none, problems)
    if not len(columns.track):
        problems.append(
            Problem("empty-file", file, clip, "one label per trajectory", "empty vectors", "write them")
        )
    for name, values in (("track", columns.track), ("label", columns.label)):
        problems += [Problem(code, file, clip, *rest) for code, *rest in _value_problems(name, values)]
    if problems:
        return Prediction(none, none, problems)
    return Prediction(columns.track.astype(np.int64), columns.label.astype(np.int64), problems)


def _value_problems(name: str, values: npt.NDArray[np.generic]) -> list[tuple[str, str, str, str]]:
    """Name every kind of value that is no whole number >= 0."""
    wanted = f"whole numbers >= 0 as {name}"
    if values.dtype.kind not in "iuf":
        return [("not-a-number", wanted, f"values of type {values.dtype}", "write integers")]
    out = []
    numbers = values.astype(np.float64)
    nan = np.isnan(numbers)
    checks = (
        ("nan", nan, "NaN", "give every trajectory a label; if 0 is meant as outlier, say outliers = true"),
        ("infinite", np.isinf(numbers), "infinite values", "write whole numbers"),
        (
            "too-big",
            np.abs(np.where(np.isfinite(numbers), numbers, 0)) >= 2**53,
            "huge numbers",
            "keep below 2^53",
        ),
        ("negative", numbers < 0, "negative numbers", "motions are 1, 2, ...; 0 is an outlier"),
    )
    for code, bad, what, fix in checks:
        if bad.any():
            out.append((code, wanted, f"{what} in {int(bad.sum())} of {len(bad)} rows", fix))
    fraction = np.isfinite(numbers) & (numbers != np.round(numbers))
    if values.dtype.kind == "f" and not out:
        example = repr(float(numbers[fraction][0])) if fraction.any() else repr(float(numbers[0]))
        out.append(
            ("float", wanted, f"floating-point numbers such as {example}", "write integers, 2 and not 2.0")
        )
    return out
