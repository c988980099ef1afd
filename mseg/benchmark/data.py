"""Where the clips of a benchmark lie."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from kt3dmoseg.errors import InputFileError
from kt3dmoseg.io import dataset_paths
from mseg.evaluation import Protocol

VARIABLE = "KT3DMOSEG_DATA"
_SHARED = Path("..") / "shared" / "data"
# MTPV62 takes 50 of its 62 clips from Hopkins155.
_BORROWED = {"mtpv62": ("hopkins155",)}


def find_clips(
    protocol: Protocol, data: Sequence[str | os.PathLike[str]] = ()
) -> tuple[dict[str, Path], list[str]]:
    """Find the clips of a benchmark.

    Parameters
    ----------
    protocol : Protocol
        The benchmark.
    data : sequence of paths
        Folders of clips; of clips of one name the first counts. By default the folder that the
        protocol names (and for MTPV62 that of Hopkins155) in ``$KT3DMOSEG_DATA``, or else in
        ``../shared/data``.

    Returns
    -------
    clips : dict of str to Path
        The clips that belong to the benchmark, sorted by name.
    others : list of str
        Names of clips that lie there and do not belong to it.

    Raises
    ------
    InputFileError
        When a folder is missing or none of its clips belongs to the benchmark.
    """
    folders = [Path(folder) for folder in data] or _default_folders(protocol)
    found: dict[str, Path] = {}
    for folder in folders:
        found = {**dataset_paths(folder), **found}
    clips = {name: found[name] for name in sorted(found) if protocol.holds(name)}
    if not clips:
        raise InputFileError(
            ", ".join(map(str, folders)), expected=f"clips of {protocol.title}", found="none"
        )
    return clips, sorted(set(found) - set(clips))


def _default_folders(protocol: Protocol) -> list[Path]:
    named = os.environ.get(VARIABLE)
    root = Path(named) if named else _SHARED
    folder = root / protocol.data
    if not folder.is_dir():
        raise InputFileError(
            str(folder), expected=f"the clips of {protocol.title}", found="no such folder",
            fix=f"give --data DIR, or set {VARIABLE} to the folder that holds {protocol.data}/",
        )  # fmt: skip
    borrowed = (root / name for name in _BORROWED.get(protocol.name, ()))
    return [folder, *(other for other in borrowed if other.is_dir())]
