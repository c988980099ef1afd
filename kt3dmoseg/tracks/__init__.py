"""Dense point trajectories: structure, seeding, linking, pruning, subsampling."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from kt3dmoseg.tracks.options import TrackOptions

if TYPE_CHECKING:
    from kt3dmoseg.tracks.clip import track_clip as track_clip
    from kt3dmoseg.tracks.subsampling import subsample_background as subsample_background
    from kt3dmoseg.tracks.tracker import Progress as Progress
    from kt3dmoseg.tracks.tracker import track as track

# Imported on first use: `kt3dmoseg track --help` reads the options without loading OpenCV.
_PUBLIC = {
    "track": "kt3dmoseg.tracks.tracker",
    "Progress": "kt3dmoseg.tracks.tracker",
    "track_clip": "kt3dmoseg.tracks.clip",
    "subsample_background": "kt3dmoseg.tracks.subsampling",
}

__all__ = ["TrackOptions", *_PUBLIC]  # noqa: PLE0604


def __getattr__(name: str) -> Any:  # noqa: ANN401
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
