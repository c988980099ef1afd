"""What a built clip depends on, kept in its file's provenance: equal inputs, equal bytes."""

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
from kt3dmoseg.io import hdf5
from kt3dmoseg.pipeline.options import Settings

_LIBRARIES = ("numpy", "scipy", "h5py")


def inputs_of(
    name: str, source: Mapping[str, Any], labels: Mapping[str, str], settings: Settings, flow: Flow
) -> dict[str, Any]:
    """Everything that the bytes of a built clip depend on, as JSON values.

    `source` describes its frames, `labels` holds the sha256 of what labels it; a null flow means a
    backend that depends on more than its parameters.
    """
    return {
        "name": name,
        "source": dict(source),
        "labels": dict(labels),
        "options": settings.as_dict(),
        "flow": backend_identity(flow),
        "versions": {"kt3dmoseg": kt3dmoseg.__version__} | _libraries(),
        "algorithms": {"tracking": tracking.ALGORITHM_VERSION, "pipeline": pipeline.ALGORITHM_VERSION},
    }


def why_build(target: Path, wanted: Mapping[str, Any], *, force: bool = False) -> str:
    """Explain why a clip's file must be written, or why anyway by `force`; empty when it is up to date.

    Raises
    ------
    InputFileError
        For an intact clip that no build has made, unless forced: it may be the only copy.
    """
    if not target.exists():
        return "new"
    try:
        provenance = hdf5.provenance(target)
    except KT3DMoSegError as error:
        return f"the file there is no intact clip ({error})"
    found = provenance.get("inputs", provenance.get("fingerprint"))  # its name in 0.1.0
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
        return "the fields of this flow backend may depend on more than its parameters"
    changes = list(_differences(found, wanted, ""))
    if force and not changes:
        return "asked for"
    return "; ".join(changes[:3]) + (f"; {len(changes) - 3} more changes" if len(changes) > 3 else "")


def _differences(old: object, new: object, where: str) -> Iterator[str]:
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for key in sorted({*old, *new}):
            yield from _differences(old.get(key), new.get(key), f"{where} {key}".strip())
    elif old is None or new is None:
        if old is not new:
            yield f"{where} {'added' if old is None else 'removed'}"
    elif old != new:
        checksum = where.startswith("labels") or where.endswith("sha256")
        yield f"{where} changed" if checksum else f"{where} was {old!r}, now {new!r}"


@cache
def _libraries() -> dict[str, str]:
    return {"opencv": cv2.__version__} | {name: version(name) for name in _LIBRARIES}
