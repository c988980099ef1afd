"""From frames to dataset files: track, label, subsample, one HDF5 file per clip."""

from __future__ import annotations

from kt3dmoseg.build.clip import build_clip
from kt3dmoseg.build.dataset import Outcome, build_dataset
from kt3dmoseg.build.kitti_clips import KittiClip, kitti_sources
from kt3dmoseg.build.masks import label_by_masks
from kt3dmoseg.build.options import BuildOptions
from kt3dmoseg.build.shot import Source
from kt3dmoseg.build.sources import FrameFolder, VideoFile, find_sources

__all__ = [
    "BuildOptions",
    "FrameFolder",
    "KittiClip",
    "Outcome",
    "Source",
    "VideoFile",
    "build_clip",
    "build_dataset",
    "find_sources",
    "kitti_sources",
    "label_by_masks",
]
