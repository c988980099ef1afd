"""How far every clip is: counted in the background, and anew only where a file has changed."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias

from kt3dmoseg.annotate.server.desk import Desk
from kt3dmoseg.errors import KT3DMoSegError

Stamp: TypeAlias = tuple[object, ...]


class Survey:
    """The progress of all clips; safe to use from several threads.

    Parameters
    ----------
    desks : mapping of str to Desk
        The clips by name.
    """

    def __init__(self, desks: Mapping[str, Desk]) -> None:
        self.desks = desks
        self._lock = threading.Lock()
        self._known: dict[str, tuple[Stamp, dict[str, Any]]] = {}
        self._worker: threading.Thread | None = None

    def clips(self) -> list[dict[str, Any]]:
        """Tell of each clip what is known by now; what is not yet is being counted.

        Returns
        -------
        list of dict
            ``name``, ``n_frames`` and ``counting``; for a counted clip ``revision``, ``annotator``,
            ``objects``, ``motions`` as far as there is an annotation, ``trajectories`` as far as
            there are any, ``counts`` where there is both; ``error`` when a file is damaged.
        """
        with self._lock:
            out = [self._entry(desk) for desk in self.desks.values()]
            if any(entry["counting"] for entry in out) and self._worker is None:
                self._worker = threading.Thread(target=self._work, daemon=True)
                self._worker.start()
        return out

    def _entry(self, desk: Desk) -> dict[str, Any]:
        stamp, told = self._known.get(desk.source.name, (None, {}))
        general = {"name": desk.source.name, "n_frames": len(desk.source.frames)}
        return general | told | {"counting": stamp != _stamp(desk)}

    def _next(self) -> Desk | None:
        with self._lock:
            waiting = (desk for desk in self.desks.values() if self._entry(desk)["counting"])
            found = next(waiting, None)
            if found is None:
                self._worker = None
            return found

    def _work(self) -> None:
        while desk := self._next():
            stamp = _stamp(desk)
            try:
                told = desk.progress()
            except KT3DMoSegError as error:
                told = {"error": str(error)}
            with self._lock:
                self._known[desk.source.name] = stamp, told


def _stamp(desk: Desk) -> Stamp:
    """Return what the count depends on: the state of the files, or that trajectories were computed."""
    tracks = _file(desk.source.tracks) if desk.source.tracks else desk.ready
    return _file(desk.source.annotation), tracks


def _file(path: Path) -> Stamp:
    try:
        status = path.stat()
    except OSError:
        return ()
    return status.st_mtime_ns, status.st_size, status.st_ino
