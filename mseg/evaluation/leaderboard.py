"""A leaderboard in one SQLite file: scored submissions with their provenance, ranked per benchmark."""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.files import PathLike, check_target, write_text
from kt3dmoseg.text import several
from mseg.evaluation.protocol import list_protocols, load_protocol, share
from mseg.evaluation.results import ResultsTable, method_notes
from mseg.evaluation.scoring import ScoreTable, from_json, to_json
from mseg.evaluation.site import DataRows, Row, site_html

_WAIT_SECONDS = 60.0
_LARGEST, _LONGEST = 128 << 20, 16 << 20  # bytes of the file, of the scores of one entry
# The first also when a column is missing, or holds a text that is not UTF-8.
_DAMAGE = (sqlite3.SQLITE_ERROR, sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_TOOBIG)
# What makes two submissions the same.
_SAME = ("benchmark", "dataset_sha256", "submission_sha256", "toolkit_version")
_TYPES = {"str": "TEXT NOT NULL", "int": "INTEGER NOT NULL", "float": "REAL NOT NULL"}
_NOTE = (
    "Entries with failed or missing clips have no rank and come last; different data are never mixed. "
    "Claimed: read from a file of scores, which were not computed here."
)


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
    claimed: int  # 1: read from a file of scores, not computed here

    @property
    def scored(self) -> str:
        """Where the scores come from, for tables."""
        return "claimed" if self.claimed else "here"


def _schema() -> tuple[str, str]:
    typed = [f"{each.name} {_TYPES[str(each.type)]}" for each in fields(Entry)[1:]]
    columns = ", ".join(["id INTEGER PRIMARY KEY", *typed, "sha256 TEXT NOT NULL", "scores TEXT NOT NULL"])
    return f"CREATE TABLE entries ({columns}, UNIQUE ({', '.join(_SAME)}))", "PRAGMA user_version = 2"


@dataclass(frozen=True)
class Board:
    """Entries that may be compared: one benchmark, one and the same data."""

    rows: DataRows  # best first; entries with failed or missing clips last
    ranked: list[tuple[int | None, Entry]]  # the same, and ranks; None without one
    notes: list[str]  # what the methods report

    def as_dict(self) -> dict[str, Any]:
        """Give the board as JSON values."""
        ranked = [(rank, asdict(entry)) for rank, entry in self.ranked]
        return {"title": self.rows.title, "about": self.rows.about, "ranked": ranked}

    def table(self) -> ResultsTable:
        """Lay the board out."""
        rows = []
        for (rank, row, _), (_, e) in zip(self.rows.ranked, self.ranked, strict=True):
            errors = [f"{row.shown:.2f}", f"{100 * row.summary.median:.2f}"]
            facts = [str(e.seeds), str(e.failed or ""), e.scored, row.number]
            rows.append([str(rank or "-"), e.method, *errors, *facts, e.added[:10], e.submission_sha256[:8]])
        columns = ["rank", "method", "mean", "median", "seeds", "failed", "scored", "motions", "added"]
        return ResultsTable(
            f"{self.rows.title}: {self.rows.about}", [*columns, "submission"], rows, self.notes
        )


