"""Prediction files as text: a header ``track,label`` and one row per trajectory."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from mseg.evaluation.prediction.arrays import Columns
from mseg.evaluation.problems import first_few

HEADER = ["track", "label"]
_MAX_CELL = 64
_FIX_HEADER = "make the first line 'track,label' and write one 'id,label' line per evaluated trajectory"


def parse_csv(content: bytes) -> Columns:
    """Read ``track,label`` rows.

    A byte order mark, Windows line ends, blanks around values, a final empty line and the columns
    in the order ``label,track`` are accepted.
    """
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return Columns().bad("encoding", "UTF-8 text", "other bytes", "save the file as plain UTF-8 CSV")
    rows = [line.split(",") for line in text.splitlines() if line.strip()]
    if not rows:
        return Columns().bad("empty-file", "'track,label' and rows", "an empty file", _FIX_HEADER)
    out = Columns()
    head = [cell.strip().strip('"').lower() for cell in rows[0]]
    if sorted(head) == sorted(HEADER):
        _columns(out, rows[1:], head)
    elif head[0] in HEADER and len(head) > 2:
        out.bad(
            "transposed",
            "one row per trajectory",
            f"{len(rows)} lines of up to {len(head)} values",
            "transpose the table: two columns, track and label",
        )
    else:
        _headless(out, rows, head)
    return out


def _headless(out: Columns, rows: list[list[str]], head: list[str]) -> None:
    """Say why the first line is not the header, then read on as far as it makes sense."""
    separated = next((s for s in ";\t |" if s in ",".join(rows[0]).strip()), "")
    if len(head) == 1 and separated:
        name = {" ": "blanks", "\t": "tabs"}.get(separated, f"'{separated}'")
        out.bad("separator", "values separated by commas", name, "separate the values by commas")
    elif len(head) == 1 and _is_number(head[0]):
        out.bad(
            "label-only",
            "two columns, track and label",
            f"{len(rows)} lines of one value",
            f"{_FIX_HEADER}; or turn label files into a submission with "
            "'mseg example-submission DATA --from FOLDER -o OUT'",
        )
    elif len(head) > 2 and len(rows) <= 2:
        out.bad("transposed", "one row per trajectory", f"{len(rows)} long lines", "transpose the table")
    elif len(head) == 2 and all(map(_is_number, head)):
        out.bad("no-header", "the first line 'track,label'", f"'{','.join(head)}'", _FIX_HEADER)
        _columns(out, rows, HEADER)
    else:
        out.bad("header", "the first line 'track,label'", f"'{','.join(rows[0])[:60]}'", _FIX_HEADER)


def _columns(out: Columns, rows: list[list[str]], names: list[str]) -> None:
    ragged = [i for i, row in enumerate(rows, start=2) if len(row) != 2]
    if ragged:
        out.bad(
            "ragged", "two values in every line", f"another number in line {first_few(ragged)}", _FIX_HEADER
        )
        return
    if not rows:
        out.bad("empty-file", "one row per trajectory", "only a header", _FIX_HEADER)
        return
    flat = [cell for row in rows for cell in row]
    table = _numbers(flat)
    if table is None:
        bad = [i for i, row in enumerate(rows, start=2) if not all(map(_is_number, row))]
        cell = next(c for c in flat if not _is_number(c))
        out.bad(
            "not-a-number",
            "whole numbers",
            f"{cell.strip()[:40]!r} (line {first_few(bad)})",
            "write the motion's number, not its name",
        )
        return
    values = table.reshape(-1, 2)
    place = {name: values[:, i] for i, name in enumerate(names)}
    out.track, out.label = place["track"], place["label"]
    if values.dtype.kind == "f":
        # Keep the exact integers of a column whose neighbour holds floats.
        for name in HEADER:
            whole = np.round(place[name])
            if (np.abs(place[name]) < 2**53).all() and _written_whole(rows, names.index(name)):
                setattr(out, name, whole.astype(np.int64))


def _written_whole(rows: list[list[str]], column: int) -> bool:
    return all(row[column].strip().lstrip("+-").isdecimal() for row in rows)


def _numbers(cells: list[str]) -> npt.NDArray[Any] | None:
    """Convert text to int64 where possible, else to float64; None when some are no numbers."""
    if max(map(len, cells)) > _MAX_CELL:  # numpy would make every cell as wide as the widest
        return None
    try:
        return np.array(cells, dtype=np.str_).astype(np.int64)
    except (ValueError, OverflowError):
        pass
    try:
        return np.array([float(cell) for cell in cells], dtype=np.float64)
    except (ValueError, OverflowError):
        return None


def _is_number(cell: str) -> bool:
    if len(cell) > _MAX_CELL:
        return False
    try:
        float(cell)
    except ValueError:
        return False
    return True
