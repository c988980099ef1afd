"""What a leaderboard ranks: entries that may be compared, best first."""

from __future__ import annotations

from dataclasses import dataclass

from mseg.evaluation.layout import TextTable
from mseg.evaluation.protocol import list_protocols, load_protocol


@dataclass(frozen=True)
class Entry:
    """One scored submission.

    Parameters
    ----------
    id, added : int, str
        Number and time (UTC, ISO 8601) of the entry.
    benchmark, method : str
        What was scored on what.
    dataset_version, dataset_sha256, submission_sha256, toolkit_version : str
        Provenance, see `Provenance`.
    clips, clips_in_full : int
        Clips scored, and in the whole benchmark.
    failed, seeds : int
        Clip runs counted as fully wrong, and number of seeds.
    mean, median : float
        Classification error over clips, fractions.
    """

    id: int
    added: str
    benchmark: str
    method: str
    dataset_version: str
    dataset_sha256: str
    submission_sha256: str
    toolkit_version: str
    clips: int
    clips_in_full: int
    failed: int
    seeds: int
    mean: float
    median: float


@dataclass(frozen=True)
class Board:
    """Entries that may be compared: one benchmark, one and the same data.

    Parameters
    ----------
    title, about : str
        The benchmark; how much of it, and which data.
    ranked : list of (int or None, Entry)
        Best first; None for entries with failed or missing clips, which come last.
    """

    title: str
    about: str
    ranked: list[tuple[int | None, Entry]]

    def table(self) -> TextTable:
        """Lay the board out."""
        rows = [
            [
                "-" if rank is None else str(rank),
                entry.method,
                f"{100 * entry.mean:.2f}",
                f"{100 * entry.median:.2f}",
                str(entry.seeds),
                str(entry.failed) if entry.failed else "",
                entry.added[:10],
                entry.submission_sha256[:8],
            ]
            for rank, entry in self.ranked
        ]
        columns = ["rank", "method", "mean", "median", "seeds", "failed", "added", "submission"]
        return TextTable(f"{self.title}: {self.about}", columns, rows)


def make_board(entries: list[Entry]) -> Board:
    """Rank entries of one benchmark and one data set: mean error, failures last and without a rank."""
    first = entries[0]
    protocol = load_protocol(first.benchmark) if first.benchmark in list_protocols() else None
    name = protocol.title if protocol else "Clips of no benchmark"
    full = first.clips == first.clips_in_full
    amount = f"all {first.clips} clips" if full else f"{first.clips} of {first.clips_in_full} clips, a part"
    about = f"{amount}; data {first.dataset_version} ({first.dataset_sha256[:8]}); error in %"
    ordered = sorted(entries, key=lambda e: (e.failed > 0, e.mean, e.id))
    clean = [e.mean for e in ordered if not e.failed]
    return Board(name, about, [(None if e.failed else 1 + clean.index(e.mean), e) for e in ordered])