class Leaderboard:
    """The SQLite file at `path`; safe to use from several processes at once. `create` makes a missing one.

    InputFileError when it is missing and not to be created, or cannot be opened; FileFormatError when it is
    no leaderboard, of a newer version, or damaged.
    """

    def __init__(self, path: PathLike, *, create: bool = True) -> None:
        self.path = Path(path)
        if not self.path.exists() and not create:
            fix = "'mseg leaderboard add' makes it"
            raise InputFileError(f"{path}", expected="a leaderboard", found="no such file", fix=fix)
        check_target(self.path)
        size = self.path.stat().st_size if self.path.exists() else 0
        if size > _LARGEST:
            raise FileFormatError(f"{path}", expected=f"at most {_LARGEST} bytes", found=f"{size}")
        new = not self.path.exists() or (create and not size)
        with self._open(write=new):
            pass

    def add(
        self, scores: ScoreTable, *, claimed: bool = False, replace: int | None = None
    ) -> tuple[int, bool]:
        """Keep scores; return the number of their entry, and False when they were there already.

        They were when the entry is of the same submission, data and version of the toolkit. `claimed` scores
        were read from a file; the tables mark them, until the submission itself is scored and added. They
        take the place of entry `replace`. InvalidValueError when an entry of the same submission, or for
        claimed ones of the same data, contradicts them; InputFileError when there is none to replace.
        """
        row = _columns(scores, claimed=claimed)
        with self._open(write=True) as (connection, kept):
            same = next((e for e in kept if all(getattr(e, name) == row[name] for name in _SAME)), None)
            if replace is not None and replace not in [e.id for e in kept]:
                raise self._no_entry(replace)
            if claimed or (same and not same.claimed):
                self._check_agreement(kept, same, scores, row)
            if same and replace not in (None, same.id):
                connection.execute("DELETE FROM entries WHERE id = ?", (same.id,))
            elif same and replace is None and same.claimed <= int(claimed):
                return same.id, False
            row["id"] = replace or (same.id if same else None)
            columns, values = ", ".join(row), ", ".join(f":{name}" for name in row)
            done = connection.execute(f"INSERT OR REPLACE INTO entries ({columns}) VALUES ({values})", row)
            return int(done.lastrowid or 0), True

    def _check_agreement(
        self, kept: Mapping[Entry, str], same: Entry | None, scores: ScoreTable, row: Mapping[str, object]
    ) -> None:
        """Refuse scores that an entry of the same submission, or on data of the same hash, contradicts."""
        peers = [e for e in kept if all(getattr(e, name) == row[name] for name in _SAME[:2])]
        peer = same or min(peers, key=lambda e: e.claimed, default=None)
        if peer is None:
            return
        other = from_json(kept[peer], f"{self.path}: entry {peer.id}")
        sizes, own = ({(c.clip, c.n, c.n_motions) for c in table.clips} for table in (other, scores))
        wrong = "other clips or trajectories" if sizes != own else ""
        if same and other.matrix().tolist() != scores.matrix().tolist():
            wrong = "other errors"
        if wrong:
            what = "the same submission" if same else "data of the same checksum"
            expected = f"those of entry {peer.id}, which is of {what}"
            fix = f"score the submission itself; if the entry is wrong: mseg leaderboard remove {peer.id}"
            raise InvalidValueError(
                f"scores of {scores.meta.method}", expected=expected, found=wrong, fix=fix
            )

    def remove(self, number: int) -> None:
        """Remove an entry; InputFileError when there is none of that number."""
        with self._open(write=True) as (connection, _):
            if not connection.execute("DELETE FROM entries WHERE id = ?", (number,)).rowcount:
                raise self._no_entry(number)

    def entries(self) -> list[Entry]:
        """Everything that is kept, oldest first."""
        with self._open() as (_, kept):
            return list(kept)

    def _no_entry(self, number: int) -> InputFileError:
        return InputFileError(f"{self.path}", expected=f"entry {number}", found="none of that number")

    def boards(self, benchmark: str = "") -> list[Board]:
        """Rank what is comparable, of one benchmark or of all; fuller data first.

        Methods that found the number of motions are ranked apart, after those that were given it.
        """
        if benchmark not in ("", "custom"):
            load_protocol(benchmark)  # refuses a misspelt name
        with self._open() as (_, kept):
            wanted = [e for e in kept if benchmark in ("", e.benchmark)]
            tables = {e: from_json(kept[e], f"{self.path}: entry {e.id}") for e in wanted}
        wanted.sort(key=lambda e: (e.benchmark, -e.clips, e.dataset_sha256))
        keyed = groupby(wanted, key=lambda e: (e.benchmark, e.dataset_sha256))
        return [_board({e: tables[e] for e in each}) for _, each in keyed]

    def listing(self) -> ResultsTable:
        """Lay out `entries`, with their provenance."""
        rows = []
        for e in self.entries():
            scored = [f"{100 * e.mean:.2f}", f"{e.clips}/{e.clips_in_full}", str(e.failed), e.dataset_version]
            source = [e.dataset_sha256[:8], e.submission_sha256[:8], e.toolkit_version, e.scored]
            rows.append([str(e.id), e.added, e.benchmark, e.method, *scored, *source])
        columns = ["id", "added", "benchmark", "method", "mean %", "clips", "failed", "version", "data"]
        return ResultsTable(self.path.name, [*columns, "submission", "toolkit", "scored"], rows)

    @contextmanager
    def _open(self, *, write: bool = False) -> Iterator[tuple[sqlite3.Connection, dict[Entry, str]]]:
        """Give a transaction and every entry with its scores; what is not committed is rolled back."""
        connection = None
        try:
            if write:
                self.path.parent.mkdir(parents=True, exist_ok=True)
            address = f"{self.path.absolute().as_uri()}?mode={'rwc' if write else 'ro'}"
            connection = sqlite3.connect(address, timeout=_WAIT_SECONDS, isolation_level=None, uri=True)
            connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LONGEST)
            connection.execute("BEGIN IMMEDIATE" if write else "BEGIN")
            yield connection, _kept(connection, self.path, write=write)
            connection.execute("COMMIT")
        except (sqlite3.Error, OSError) as error:
            code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_ERROR) & 0xFF  # without the details
            if isinstance(error, sqlite3.Error) and code in _DAMAGE:
                raise _damaged(self.path, str(error)) from None
            if isinstance(error, KT3DMoSegError):
                raise
            fix = "check the permissions of the folder and the space on the disk"
            if code in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
                fix = "another process writes to it: try again when that has ended"
            raise InputFileError(f"{self.path}: cannot write or read", found=str(error), fix=fix) from None
        finally:
            if connection is not None:
                connection.close()


