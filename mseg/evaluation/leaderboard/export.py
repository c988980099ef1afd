"""The leaderboard as a self-contained page or as Markdown."""

from __future__ import annotations

import os
from dataclasses import replace
from html import escape
from pathlib import Path

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.files import write_text
from mseg.evaluation.leaderboard import Leaderboard
from mseg.evaluation.leaderboard.ranking import Board
from mseg.evaluation.page import html_table, page


def export(board: Leaderboard, path: str | os.PathLike[str], *, benchmark: str = "") -> None:
    """Write the ranked boards to a file ending in ``.html`` or ``.md``.

    Raises
    ------
    InvalidValueError
        For another ending.
    """
    boards = board.boards(benchmark)
    suffix = Path(path).suffix.lower()
    if suffix in (".html", ".htm"):
        write_text(path, as_html(boards))
    elif suffix == ".md":
        write_text(path, as_markdown(boards))
    else:
        raise InvalidValueError(os.fspath(path), expected="a file ending in .html or .md", found=repr(suffix))


def as_markdown(boards: list[Board]) -> str:
    """Lay the boards out in Markdown."""
    return "\n\n".join(["# Leaderboard", *(b.table().markdown() for b in boards), _NOTE]) + "\n"


def as_html(boards: list[Board]) -> str:
    """Lay the boards out as a page that needs nothing else."""
    sections = "".join(_section(board) for board in boards) or "<p>No entries yet.</p>"
    return page("Leaderboard", f"<h1>Leaderboard</h1>{sections}<p class='quiet'>{escape(_NOTE)}</p>")


def _section(board: Board) -> str:
    table = replace(board.table(), title=board.about)
    marks = {i: "unranked" for i, (rank, _) in enumerate(board.ranked) if rank is None}
    return f"<section><h2>{escape(board.title)}</h2>{html_table(table, kind='board', marks=marks)}</section>"


_NOTE = "Entries with failed or missing clips have no rank and stand below; different data are never mixed."
