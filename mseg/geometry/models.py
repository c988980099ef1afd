"""The three kinds of models as one table, so that sampling and affinities know no kind by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from kt3dmoseg.types import BoolArray, FloatArray
from mseg.geometry import fundamental, point_maps
from mseg.types import ModelKind

Distance: TypeAlias = Literal["sampson", "transfer"]
_Array: TypeAlias = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Model:
    """A kind of model between two frames.

    Parameters
    ----------
    minimal : int
        Size p of a minimal sample.
    fit : callable
        ``fit(x1 (K, p, 2), x2 (K, p, 2)) -> models (K, 3, 3), ok (K,)``; not ok = fixes no model.
    residuals : mapping of {"sampson", "transfer"} to callable
        ``residual(models (K, 3, 3), x1 (P, 2), x2 (P, 2)) -> (P, K)``: squared Sampson distances or symmetric
        transfer errors, in the units and the dtype of the points. Fundamental matrices, which map points to
        lines, have Sampson's alone.
    """

    minimal: int
    fit: Callable[[FloatArray, FloatArray], tuple[FloatArray, BoolArray]]
    residuals: Mapping[Distance, Callable[[_Array, _Array, _Array], _Array]]


MODELS: dict[ModelKind, Model] = {
    "affine": Model(
        3,
        point_maps.fit_affine,
        {"sampson": point_maps.affine_sampson, "transfer": point_maps.affine_transfer},
    ),
    "homography": Model(
        4,
        point_maps.fit_homography,
        {"sampson": point_maps.homography_sampson, "transfer": point_maps.homography_transfer},
    ),
    "fundamental": Model(
        8, fundamental.eight_point, {"sampson": fundamental.sampson, "transfer": fundamental.sampson}
    ),
}
