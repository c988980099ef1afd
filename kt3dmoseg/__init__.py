"""KT3DMoSeg: build, label and read the 3D motion segmentation dataset cut from KITTI raw."""

from __future__ import annotations

from typing import TYPE_CHECKING

from kt3dmoseg.registry import lazy

__version__ = "0.1.0"

if TYPE_CHECKING:
    from kt3dmoseg import catalog, errors, flow, kitti, pipeline, synthetic, tracking, types
    from kt3dmoseg.annotate import label_tracks, load_annotation
    from kt3dmoseg.choosing import choose
    from kt3dmoseg.io import load, load_dataset, save
    from kt3dmoseg.publishing import diff, publish
    from kt3dmoseg.tracking import track
    from kt3dmoseg.types import Camera, Clip, Labels, Trajectories
    from kt3dmoseg.viewing import label, show

__all__ = ["load", "load_dataset", "save", "track", "load_annotation", "label_tracks", "show", "label"]
__all__ += ["choose", "publish", "diff"]
__all__ += ["Trajectories", "Labels", "Camera", "Clip", "__version__"]
__all__ += ["pipeline", "tracking", "flow", "kitti", "errors", "types", "synthetic", "catalog"]

# Where the public names live; imported on first use so that `--help` stays fast.
_NAMES = dict.fromkeys(("load", "load_dataset", "save"), "io") | {"track": "tracking"}
_NAMES |= dict.fromkeys(("load_annotation", "label_tracks"), "annotate")
_NAMES |= dict.fromkeys(("show", "label"), "viewing")
_NAMES |= {"choose": "choosing", "publish": "publishing", "diff": "publishing"}
_NAMES |= dict.fromkeys(("Trajectories", "Labels", "Camera", "Clip"), "types")
_MODULES = ("pipeline", "tracking", "flow", "kitti", "errors", "types", "synthetic", "catalog")
_FORMER = {"build": "pipeline", "tracks": "tracking"}  # names of 0.1.0

if not TYPE_CHECKING:  # a checker refuses names that do not exist
    __getattr__, __dir__ = lazy(__name__, _NAMES, dict(zip(_MODULES, _MODULES, strict=True)) | _FORMER)
