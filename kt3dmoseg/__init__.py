"""KT3DMoSeg: build, label and read the 3D motion segmentation dataset cut from KITTI raw."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from kt3dmoseg import build as build
    from kt3dmoseg import flow as flow
    from kt3dmoseg import kitti as kitti
    from kt3dmoseg.annotate import label_tracks as label_tracks
    from kt3dmoseg.annotate import load_annotation as load_annotation
    from kt3dmoseg.io import load as load
    from kt3dmoseg.io import load_dataset as load_dataset
    from kt3dmoseg.io import save as save
    from kt3dmoseg.tracks import track as track
    from kt3dmoseg.types import Camera as Camera
    from kt3dmoseg.types import Clip as Clip
    from kt3dmoseg.types import Labels as Labels
    from kt3dmoseg.types import Trajectories as Trajectories

# Public names and where they live; imported on first use so that `--help` stays fast.
_PUBLIC = {
    "load": "kt3dmoseg.io",
    "load_dataset": "kt3dmoseg.io",
    "save": "kt3dmoseg.io",
    "track": "kt3dmoseg.tracks",
    "load_annotation": "kt3dmoseg.annotate",
    "label_tracks": "kt3dmoseg.annotate",
    "Trajectories": "kt3dmoseg.types",
    "Labels": "kt3dmoseg.types",
    "Camera": "kt3dmoseg.types",
    "Clip": "kt3dmoseg.types",
}
_MODULES = ("build", "flow", "kitti", "errors", "types", "synthetic", "catalog")

__all__ = [*_PUBLIC, *_MODULES, "__version__"]  # noqa: PLE0604


def __getattr__(name: str) -> Any:  # noqa: ANN401
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    if name in _MODULES:
        return import_module(f"kt3dmoseg.{name}")
    raise AttributeError(f"module 'kt3dmoseg' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
