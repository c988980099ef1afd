"""KITTI raw: reading drives by frame number; finding and fetching the clips' frames."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from kt3dmoseg.entries import Drive
from kt3dmoseg.kitti.calibration import Calibration
from kt3dmoseg.kitti.raw import RawDrive
from kt3dmoseg.kitti.tracklets import Tracklet, TrackletBox

if TYPE_CHECKING:
    from kt3dmoseg.kitti.locating import locate as locate
    from kt3dmoseg.kitti.pulling import pull as pull
    from kt3dmoseg.kitti.releases import fetch_release as fetch_release

# What needs the network stack is imported on first use.
_LAZY = {
    "fetch_release": "kt3dmoseg.kitti.releases",
    "locate": "kt3dmoseg.kitti.locating",
    "pull": "kt3dmoseg.kitti.pulling",
}

__all__ = ["Calibration", "Drive", "RawDrive", "Tracklet", "TrackletBox", *_LAZY]  # noqa: PLE0604


def __getattr__(name: str) -> Any:  # noqa: ANN401
    if name in _LAZY:
        return getattr(import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'kt3dmoseg.kitti' has no attribute {name!r}")
