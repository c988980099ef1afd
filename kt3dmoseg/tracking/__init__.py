"""Dense point trajectories: structure, seeding, linking, pruning, subsampling."""

from typing import TYPE_CHECKING

from kt3dmoseg.registry import lazy

if TYPE_CHECKING:
    from kt3dmoseg.tracking.cuts import find_cuts as find_cuts
    from kt3dmoseg.tracking.options import RELIABLE as RELIABLE
    from kt3dmoseg.tracking.options import TrackOptions as TrackOptions
    from kt3dmoseg.tracking.point_trackers import create_tracker as create_tracker
    from kt3dmoseg.tracking.tracker import Progress as Progress
    from kt3dmoseg.tracking.tracker import subsample_background as subsample_background
    from kt3dmoseg.tracking.tracker import track as track
    from kt3dmoseg.tracking.tracker import track_clip as track_clip
else:  # `kt3dmoseg track --help` reads the options without loading OpenCV
    __getattr__, __dir__, __all__ = lazy(__name__)

ALGORITHM_VERSION = 1
"""Raised when the same frames and flow give other tracks."""
