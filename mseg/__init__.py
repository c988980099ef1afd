"""mseg: 3D motion segmentation of point trajectories; methods and evaluation."""

from typing import TYPE_CHECKING

from kt3dmoseg import __version__ as __version__
from kt3dmoseg.registry import lazy

if TYPE_CHECKING:
    from mseg import benchmark as benchmark
    from mseg import errors as errors
    from mseg import evaluation as evaluation
    from mseg import methods as methods
    from mseg import types as types
    from mseg.estimator import MotionSegmenter as MotionSegmenter
    from mseg.evaluation import compare as compare
    from mseg.evaluation import score as score
    from mseg.methods import segment as segment
    from mseg.types import Hypotheses as Hypotheses
    from mseg.types import Segmentation as Segmentation
    from mseg.videos import video as video
else:  # imported on first use, so that `--help` stays fast
    __getattr__, __dir__, __all__ = lazy(__name__, "__version__")
