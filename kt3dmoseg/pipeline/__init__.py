"""From frames to dataset files: track, label, subsample, one HDF5 file per clip."""

from __future__ import annotations

from typing import TYPE_CHECKING

from kt3dmoseg.lazy import lazy
from kt3dmoseg.pipeline.options import BuildOptions

if TYPE_CHECKING:
    from kt3dmoseg.frames import FrameFolder as FrameFolder
    from kt3dmoseg.frames import KittiClip as KittiClip
    from kt3dmoseg.frames import Source as Source
    from kt3dmoseg.frames import VideoFile as VideoFile
    from kt3dmoseg.frames import find_sources as find_sources
    from kt3dmoseg.frames import kitti_sources as kitti_sources
    from kt3dmoseg.frames import located_sources as located_sources
    from kt3dmoseg.pipeline.clip import build_clip as build_clip
    from kt3dmoseg.pipeline.dataset import Outcome as Outcome
    from kt3dmoseg.pipeline.dataset import build_dataset as build_dataset
    from kt3dmoseg.pipeline.masks import label_by_masks as label_by_masks

ALGORITHM_VERSION = 1
"""Raised when the same tracks and annotations or masks get other labels, or other rows are evaluated."""

# Imported on first use: `kt3dmoseg build --help` reads the options without loading OpenCV.
_PUBLIC = {
    "build_clip": "clip",
    "build_dataset": "dataset",
    "Outcome": "dataset",
    "label_by_masks": "masks",
    **dict.fromkeys(("find_sources", "kitti_sources", "located_sources"), "kt3dmoseg.frames"),
    **dict.fromkeys(("FrameFolder", "VideoFile", "KittiClip", "Source"), "kt3dmoseg.frames"),
}

__all__ = ["BuildOptions", *_PUBLIC]  # noqa: PLE0604

__getattr__, __dir__ = lazy(__name__, _PUBLIC)
