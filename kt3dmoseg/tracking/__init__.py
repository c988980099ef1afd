"""Dense point trajectories: every constant with its source, seeding, linking, pruning, subsampling."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, ClassVar

from kt3dmoseg.options import Preset, option
from kt3dmoseg.registry import lazy

if TYPE_CHECKING:
    from kt3dmoseg.tracking.cuts import find_cuts as find_cuts
    from kt3dmoseg.tracking.point_trackers import create_tracker as create_tracker
    from kt3dmoseg.tracking.tracker import Progress as Progress
    from kt3dmoseg.tracking.tracker import subsample_background as subsample_background
    from kt3dmoseg.tracking.tracker import track as track
    from kt3dmoseg.tracking.tracker import track_clip as track_clip
else:  # `kt3dmoseg track --help` reads the options without loading OpenCV
    __getattr__, __dir__, __all__ = lazy(__name__, "RELIABLE", "TrackOptions")

ALGORITHM_VERSION = 1
"""Raised when the same frames and flow give other tracks."""

RELIABLE: Mapping[str, float] = MappingProxyType(
    {"anchor": 1.0, "appearance": 0.18, "consistency": 1e-4, "consistency_floor": 0.02}
)
"""What `reliable` means: tracks that are anchored, and stopped where in doubt.

The defaults make tracks like the release's, which drift. What each kind reaches: docs/tracking.md.
"""


@dataclass(frozen=True)
class TrackOptions:
    """How trajectories start, stop and are kept; the defaults reproduce the 2018 release.

    The algorithm is that of Sundaram, Brox and Keutzer, "Dense point trajectories by GPU-accelerated
    large displacement optical flow", ECCV 2010, section 2 (SBK below). Constants that differ from theirs
    were found by comparing with the released trajectories (docs/tracking.md). The comparison of patches
    with their start (`anchor`, `appearance` and what belongs to them) is not the release's but after Shi
    and Tomasi, CVPR 1994, and Baker and Matthews, IJCV 2004; measured on synthetic drives.
    """

    spacing: int = option(8, "distance of the seed grid's points in pixels (SBK: every 8th pixel)", low=1)
    offset: int = option(4, "first seed and free border in pixels: x, y = 4, 12, 20, ...", low=0)
    coverage: float = option(8.0, "a cell is covered where a trajectory is nearer than this, in px", low=0)
    presmoothing: float = option(
        0.8, "sigma of the smoothing before the structure tensor, px", low=0, high=10
    )
    integration: float = option(1.0, "sigma of the smoothing of the structure tensor, px", low=0, high=10)
    structure: float = option(0.1, "least smaller eigenvalue, as a fraction of its mean (SBK eq. 3)", low=0)
    border_gain: float = option(1.0, "added to it at the border: gain * exp(-decay * distance)", low=0)
    border_decay: float = option(0.1, "its decay per pixel", low=0)
    consistency: float = option(
        0.004, "stop when |w + w'|^2 >= this * (|w|^2 + |w'|^2) + floor (SBK eq. 5: 0.01)", low=0
    )
    consistency_floor: float = option(
        0.2, "the floor, in pixels squared (SBK eq. 5: 0.5)", low=0, high=math.inf
    )
    boundary: float = option(
        0.01, "stop if |grad u|^2 + |grad v|^2 > this * |w|^2 + floor (SBK eq. 6)", low=0
    )
    boundary_floor: float = option(0.002, "the floor (SBK eq. 6)", low=0, high=math.inf)
    anchor: float = option(0.0, "largest correction of a step by its patch's start, px; 0: none", low=0)
    anchor_change: float = option(
        0.3, "only where the patch's mean squared change is then <= this * its variance + floor", low=0
    )
    anchor_gain: float = option(1.0, "share of the correction that is applied, 0 to 1", low=0, high=1)
    anchor_scale: float = option(10.0, "scale of the registration's robust error, gray values", low=0.1)
    anchor_stiffness: float = option(300.0, "how hard the patch is to deform, gray values squared", low=0)
    patch_radius: int = option(6, "radius of the patches in pixels", low=1)
    appearance: float = option(
        0.0, "stop when the patch's mean squared change > this * its variance + floor; 0: never", low=0
    )
    appearance_floor: float = option(9.0, "the floor of both, in gray values squared", low=0, high=math.inf)
    min_length: int = option(5, "shorter trajectories are dropped, in frames", low=1)

    everyday: ClassVar[tuple[str, ...]] = ("spacing", "consistency", "anchor", "appearance", "min_length")
    presets: ClassVar[Mapping[str, Preset]] = MappingProxyType(
        {"reliable": Preset("fewer tracks, which do not drift, instead of ones like the release's", RELIABLE)}
    )
