"""What a pull says: the licence, the plan before, the report after."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from kt3dmoseg.catalog.entries import format_numbers
from kt3dmoseg.kitti.plan import Task

LICENCE = """\
KITTI raw data: A. Geiger, P. Lenz, C. Stiller, R. Urtasun, "Vision meets Robotics: The KITTI Dataset",
IJRR 2013, https://www.cvlibs.net/datasets/kitti/
Licence: Creative Commons Attribution-NonCommercial-ShareAlike 3.0 (CC BY-NC-SA 3.0),
https://creativecommons.org/licenses/by-nc-sa/3.0/: give credit, no commercial use, share alike.
"""


@dataclass
class PullReport:
    """What a pull did.

    Parameters
    ----------
    files, bytes : int
        All wanted files, which are now on disk and verified.
    fetched : int
        How many of them this pull brought.
    requests, transferred : int
        Requests made and bytes of answers received.
    lacking : list of str
        Files that the source does not have (timestamps or packets of incomplete drives).
    """

    files: int = 0
    bytes: int = 0
    fetched: int = 0
    requests: int = 0
    transferred: int = 0
    lacking: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        """Say it in one line."""
        text = (
            f"complete and verified: {self.files} files, {megabytes(self.bytes)}; "
            f"fetched {self.fetched}, {megabytes(self.transferred)} in {self.requests} requests"
        )
        if self.lacking:
            text += f"; the source lacks {len(self.lacking)}: {', '.join(self.lacking[:3])}"
        return text


def plan_lines(tasks: Iterable[Task], root: Path) -> Iterator[str]:
    """Yield the plan: every task with its clips, then files and bytes in all."""
    files = whole = cost = 0
    for task in tasks:
        yield f"  {task.title}: {_extent(task)}"
        for entry in task.choice.entries:
            numbers = format_numbers(entry.numbers or ())
            proof = f"by {entry.proof}" if entry.proof else "as given"
            yield f"    {entry.name}: frames {numbers}, camera {entry.camera}, {proof}"
        yield from (f"    {failure}" for failure in task.choice.failures)
        files, cost, whole = files + len(task.missing), cost + task.cost, whole + bool(task.url)
    more = f" and {whole} whole zip(s)" if whole else ""
    yield f"plan: {files} files{more} to {root}, {megabytes(cost)} to transfer"


def megabytes(count: int) -> str:
    """Write a number of bytes in units of 1e6."""
    return f"{count / 1e6:.1f} MB"


def _extent(task: Task) -> str:
    if task.url:
        known = megabytes(task.size) if task.size is not None else "of unknown size"
        return f"the server sends whole files only: all of the zip, {known}"
    if task.holding is None:
        return "none"
    here = len(task.choice.names) - len(task.missing)
    ready = f", {here} already here" if here else ""
    return f"{len(task.choice.names)} files, {megabytes(task.bytes_wanted)}{ready}"
