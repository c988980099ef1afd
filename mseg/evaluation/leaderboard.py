"""A leaderboard in one SQLite file: scored submissions with their provenance, ranked per benchmark."""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path

from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.files import write_text
from mseg.evaluation.protocol import list_protocols, load_protocol, share
from mseg.evaluation.report import render
from mseg.evaluation.results import ResultsTable
from mseg.evaluation.scoring import ScoreTable, from_json, to_json

_VERSION = 1
_WAIT_SECONDS = 60.0
# What makes two submissions the same.
_SAME = ("benchmark", "dataset_sha256", "submission_sha256", "toolkit_version")
_TYPES = {"str": "TEXT NOT NULL", "int": "INTEGER NOT NULL", "float": "REAL NOT NULL"}


@dataclass(frozen=True)
class Entry:
    """One scored submission; the columns of the file, which also has the scores as JSON."""

    id: int
    added: str  # UTC, ISO 8601
    benchmark: str
    method: str
    dataset_version: str
    dataset_sha256: str
    submission_sha256: str
    toolkit_version: str
    clips: int
    clips_in_full: int  # of the complete benchmark
    failed: int  # clip runs counted as fully wrong
    seeds: int
    mean: float  # classification error over clips, a fraction
    median: float


@dataclass(frozen=True)
class Board:
    """Entries that may be compared: one benchmark, one and the same data."""

    title: str  # the benchmark
    about: str  # how much of it, and which data
    ranked: list[tuple[int | None, Entry]]  # best first; entries with failed clips last, with None

    def table(self) -> ResultsTable:
        """Lay the board out."""
        rows = []
        for rank, e in self.ranked:
            errors = [f"{100 * e.mean:.2f}", f"{100 * e.median:.2f}"]
            facts = [str(e.seeds), str(e.failed or ""), e.added[:10], e.submission_sha256[:8]]
            rows.append([str(rank or "-"), e.method, *errors, *facts])
        columns = ["rank", "method", "mean", "median", "seeds", "failed", "added", "submission"]
        return ResultsTable(f"{self.title}: {self.about}", columns, rows)

    def marks(self) -> dict[int, str]:
        """Class of the rows that have no rank, for the page."""
        return {i: "unranked" for i, (rank, _) in enumerate(self.ranked) if rank is None}


