"""A table of texts, laid out for a terminal, Markdown, LaTeX or CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass

_LATEX = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
_LATEX |= {character: "\\" + character for character in "&%$#_{}"}


@dataclass(frozen=True)
class TextTable:
    """Rows of texts under headings.

    Parameters
    ----------
    title : str
        What the table shows, with its unit.
    columns : sequence of str
        Headings; the first column and columns of words are set left, numbers right.
    rows : sequence of sequence of str
        As many cells as columns.
    notes : sequence of str
        Lines below the table.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: Sequence[str] = ()

    def text(self) -> str:
        """Lay out for a terminal."""
        widths = [max(map(len, column)) for column in zip(self.columns, *self.rows, strict=True)]
        left = self._left()
        lines = [_line(row, widths, left) for row in (self.columns, *self.rows)]
        return "\n".join(
            [self.title, "", lines[0], "  ".join("-" * w for w in widths), *lines[1:], *self.notes]
        )

    def markdown(self) -> str:
        """Lay out as a Markdown table."""
        rule = ["---" if left else "---:" for left in self._left()]
        rows = [[cell.replace("|", "\\|") for cell in row] for row in (self.columns, *self.rows)]
        lines = ["| " + " | ".join(row) + " |" for row in (rows[0], rule, *rows[1:])]
        return "\n".join(
            [f"**{self.title}**", "", *lines, "", *(f"- {note}" for note in self.notes)]
        ).rstrip()

    def _left(self) -> list[bool]:
        """Say of each column whether it is set left."""
        columns = zip(*self.rows, strict=True) if self.rows else ((),) * len(self.columns)
        return [
            i == 0 or (bool(cells) and all(cell[:1].isalpha() for cell in cells))
            for i, cells in enumerate(columns)
        ]

    def latex(self) -> str:
        """Lay out as a LaTeX table for the package booktabs."""
        rows = [" & ".join(map(_escape_latex, row)) + r" \\" for row in (self.columns, *self.rows)]
        return "\n".join(
            [
                f"% {self.title}",
                *(f"% {note}" for note in self.notes),
                r"\begin{tabular}{l" + "r" * (len(self.columns) - 1) + "}",
                r"\toprule",
                rows[0],
                r"\midrule",
                *rows[1:],
                r"\bottomrule",
                r"\end{tabular}",
            ]
        )

    def csv(self) -> str:
        """Lay out as comma-separated values, without title and notes."""
        buffer = io.StringIO()
        csv.writer(buffer, lineterminator="\n").writerows([self.columns, *self.rows])
        return buffer.getvalue()


def count(number: int, noun: str) -> str:
    """Count something: "1 clip", "2 clips"."""
    return f"{number} {noun}{'s' * (number != 1)}"


def _line(row: Sequence[str], widths: Sequence[int], left: Sequence[bool]) -> str:
    cells = zip(row, widths, left, strict=True)
    return "  ".join(cell.ljust(w) if to_left else cell.rjust(w) for cell, w, to_left in cells).rstrip()


def _escape_latex(text: str) -> str:
    return "".join(_LATEX.get(character, character) for character in text)
