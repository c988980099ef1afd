"""From frames to dataset files: track, label, subsample, one HDF5 file per clip."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from kt3dmoseg.options import option
from kt3dmoseg.registry import lazy

if TYPE_CHECKING:
    from kt3dmoseg.frames import FrameFolder as FrameFolder
    from kt3dmoseg.frames import FrameSource as FrameSource
    from kt3dmoseg.frames import KittiClip as KittiClip
    from kt3dmoseg.frames import VideoFile as VideoFile
    from kt3dmoseg.frames import find_sources as find_sources
    from kt3dmoseg.frames import kitti_sources as kitti_sources
    from kt3dmoseg.frames import located_sources as located_sources
    from kt3dmoseg.pipeline.dataset import Outcome as Outcome
    from kt3dmoseg.pipeline.dataset import build_clip as build_clip
    from kt3dmoseg.pipeline.dataset import build_dataset as build_dataset
    from kt3dmoseg.pipeline.dataset import build_synthetic as build_synthetic
    from kt3dmoseg.pipeline.inputs import label_by_masks as label_by_masks
    from kt3dmoseg.synthetic.drives import SyntheticDrive as SyntheticDrive
else:  # imported on first use: the help of commands reads only the options
    __getattr__, __dir__, __all__ = lazy(__name__, "BuildOptions")

ALGORITHM_VERSION = 1
"""Raised when the same tracks and annotations or masks get other labels, or other rows are evaluated."""


@dataclass(frozen=True)
class BuildOptions:
    """From frames to a dataset file."""

    flow: str = option("dis", "optical flow backend, a name of kt3dmoseg.flow.list()", metavar="NAME")
    fraction: float = option(0.1, "share of the background that is drawn for evaluation", low=0, high=1)
    seed: int = option(0, "seed of that draw; each clip draws by its own name", low=0)
    smallest: int = option(
        1, "moving objects with fewer trajectories are not evaluated (the 2018 release: 16)", low=1
    )
    colour: Literal["refuse", "luma"] = option("refuse", "colour frames: refuse them, or take their luma")