class Leaderboard:
    """The file; safe to use from several processes at once.

    Parameters
    ----------
    path : path
        The SQLite file.
    create : bool
        Make it when it is missing.

    Raises
    ------
    InputFileError
        When it is missing and not to be created, or cannot be opened.
    FileFormatError
        When it is no leaderboard, or of a newer version.
    """

    def __init__(self, path: str | os.PathLike[str], *, create: bool = True) -> None:
        self.path = Path(path)
        if create:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        elif not self.path.is_file():
            fix = "'mseg leaderboard add' makes it"
            raise InputFileError(f"{path}", expected="a leaderboard", found="no such file", fix=fix)
        with self._transaction() as connection:
            version = connection.execute("PRAGMA user_version").fetchone()[0]
            tables = {r[0] for r in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
            if not version and not tables:
                columns = [f"{each.name} {_TYPES[str(each.type)]}" for each in fields(Entry)[1:]]
                columns = ["id INTEGER PRIMARY KEY", *columns, "scores TEXT NOT NULL"]
                connection.execute(
                    f"CREATE TABLE entries ({', '.join(columns)}, UNIQUE ({', '.join(_SAME)}))"
                )
                connection.execute(f"PRAGMA user_version = {_VERSION}")
            elif version != _VERSION or "entries" not in tables:
                expected = f"a leaderboard of version {_VERSION}"
                raise FileFormatError(f"{path}", expected=expected, found=f"version {version}")

    def add(self, scores: ScoreTable) -> tuple[int, bool]:
        """Keep scores.

        Returns
        -------
        id : int
            Number of the entry.
        new : bool
            False when the very same submission was there already, scored on the same data by the
            same version of the toolkit.
        """
        summary = scores.summary()
        row = {
            "added": datetime.now(UTC).isoformat(timespec="seconds"),
            "benchmark": scores.benchmark.name,
            "method": scores.meta.method,
            **asdict(scores.provenance),
            "clips": len(scores.names),
            "clips_in_full": scores.benchmark.n_clips,
            "failed": len(scores.failures),
            "seeds": len(scores.seeds),
            "mean": summary.mean,
            "median": summary.median,
            "scores": json.dumps(to_json(scores)),
        }
        insert = f"INSERT OR IGNORE INTO entries ({', '.join(row)}) VALUES (:{', :'.join(row)})"
        same = "SELECT id FROM entries WHERE " + " AND ".join(f"{name} = :{name}" for name in _SAME)
        with self._transaction() as connection:
            new = connection.execute(insert, row).rowcount > 0
            return int(connection.execute(same, row).fetchone()[0]), new

    def entries(self) -> list[Entry]:
        """Everything that is kept, oldest first."""
        columns = ", ".join(each.name for each in fields(Entry))
        with self._transaction() as connection:
            return [Entry(*row) for row in connection.execute(f"SELECT {columns} FROM entries ORDER BY id")]

    def scores(self, number: int) -> ScoreTable:
        """Return the full scores of an entry."""
        with self._transaction() as connection:
            row = connection.execute("SELECT scores FROM entries WHERE id = ?", (number,)).fetchone()
        if row is None:
            raise InputFileError(f"{self.path}", expected=f"entry {number}", found="none of that number")
        return from_json(row[0], f"{self.path}: entry {number}")

    def boards(self, benchmark: str = "") -> list[Board]:
        """Rank what is comparable, of one benchmark or of all; fuller data first."""
        wanted = [e for e in self.entries() if benchmark in ("", e.benchmark)]
        wanted.sort(key=lambda e: (e.benchmark, -e.clips, e.dataset_sha256))
        keyed = groupby(wanted, key=lambda e: (e.benchmark, e.dataset_sha256))
        return [_board(list(each)) for _, each in keyed]

    def ranked(self, benchmark: str = "") -> list[ResultsTable]:
        """Lay out `boards`."""
        return [board.table() for board in self.boards(benchmark)]

    def listing(self) -> ResultsTable:
        """Lay out `entries`, with their provenance."""
        rows = []
        for e in self.entries():
            scored = [f"{100 * e.mean:.2f}", f"{e.clips}/{e.clips_in_full}", str(e.failed), e.dataset_version]
            source = [e.dataset_sha256[:8], e.submission_sha256[:8], e.toolkit_version]
            rows.append([str(e.id), e.added, e.benchmark, e.method, *scored, *source])
        columns = ["id", "added", "benchmark", "method", "mean %", "clips", "failed", "version", "data"]
        return ResultsTable(self.path.name, [*columns, "submission", "toolkit"], rows)

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        connection = None
        try:
            connection = sqlite3.connect(self.path, timeout=_WAIT_SECONDS, isolation_level=None)
            connection.execute("BEGIN IMMEDIATE")
            yield connection
            connection.execute("COMMIT")
        except sqlite3.OperationalError as error:
            fix = "check the permissions of the folder and the space on the disk"
            raise InputFileError(f"{self.path}: cannot write", found=str(error), fix=fix) from None
        except sqlite3.DatabaseError as error:
            raise FileFormatError(f"{self.path}", expected="a leaderboard", found=str(error)) from None
        finally:
            if connection is not None:
                connection.close()  # rolls back what was not committed


def export(board: Leaderboard, path: str | os.PathLike[str], *, benchmark: str = "") -> None:
    """Write the ranked boards to a file ending in ``.html`` (a page that needs nothing else) or ``.md``."""
    boards = board.boards(benchmark)
    note = "Entries with failed or missing clips have no rank and come last; different data are never mixed."
    suffix = Path(path).suffix.lower()
    if suffix in (".html", ".htm"):
        write_text(path, render("leaderboard.html", boards=boards, note=note))
    elif suffix == ".md":
        write_text(path, "\n\n".join(["# Leaderboard", *(b.table().markdown() for b in boards), note]) + "\n")
    else:
        raise InvalidValueError(os.fspath(path), expected="a file ending in .html or .md", found=repr(suffix))


def _board(entries: list[Entry]) -> Board:
    """Rank entries of one benchmark and one data set: mean error, failures last and without a rank."""
    first = entries[0]
    known = first.benchmark in list_protocols()
    name = load_protocol(first.benchmark).title if known else "Clips of no benchmark"
    part = "" if first.clips == first.clips_in_full else ", a part"
    amount = f"{share(first.clips, first.clips_in_full)} clips{part}"
    about = f"{amount}; data {first.dataset_version} ({first.dataset_sha256[:8]}); error in %"
    ordered = sorted(entries, key=lambda e: (e.failed > 0, e.mean, e.id))
    clean = [e.mean for e in ordered if not e.failed]
    return Board(name, about, [(None if e.failed else 1 + clean.index(e.mean), e) for e in ordered])
