"""mseg: 3D motion segmentation of point trajectories; methods and evaluation."""

from __future__ import annotations

from typing import TYPE_CHECKING

from kt3dmoseg import __version__ as __version__
from kt3dmoseg.registry import lazy

if TYPE_CHECKING:
    from mseg import benchmark as benchmark
    from mseg import errors as errors
    from mseg import methods as methods
    from mseg import types as types
    from mseg.estimator import MotionSegmenter as MotionSegmenter
    from mseg.evaluation import score as score
    from mseg.methods import segment as segment
    from mseg.types import Hypotheses as Hypotheses
    from mseg.types import Segmentation as Segmentation
    from mseg.videos import video as video

# Public names and where they live; imported on first use so that `--help` stays fast.
_PUBLIC = {
    "segment": "methods",
    "score": "evaluation",
    "video": "videos",
    "MotionSegmenter": "estimator",
    "Segmentation": "types",
    "Hypotheses": "types",
}
_MODULES = ("methods", "benchmark", "errors", "types")

__all__ = [*_PUBLIC, *_MODULES, "__version__"]  # noqa: PLE0604

if not TYPE_CHECKING:  # a checker refuses names that do not exist
    __getattr__, __dir__ = lazy(__name__, _PUBLIC, dict(zip(_MODULES, _MODULES, strict=True)))
