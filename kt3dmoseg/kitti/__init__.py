"""KITTI raw: reading drives by frame number; finding and fetching the clips' frames."""

from __future__ import annotations

from typing import TYPE_CHECKING

from kt3dmoseg.catalog.entries import Drive
from kt3dmoseg.kitti.calibration import Calibration
from kt3dmoseg.kitti.raw import RawDrive
from kt3dmoseg.kitti.tracklets import Tracklet, TrackletBox
from kt3dmoseg.lazy import lazy

if TYPE_CHECKING:
    from kt3dmoseg.kitti.locating import locate as locate
    from kt3dmoseg.kitti.pulling import pull as pull
    from kt3dmoseg.kitti.releases import fetch_release as fetch_release

# What needs the network stack is imported on first use.
_LAZY = {
    "fetch_release": "releases",
    "locate": "locating",
    "pull": "pulling",
}

__all__ = ["Calibration", "Drive", "RawDrive", "Tracklet", "TrackletBox", *_LAZY]  # noqa: PLE0604

__getattr__, __dir__ = lazy(__name__, _LAZY)
