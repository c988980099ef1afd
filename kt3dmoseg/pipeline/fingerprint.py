"""What a built clip depends on, kept in its file: equal fingerprint, equal bytes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import cv2

import kt3dmoseg
from kt3dmoseg import pipeline, tracking
from kt3dmoseg.errors import InputFileError, KT3DMoSegError
from kt3dmoseg.flow import Flow, backend_identity
from kt3dmoseg.io.hdf5 import provenance
from kt3dmoseg.pipeline.options import Settings
from kt3dmoseg.pipeline.shot import Shot

_LIBRARIES = ("numpy", "scipy", "h5py")


def fingerprint(
    name: str, shot: Shot, settings: Settings, flow: Flow, labels: Mapping[str, str]
) -> dict[str, Any]:
    """Everything the bytes of a built clip depend on, as JSON values.

    Parameters
    ----------
    name : str
        Name of the clip.
    shot : Shot
        Its source.
    settings : Settings
        All options.
    flow : Flow
        The backend; None stands in for one whose parameters cannot be told.
    labels : mapping of str to str
        sha256 of the annotation or the masks, when there are any.
    """
    return {
        "name": name,
        "source": {**shot.description, "sha256": shot.sha256},
        "labels": dict(labels),
        "options": settings.as_dict(),
        "flow": backend_identity(flow),
        "versions": {"kt3dmoseg": kt3dmoseg.__version__} | _libraries(),
        "algorithms": {"tracking": tracking.ALGORITHM_VERSION, "pipeline": pipeline.ALGORITHM_VERSION},
    }


def why_build(target: Path, wanted: Mapping[str, Any], *, force: bool = False) -> str:
    """Say why a clip's file must be written; empty when it is up to date.

    Parameters
    ----------
    target : Path
        The file, whether it exists or not.
    wanted : mapping
        The `fingerprint` that it should have.
    force : bool
        It is written in any case.

    Raises
    ------
    InputFileError
        For a sound clip that no build has made, unless forced: it may be the only copy.
    """
    if not target.exists():
        return "new"
    try:
        found = provenance(target).get("fingerprint")
    except KT3DMoSegError as error:
        return f"the file there is no sound clip ({error})"
    if not isinstance(found, dict):
        if force:
            return "asked for"
        raise InputFileError(
            f"{target}",
            expected="no file, or a clip that was built from frames",
            found="another clip",
            fix="give another output folder, or --force to write over it",
        )
    if wanted["flow"] is None:
        return "this flow backend does not tell what its fields depend on"
    changes = list(_differences(found, dict(wanted), ""))
    if force and not changes:
        return "asked for"
    return "; ".join(changes[:3]) + (f"; {len(changes) - 3} more changes" if len(changes) > 3 else "")


def _differences(old: object, new: object, where: str) -> Iterator[str]:
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted({*old, *new}):
            yield from _differences(old.get(key), new.get(key), f"{where} {key}".strip())
    elif old != new:
        yield _change(where, old, new)


def _change(where: str, old: object, new: object) -> str:
    if old is None or new is None:
        return f"{where} {'added' if old is None else 'removed'}"
    if where.startswith("labels") or where.endswith(("sha256", "source")):
        return f"{where} changed"
    return f"{where} was {old!r}, now {new!r}"


@cache
def _libraries() -> dict[str, str]:
    return {"opencv": cv2.__version__} | {name: version(name) for name in _LIBRARIES}
