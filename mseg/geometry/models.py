"""The three kinds of models as one table, so that sampling and affinities know no kind by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import BoolArray, FloatArray
from mseg.geometry import affine, fundamental, hartley, homography
from mseg.types import ModelKind

Distance: TypeAlias = Literal["sampson", "transfer"]
_Array = npt.NDArray[Any]

_Fit: TypeAlias = Callable[[FloatArray, FloatArray], tuple[FloatArray, BoolArray]]
_Residual: TypeAlias = Callable[[_Array, _Array, _Array], _Array]


@dataclass(frozen=True)
class Model:
    """What there is to know about a kind of model.

    Parameters
    ----------
    minimal : int
        Size of a minimal sample.
    fit : callable
        ``fit(x1 (K, p, 2), x2 (K, p, 2)) -> models (K, 3, 3), ok (K,)``.
    fit_together : callable
        The same for samples of points that are normalised together already.
    sampson : callable
        ``sampson(models (K, 3, 3), x1 (P, 2), x2 (P, 2)) -> (P, K)`` squared Sampson distances.
    transfer : callable or None
        Squared symmetric transfer errors, likewise; None where points map to lines.
    maps_points : bool
        Whether a model maps points to points (x2 ~ M x1) or to lines (x2^T M x1 = 0).
    """

    minimal: int
    fit: _Fit
    fit_together: _Fit
    sampson: _Residual
    transfer: _Residual | None
    maps_points: bool


MODELS: dict[ModelKind, Model] = {
    "affine": Model(affine.MINIMAL, affine.fit, affine.fit, affine.sampson, affine.symmetric_transfer, True),
    "homography": Model(
        homography.MINIMAL,
        homography.fit,
        homography.fit,
        homography.sampson,
        homography.symmetric_transfer,
        True,
    ),
    "fundamental": Model(
        fundamental.MINIMAL, fundamental.fit, fundamental.eight_point, fundamental.sampson, None, False
    ),
}


def residuals(
    kind: ModelKind, models: _Array, x1: _Array, x2: _Array, *, distance: Distance = "sampson"
) -> _Array:
    """Squared residuals (P, K) of correspondences to models.

    Parameters
    ----------
    kind : {"affine", "homography", "fundamental"}
        Kind of the models.
    models : (K, 3, 3) float
        Models in the coordinates of the points.
    x1, x2 : (P, 2) float
        Corresponding points; their dtype is that of the result.
    distance : {"sampson", "transfer"}
        Sampson distance, or symmetric transfer error where the kind has one (fundamental matrices
        keep Sampson's).

    Raises
    ------
    InvalidValueError
        When shapes disagree.
    """
    if models.shape[1:] != (3, 3) or x1.shape != x2.shape or x1.shape[1:] != (2,):
        raise InvalidValueError(
            "residuals",
            expected="models (K, 3, 3), x1 and x2 (P, 2)",
            found=f"{models.shape}, {x1.shape} and {x2.shape}",
        )
    model = MODELS[kind]
    measure = model.transfer if distance == "transfer" and model.transfer else model.sampson
    return measure(models, x1, x2)


def change_frame(kind: ModelKind, models: FloatArray, t1: FloatArray, t2: FloatArray) -> FloatArray:
    """Express models in new image coordinates T1 x1 and T2 x2 (similarities, one or one per model).

    Homographies and fundamental matrices come out with Frobenius norm 1, affine maps with (0 0 1).
    """
    back = hartley.inverse(t1)
    if MODELS[kind].maps_points:
        moved = hartley.after(t2, hartley.before(models, back))
    else:
        forward = hartley.before(models, back)
        moved = np.swapaxes(hartley.before(np.swapaxes(forward, -1, -2), hartley.inverse(t2)), -1, -2)
    if kind == "affine":
        return moved
    size = np.linalg.norm(moved, axis=(1, 2), keepdims=True)
    out: FloatArray = moved / np.where(size > 0, size, 1.0)
    return out
