"""KITTI raw: reading drives by frame number; finding and fetching the clips' frames."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from kt3dmoseg.options import option
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

KITTI_RAW = "https://s3.eu-central-1.amazonaws.com/avg-kitti/raw_data/"


@dataclass(frozen=True)
class Origin:
    """Where the data come from, and the limits of retries."""

    retries: int = option(8, "retries of a request that makes no progress", low=0, high=100)
    timeout: float = option(30.0, "seconds of silence after which a connection is given up", low=0.05)
    wait: float = option(0.5, "seconds before the first repeat; doubles each time, up to 30 s", low=0.0)
    slowest: float = option(
        1000.0, "bytes per second below which, over one timeout, a connection is given up", low=0.0
    )
    mirror: str = option(
        KITTI_RAW, "address of KITTI's raw_data folder or of a copy with the same layout", metavar="URL"
    )
    local: str | None = option(
        None,
        "folder with _sync.zip files or extracted drives already on disk; nothing is downloaded",
        metavar="FOLDER",
    )


@dataclass(frozen=True)
class PullOptions(Origin):
    """What to fetch, and how."""

    accept_license: bool = option(False, "acknowledge the licence that is shown; stored in the target folder")
    dry_run: bool = option(False, "print the plan and stop")
    verify: bool = option(False, "re-check all bytes on disk; nothing is fetched")
    calibration: bool = option(True, "fetch the calibration of the day")
    tracklets: bool = option(True, "fetch the tracklets of drives that have them")


@dataclass(frozen=True)
class LocateOptions(Origin):
    """How to look for a clip in a drive."""

    frames: str | None = option(
        None,
        "folder with the clip's own frames (or with one folder per clip), needed for correlation",
        metavar="FOLDER",
    )
    pixels: bool = option(
        True, "read the drive's frames when checksums do not decide (all of a camera: some 40-300 MB)"
    )
