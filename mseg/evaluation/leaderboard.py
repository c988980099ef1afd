"""A leaderboard in one SQLite file: scored submissions with their provenance, ranked per benchmark."""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path

from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.files import write_text
from mseg.evaluation.protocol import list_protocols, load_protocol, share
from mseg.evaluation.report import render
from mseg.evaluation.results import ResultsTable
from mseg.evaluation.scoring import ScoreTable, from_json, to_json

_VERSION = 2
_WAIT_SECONDS = 60.0
# The first also when a column is missing, or holds a text that is not UTF-8.
_DAMAGE = (sqlite3.SQLITE_ERROR, sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
# What makes two submissions the same.
_SAME = ("benchmark", "dataset_sha256", "submission_sha256", "toolkit_version")
_TYPES = {"str": "TEXT NOT NULL", "int": "INTEGER NOT NULL", "float": "REAL NOT NULL"}
_CLAIMED = "claimed INTEGER NOT NULL DEFAULT 1", "sha256 TEXT NOT NULL DEFAULT ''"  # not in version 1
_NOTES = (
    "Entries with failed or missing clips have no rank and come last; different data are never mixed.",
    "Claimed: read from a file of scores, which were not computed here.",
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
    def shown(self) -> float:
        """The mean as tables print it, in per cent, by which entries are ranked."""
        return round(100 * self.mean, 2)


_COLUMNS = [each.name for each in fields(Entry)]


@dataclass(frozen=True)
class Board:
    """Entries that may be compared: one benchmark, one and the same data."""

    title: str  # the benchmark
    about: str  # how much of it, and which data
    ranked: list[tuple[int | None, Entry]]  # best first; entries with failed or missing clips last, with None

    def table(self) -> ResultsTable:
        """Lay the board out."""
        rows = []
        for rank, e in self.ranked:
            errors = [f"{e.shown:.2f}", f"{100 * e.median:.2f}"]
            scored = "claimed" if e.claimed else "here"
            facts = [str(e.seeds), str(e.failed or ""), scored, e.added[:10], e.submission_sha256[:8]]
            rows.append([str(rank or "-"), e.method, *errors, *facts])
        columns = ["rank", "method", "mean", "median", "seeds", "failed", "scored", "added", "submission"]
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
        When it is no leaderboard, of a newer version, or damaged.
    """

    def __init__(self, path: str | os.PathLike[str], *, create: bool = True) -> None:
        self.path = Path(path)
        if not self.path.exists() and not create:
            fix = "'mseg leaderboard add' makes it"
            raise InputFileError(f"{path}", expected="a leaderboard", found="no such file", fix=fix)
        if self.path.exists() and not self.path.is_file():
            found = "a folder" if self.path.is_dir() else "a pipe or device"
            raise InputFileError(f"{path}: cannot write", expected="an SQLite file", found=found)
        new = not self.path.exists() or (create and not self.path.stat().st_size)
        with self._transaction(write=new):
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
        summary = scores.summary()
        row: dict[str, object] = {
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
        row["sha256"] = _checksum([*(row[name] for name in _COLUMNS[1:]), row["scores"]])
        with self._transaction(write=True) as connection:
            entries = _read(connection, self.path)
            same = next((e for e in entries if all(getattr(e, n) == row[n] for n in _SAME)), None)
            if replace is not None and replace not in [e.id for e in entries]:
                raise self._no_entry(replace)
            if claimed or (same and not same.claimed):
                self._check_agreement(connection, entries, same, scores, row)
            if same and replace not in (None, same.id):
                connection.execute("DELETE FROM entries WHERE id = ?", (same.id,))
            elif same and replace is None and same.claimed <= int(claimed):
                return same.id, False
            row["id"] = replace or (same.id if same else None)
            columns, values = ", ".join(row), ", ".join(f":{name}" for name in row)
            done = connection.execute(f"INSERT OR REPLACE INTO entries ({columns}) VALUES ({values})", row)
            return int(done.lastrowid or 0), True

    def _check_agreement(
        self,
        connection: sqlite3.Connection,
        entries: Sequence[Entry],
        same: Entry | None,
        scores: ScoreTable,
        row: Mapping[str, object],
    ) -> None:
        """Refuse scores that an entry of the same submission, or on data of the same hash, contradicts."""
        peers = [e for e in entries if all(getattr(e, name) == row[name] for name in _SAME[:2])]
        peer = same or min(peers, key=lambda e: e.claimed, default=None)
        if peer is None:
            return
        other = self._scores(connection, peer.id)
        wrong = "other clips or trajectories" if _clip_sizes(other) != _clip_sizes(scores) else ""
        if same and other.matrix().tolist() != scores.matrix().tolist():
            wrong = "other errors"
        if wrong:
            what = "the same submission" if same else "data of the same checksum"
            raise InvalidValueError(
                f"scores of {scores.meta.method}",
                expected=f"those of entry {peer.id}, which is of {what}",
                found=wrong,
                fix=f"score the submission itself; if the entry is wrong: mseg leaderboard remove {peer.id}",
            )

    def remove(self, number: int) -> None:
        """Remove an entry; InputFileError when there is none of that number."""
        with self._transaction(write=True) as connection:
            if not connection.execute("DELETE FROM entries WHERE id = ?", (number,)).rowcount:
                raise self._no_entry(number)

    def entries(self) -> list[Entry]:
        """Everything that is kept, oldest first."""
        with self._transaction() as connection:
            return _read(connection, self.path)

    def scores(self, number: int) -> ScoreTable:
        """Return the full scores of an entry."""
        with self._transaction() as connection:
            return self._scores(connection, number)

    def _scores(self, connection: sqlite3.Connection, number: int) -> ScoreTable:
        row = connection.execute("SELECT scores FROM entries WHERE id = ?", (number,)).fetchone()
        if row is None:
            raise self._no_entry(number)
        return from_json(row[0], f"{self.path}: entry {number}")

    def _no_entry(self, number: int) -> InputFileError:
        return InputFileError(f"{self.path}", expected=f"entry {number}", found="none of that number")

    def boards(self, benchmark: str = "") -> list[Board]:
        """Rank what is comparable, of one benchmark or of all; fuller data first."""
        wanted = [e for e in self.entries() if benchmark in ("", e.benchmark)]
        wanted.sort(key=lambda e: (e.benchmark, -e.clips, e.dataset_sha256))
        keyed = groupby(wanted, key=lambda e: (e.benchmark, e.dataset_sha256))
        return [_board(list(each)) for _, each in keyed]

    def listing(self) -> ResultsTable:
        """Lay out `entries`, with their provenance."""
        rows = []
        for e in self.entries():
            scored = [f"{100 * e.mean:.2f}", f"{e.clips}/{e.clips_in_full}", str(e.failed), e.dataset_version]
            source = [e.dataset_sha256[:8], e.submission_sha256[:8], e.toolkit_version]
            source.append("claimed" if e.claimed else "here")
            rows.append([str(e.id), e.added, e.benchmark, e.method, *scored, *source])
        columns = ["id", "added", "benchmark", "method", "mean %", "clips", "failed", "version", "data"]
        return ResultsTable(self.path.name, [*columns, "submission", "toolkit", "scored"], rows)

    @contextmanager
    def _transaction(self, *, write: bool = False) -> Iterator[sqlite3.Connection]:
        """Open the file and check it; what is not committed is rolled back."""
        connection = None
        try:
            if write:
                self.path.parent.mkdir(parents=True, exist_ok=True)
            address = f"{self.path.absolute().as_uri()}?mode={'rwc' if write else 'ro'}"
            connection = sqlite3.connect(address, timeout=_WAIT_SECONDS, isolation_level=None, uri=True)
            connection.execute("BEGIN IMMEDIATE" if write else "BEGIN")
            _check(connection, self.path, write=write)
            yield connection
            connection.execute("COMMIT")
        except (sqlite3.Error, OSError) as error:
            raise error if isinstance(error, KT3DMoSegError) else _failure(self.path, error) from None
        finally:
            if connection is not None:
                connection.close()


def _failure(path: Path, error: sqlite3.Error | OSError) -> KT3DMoSegError:
    code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_ERROR) & 0xFF  # without the details
    if isinstance(error, sqlite3.Error) and code in _DAMAGE:
        return _damaged(path, str(error))
    fix = "check the permissions of the folder and the space on the disk"
    return InputFileError(f"{path}: cannot write or read", found=str(error), fix=fix)


def _damaged(path: Path, what: str) -> FileFormatError:
    found = f"another file, or a damaged one ({what})"
    return FileFormatError(f"{path}", expected="a leaderboard", found=found, fix="restore it from a copy")


def _check(connection: sqlite3.Connection, path: Path, *, write: bool) -> None:
    """Refuse another or a damaged database; when writing, make the table or bring it to this version."""
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    tables = {r[0] for r in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    if write and not version and not tables:
        kinds = [f"{each.name} {_TYPES[str(each.type)]}" for each in fields(Entry)[1:-1]]
        columns = ["id INTEGER PRIMARY KEY", *kinds, *_CLAIMED, "scores TEXT NOT NULL"]
        connection.execute(f"CREATE TABLE entries ({', '.join(columns)}, UNIQUE ({', '.join(_SAME)}))")
    elif version not in (1, _VERSION) or "entries" not in tables:
        expected = f"a leaderboard of version {_VERSION}"
        raise FileFormatError(f"{path}", expected=expected, found=f"version {version} of {path.name}")
    elif (state := connection.execute("PRAGMA quick_check(1)").fetchone()[0]) != "ok":
        raise _damaged(path, state)
    elif write and version == 1:
        for column in _CLAIMED:
            connection.execute(f"ALTER TABLE entries ADD COLUMN {column}")
    if write:
        connection.execute(f"PRAGMA user_version = {_VERSION}")


def _read(connection: sqlite3.Connection, path: Path) -> list[Entry]:
    """Read the entries, oldest first; those of version 1 are claims, since it does not record it."""
    present = {row[1] for row in connection.execute("PRAGMA table_info(entries)")}
    missing = {"claimed": "1", "sha256": "''"}
    wanted = [n if n in present else missing.get(n, n) for n in (*_COLUMNS, "scores", "sha256")]
    entries = []
    for *values, scores, sha256 in connection.execute(f"SELECT {', '.join(wanted)} FROM entries ORDER BY id"):
        kinds = [{"str": str, "int": int, "float": float}[str(each.type)] for each in fields(Entry)]
        fine = all(type(value) is kind for value, kind in zip(values, kinds, strict=True))
        if not fine or sha256 not in ("", _checksum([*values[1:], scores])):
            raise _damaged(path, f"entry {values[0]} is not what was written")
        entries.append(Entry(*values))
    return entries


def _checksum(values: Sequence[object]) -> str:
    return hashlib.sha256(json.dumps(values).encode()).hexdigest()


def export(board: Leaderboard, path: str | os.PathLike[str], *, benchmark: str = "") -> None:
    """Write the ranked boards to a file ending in ``.html`` (a page that needs nothing else) or ``.md``."""
    boards = board.boards(benchmark)
    note = " ".join(_NOTES)
    suffix = Path(path).suffix.lower()
    if suffix in (".html", ".htm"):
        write_text(path, render("leaderboard.html", boards=boards, note=note))
    elif suffix == ".md":
        write_text(path, "\n\n".join(["# Leaderboard", *(b.table().markdown() for b in boards), note]) + "\n")
    else:
        raise InvalidValueError(os.fspath(path), expected="a file ending in .html or .md", found=repr(suffix))


def _clip_sizes(scores: ScoreTable) -> set[tuple[str, int, int]]:
    return {(each.clip, each.n, each.n_motions) for each in scores.clips}


def _board(entries: list[Entry]) -> Board:
    """Rank entries of one benchmark and one data set: mean error, failures last and without a rank."""
    first = entries[0]
    known = first.benchmark in list_protocols()
    name = load_protocol(first.benchmark).title if known else "Clips of no benchmark"
    part = "" if first.clips == first.clips_in_full else ", a part"
    amount = f"{share(first.clips, first.clips_in_full)} clips{part}"
    about = f"{amount}; data {first.dataset_version} ({first.dataset_sha256[:8]}); error in %"
    own = [e for e in entries if not e.claimed] or entries
    full = max(e.clips for e in own)
    ordered = sorted(entries, key=lambda e: (e.failed > 0 or e.clips != full, e.shown, e.id))
    shown = [e.shown for e in ordered]  # of equal ones, all have the rank of the first
    ranked = [(None if e.failed or e.clips != full else 1 + shown.index(e.shown), e) for e in ordered]
    return Board(name, about, ranked)