def _columns(scores: ScoreTable, *, claimed: bool) -> dict[str, Any]:
    summary = scores.summary()
    row: dict[str, Any] = {
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
        "claimed": int(claimed),
        "scores": json.dumps(to_json(scores)),
    }
    return row | {"sha256": _checksum(row.values())}


def _checksum(values: Iterable[object]) -> str:
    return hashlib.sha256(json.dumps(list(values), default=str).encode()).hexdigest()


def _damaged(path: Path, what: str) -> FileFormatError:
    found = f"another file, or a damaged one ({what})"
    return FileFormatError(f"{path}", expected="a leaderboard", found=found, fix="restore it from a copy")


def _kept(connection: sqlite3.Connection, path: Path, *, write: bool) -> dict[Entry, str]:
    """Read entries and their scores, oldest first; when writing, make the table of a new file.

    Another or a damaged database is refused, and version 1, which does not record what is a claim.
    """
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    tables = {r[0] for r in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    new = write and not version and not tables
    if not new and "entries" not in tables:
        raise _damaged(path, "it has no table of entries")
    if not new and version != 2:
        found, fix = f"version {version}", "add the submissions to a new file"
        raise FileFormatError(f"{path}", expected="a leaderboard of version 2", found=found, fix=fix)
    if (state := connection.execute("PRAGMA quick_check(1)").fetchone()[0]) != "ok":
        raise _damaged(path, state)
    for statement in _schema() if new else ():
        connection.execute(statement)
    kept = {}
    query = f"SELECT {', '.join(Entry.__dataclass_fields__)}, sha256, scores FROM entries ORDER BY id"
    for *values, sha256, scores in connection.execute(query):
        if sha256 != _checksum([*values[1:], scores]):
            raise _damaged(path, f"entry {values[0]} is not what was written")
        kept[Entry(*values)] = scores
    return kept


def export(board: Leaderboard, path: PathLike, *, benchmark: str = "") -> None:
    """Write the ranked boards to a file ending in ``.html`` (a page that needs nothing else) or ``.md``."""
    boards = board.boards(benchmark)
    suffix = Path(path).suffix.lower()
    if suffix in (".html", ".htm"):
        write_text(path, site_html([each.rows for each in boards], notes=[_NOTE]))
    elif suffix == ".md":
        tables = [board.table().markdown() for board in boards]
        write_text(path, "\n\n".join(["# Leaderboard", *tables, _NOTE]) + "\n")
    else:
        raise InvalidValueError(os.fspath(path), expected="a file ending in .html or .md", found=repr(suffix))


def _board(tables: Mapping[Entry, ScoreTable]) -> Board:
    """Rank entries of one benchmark and one data set; those of fewer clips than the others have no rank."""
    first = next(iter(tables))
    known = first.benchmark in list_protocols()
    title = load_protocol(first.benchmark).title if known else "Clips of no benchmark"
    part = "" if first.clips == first.clips_in_full else ", a part"
    amount = f"{share(first.clips, first.clips_in_full)} clips{part}"
    about = (
        f"{amount}; data {first.dataset_version} ({first.dataset_sha256[:8]}); error in %, lower is better"
    )
    fullest = tables[max(tables, key=lambda e: (not e.claimed, e.clips))]
    entries = {_row(e, table, complete=table.names == fullest.names): e for e, table in tables.items()}
    protocol = fullest.benchmark.of_version(first.dataset_version)
    rows = DataRows(title, about, protocol, fullest.motions, [*entries])
    ranked = [(rank, entries[row]) for rank, row, _ in rows.ranked]
    notes = [f"{e.method}: {several(each, 1)}" for _, e in ranked if (each := method_notes(tables[e]))]
    return Board(rows, ranked, notes)


def _row(entry: Entry, table: ScoreTable, *, complete: bool) -> Row:
    facts = {"added": entry.added[:10], "submission": entry.submission_sha256[:8]}
    return Row(
        entry.method,
        table.matrix(),
        [table.of(name).n for name in table.names],
        number="given" if table.meta.n_motions_given else "found",
        kind="claimed" if entry.claimed else "baseline" if table.meta.baseline else "measured",
        supervised=table.meta.supervised,
        authors=", ".join(table.meta.authors),
        link=table.meta.link,
        failed=entry.failed,
        complete=complete,
        right=float(np.mean([clip.n_found == clip.n_motions for clip in table.clips])),
        seconds=table.meta.seconds,
        facts=facts | {"notes": " ".join(method_notes(table))} | dict(table.meta.parameters),
    )
