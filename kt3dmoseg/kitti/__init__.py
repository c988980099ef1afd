"""KITTI raw: reading drives by frame number; finding and fetching the clips' frames."""

from typing import TYPE_CHECKING

from kt3dmoseg.registry import lazy

if TYPE_CHECKING:
    from kt3dmoseg.catalog import Drive as Drive
    from kt3dmoseg.kitti.locating import locate as locate
    from kt3dmoseg.kitti.pulling import pull as pull
    from kt3dmoseg.kitti.raw import Calibration as Calibration
    from kt3dmoseg.kitti.raw import RawDrive as RawDrive
    from kt3dmoseg.kitti.releases import fetch_release as fetch_release
    from kt3dmoseg.kitti.tracklets import Tracklet as Tracklet
    from kt3dmoseg.kitti.tracklets import TrackletBox as TrackletBox
else:  # `kt3dmoseg pull --help` reads the options without numpy and the network stack
    __getattr__, __dir__, __all__ = lazy(__name__)
