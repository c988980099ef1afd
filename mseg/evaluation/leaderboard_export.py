"""The leaderboard as a self-contained page or as Markdown."""

from __future__ import annotations

import os
from html import escape
from pathlib import Path

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.files import write_text
from mseg.evaluation.leaderboard import Leaderboard
from mseg.evaluation.page import page
from mseg.evaluation.ranking import Board


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
    table = board.table()
    head = "".join(f"<th scope='col'>{escape(c)}</th>" for c in table.columns)
    body = "".join(
        f"<tr{'' if rank else ' class=unranked'}>" + "".join(f"<td>{escape(c)}</td>" for c in row) + "</tr>"
        for (rank, _), row in zip(board.ranked, table.rows, strict=True)
    )
    return (
        f"<section><h2>{escape(board.title)}</h2><div class='scroll'><table class='board'>"
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div></section>"
    )


_NOTE = "Entries with failed or missing clips have no rank and stand below; different data are never mixed."
