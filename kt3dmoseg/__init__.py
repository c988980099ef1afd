"""KT3DMoSeg: build, label and read the 3D motion segmentation dataset cut from KITTI raw."""

from typing import TYPE_CHECKING

from kt3dmoseg.registry import lazy

__version__ = "0.1.0"

if TYPE_CHECKING:
    from kt3dmoseg import catalog as catalog
    from kt3dmoseg import errors as errors
    from kt3dmoseg import flow as flow
    from kt3dmoseg import kitti as kitti
    from kt3dmoseg import pipeline as pipeline
    from kt3dmoseg import synthetic as synthetic
    from kt3dmoseg import tracking as tracking
    from kt3dmoseg import types as types
    from kt3dmoseg.annotate import label_tracks as label_tracks
    from kt3dmoseg.annotate import load_annotation as load_annotation
    from kt3dmoseg.choosing import choose as choose
    from kt3dmoseg.io import load as load
    from kt3dmoseg.io import load_dataset as load_dataset
    from kt3dmoseg.io import save as save
    from kt3dmoseg.publishing import diff as diff
    from kt3dmoseg.publishing import publish as publish
    from kt3dmoseg.tracking import track as track
    from kt3dmoseg.types import Camera as Camera
    from kt3dmoseg.types import Clip as Clip
    from kt3dmoseg.types import Labels as Labels
    from kt3dmoseg.types import Trajectories as Trajectories
    from kt3dmoseg.viewing import label as label
    from kt3dmoseg.viewing import show as show
else:  # imported on first use, so that `--help` stays fast
    __getattr__, __dir__, __all__ = lazy(__name__, "__version__")
