"""From frames to dataset files: track, label, subsample, one HDF5 file per clip."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from kt3dmoseg.build.options import BuildOptions

if TYPE_CHECKING:
    from kt3dmoseg.build.clip import build_clip as build_clip
    from kt3dmoseg.build.dataset import Outcome as Outcome
    from kt3dmoseg.build.dataset import build_dataset as build_dataset
    from kt3dmoseg.build.kitti_clips import KittiClip as KittiClip
    from kt3dmoseg.build.kitti_clips import kitti_sources as kitti_sources
    from kt3dmoseg.build.kitti_clips import located_sources as located_sources
    from kt3dmoseg.build.masks import label_by_masks as label_by_masks
    from kt3dmoseg.build.shot import Source as Source
    from kt3dmoseg.build.sources import FrameFolder as FrameFolder
    from kt3dmoseg.build.sources import VideoFile as VideoFile
    from kt3dmoseg.build.sources import find_sources as find_sources

# Imported on first use: `kt3dmoseg build --help` reads the options without loading OpenCV.
_PUBLIC = {
    "build_clip": "kt3dmoseg.build.clip",
    "build_dataset": "kt3dmoseg.build.dataset",
    "Outcome": "kt3dmoseg.build.dataset",
    "find_sources": "kt3dmoseg.build.sources",
    "kitti_sources": "kt3dmoseg.build.kitti_clips",
    "located_sources": "kt3dmoseg.build.kitti_clips",
    "label_by_masks": "kt3dmoseg.build.masks",
    "FrameFolder": "kt3dmoseg.build.sources",
    "VideoFile": "kt3dmoseg.build.sources",
    "KittiClip": "kt3dmoseg.build.kitti_clips",
    "Source": "kt3dmoseg.build.shot",
}

__all__ = ["BuildOptions", *_PUBLIC]  # noqa: PLE0604


def __getattr__(name: str) -> Any:  # noqa: ANN401
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
