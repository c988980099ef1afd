"""Dense point trajectories: structure, seeding, linking, pruning, subsampling."""

from __future__ import annotations

from typing import TYPE_CHECKING

from kt3dmoseg.registry import lazy
from kt3dmoseg.tracking.options import RELIABLE, TrackOptions

if TYPE_CHECKING:
    from kt3dmoseg.tracking.cuts import find_cuts as find_cuts
    from kt3dmoseg.tracking.point_trackers import create_tracker as create_tracker
    from kt3dmoseg.tracking.tracker import Progress as Progress
    from kt3dmoseg.tracking.tracker import subsample_background as subsample_background
    from kt3dmoseg.tracking.tracker import track as track
    from kt3dmoseg.tracking.tracker import track_clip as track_clip

ALGORITHM_VERSION = 1
"""Raised when the same frames and flow give other tracks."""

# Imported on first use: `kt3dmoseg track --help` reads the options without loading OpenCV.
_PUBLIC = dict.fromkeys(("track", "track_clip", "subsample_background", "Progress"), "tracker") | {
    "find_cuts": "cuts",
    "create_tracker": "point_trackers",
}

__all__ = ["RELIABLE", "TrackOptions", *_PUBLIC]  # noqa: PLE0604

__getattr__, __dir__ = lazy(__name__, _PUBLIC)
