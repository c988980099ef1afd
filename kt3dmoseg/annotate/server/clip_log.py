"""Who did what on a clip, and when: a log that only grows, next to the clip's annotation.

One JSON object a line, each with ``time`` and ``by``; then what happened: ``state``, ``assigned`` (to whom),
or the ``revision`` that was saved, with the names of objects that were ``added``, ``changed``, ``removed``.
"""

import json
import os
from collections import defaultdict
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

from kt3dmoseg.annotate.model import Annotation
from kt3dmoseg.errors import FileFormatError, InvalidValueError
from kt3dmoseg.files import hold_folder, parse_json, read_bytes, write_text

WORK_STATES = ("not started", "in work", "done", "reviewed")
_MAX_LOG = 1 << 24
_LONGEST_NAME = 100
# Seconds after which a person who saved nothing is taken to have paused.
_PAUSE = 300


class ClipLog:
    """The log ``<clip>.log.jsonl`` of a clip."""

    def __init__(self, annotation: Path) -> None:
        self.path = annotation.with_suffix(".log.jsonl")
        self._read: tuple[object, list[dict[str, Any]]] = (None, [])

    def entries(self) -> list[dict[str, Any]]:
        """Return all entries, the first first; FileFormatError with the line that is damaged."""
        if not (version := file_version(self.path)):
            return []
        if self._read[0] != version:
            lines = read_bytes(self.path, _MAX_LOG).splitlines()
            found = [_entry(line, f"{os.fspath(self.path)}: line {k}") for k, line in enumerate(lines, 1)]
            self._read = version, found
        return self._read[1]

    def add(self, by: object, **what: object) -> dict[str, Any]:
        """Add an entry of now, and return it; InvalidValueError for a state or name that is none."""
        if what.get("state", WORK_STATES[0]) not in WORK_STATES:
            expected = f"one of {', '.join(WORK_STATES)}"
            raise InvalidValueError("state", expected=expected, found=repr(what["state"])[:80])
        _check_name("assigned", what.get("assigned", ""))
        # What is saved may have been drawn by nobody in particular.
        if "revision" not in what or "state" in what:
            _check_name("by", by, least=1)
        entry = {"time": datetime.now(UTC).isoformat(timespec="seconds"), "by": str(by).strip()} | what
        with hold_folder(self.path.parent):
            before = read_bytes(self.path, _MAX_LOG).decode() if self.path.exists() else ""
            write_text(self.path, f"{before}{json.dumps(entry, ensure_ascii=False)}\n")
        return entry

    def add_save(self, by: str, before: Annotation, saved: Annotation) -> None:
        """Add what was saved."""
        old, new = ({item.id: item for item in side.objects} for side in (before, saved))
        found = {
            "added": [item.name for number, item in new.items() if number not in old],
            "changed": [item.name for number, item in new.items() if number in old and old[number] != item],
            "removed": [item.name for number, item in old.items() if number not in new],
            "lassos": ["changed"] if before.marks != saved.marks else [],
        }
        self.add(by, revision=saved.revision, **{what: names for what, names in found.items() if names})

    def last(self, what: str) -> dict[str, Any] | None:
        """Return the last entry with this, ``state`` or ``assigned``."""
        return next((entry for entry in reversed(self.entries()) if what in entry), None)

    def minutes(self) -> dict[str, float]:
        """Return how long each person worked: between saves of theirs not more than five minutes apart."""
        saved = defaultdict(list)
        for entry in self.entries():
            saved[entry["by"]].append(datetime.fromisoformat(entry["time"]))
        gaps = {by: [(b - a).total_seconds() for a, b in pairwise(times)] for by, times in saved.items()}
        return {by: sum(gap for gap in all_of if gap <= _PAUSE) / 60 for by, all_of in gaps.items()}


def file_version(path: Path) -> tuple[int, ...]:
    """Return what changes whenever a file is written; empty when there is none."""
    try:
        status = path.stat()
    except OSError:
        return ()
    return status.st_mtime_ns, status.st_size, status.st_ino


def _check_name(field: str, value: object, least: int = 0) -> None:
    if not isinstance(value, str) or not least <= len(value.strip()) <= _LONGEST_NAME:
        expected = f"the annotator's name, of {least} to {_LONGEST_NAME} characters"
        raise InvalidValueError(field, expected=expected, found=repr(value)[:80])


def _entry(line: bytes, where: str) -> dict[str, Any]:
    found = parse_json(line, where)
    try:
        datetime.fromisoformat(found["time"])
        good = isinstance(found["by"], str) and found.get("state", WORK_STATES[0]) in WORK_STATES
    except (TypeError, KeyError, ValueError):
        good = False
    if not good:
        raise FileFormatError(where, expected="time, by and what was done", found=repr(found)[:80])
    return dict(found)
