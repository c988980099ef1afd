"""KITTI raw: reading drives by frame number; finding and fetching the clips' frames."""

from __future__ import annotations

from kt3dmoseg.entries import Drive
from kt3dmoseg.kitti.calibration import Calibration
from kt3dmoseg.kitti.raw import RawDrive
from kt3dmoseg.kitti.tracklets import Tracklet, TrackletBox

__all__ = ["Calibration", "Drive", "RawDrive", "Tracklet", "TrackletBox"]
