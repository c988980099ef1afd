"""Hopkins155 and its additional sequences: one ``<sequence>_truth.mat`` each.

`y` (3, P, F) homogeneous pixels, `x` = inv(K) y, `s` (P, 1) the motions from 1, `K` (3, 3) the matrix
that normalised them, `width` and `height` of the images, `points` = P, `frames` = F
(Tron and Vidal, CVPR 2007). The additional sequences, Hopkins12 among them, carry a mask `m` (P, F),
1 where a point is visible, and label outliers 0; without it the trajectories are complete.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.files import sha256_file
from kt3dmoseg.io.mat5 import Value, read_mat
from kt3dmoseg.io.text import clip_name
from kt3dmoseg.types import Camera, Clip, Labels, Trajectories

_NEEDED = ("y", "s", "K", "width", "height")


def is_hopkins(variables: dict[str, Value]) -> bool:
    """Whether the variables of a MAT-file are those of a Hopkins155 sequence."""
    return {"y", "s"} <= set(variables)


def read(path: str | os.PathLike[str], variables: dict[str, Value] | None = None) -> Clip:
    """Read a Hopkins155 sequence.

    Parameters
    ----------
    path : path
        A ``_truth.mat`` file; the clip takes its name.
    variables : dict, optional
        What `read_mat` gave, when it has been called already.

    Returns
    -------
    Clip
        `y` in pixels, every row evaluated, ``camera.K`` the file's K.

    Raises
    ------
    FileFormatError
        When a variable is missing or has another shape.
    """
    where = os.fspath(path)
    content = read_mat(path) if variables is None else variables
    arrays = {name: _array(where, content, name) for name in _NEEDED}
    y = arrays["y"]
    if y.ndim == 2:
        y = y[..., None]
    if y.ndim != 3 or len(y) != 3:
        raise FileFormatError(f"{where}: y", expected="3 x P x F numbers", found=f"shape {y.shape}")
    visible = _mask(where, content, y.shape[1:])
    if not (np.isfinite(y[:, visible]).all() and (y[2, visible] == 1).all()):
        raise FileFormatError(f"{where}: y", expected="finite (x, y, 1) where visible", found="others")
    xy = np.where(visible[..., None], np.moveaxis(y[:2], 0, -1), np.nan)
    for name, size in (("s", xy.shape[0]), ("K", 9), ("width", 1), ("height", 1)):
        if arrays[name].size != size:
            found = f"{arrays[name].size}"
            raise FileFormatError(f"{where}: {name}", expected=f"{size} numbers", found=found)
    return Clip(
        name=clip_name(path),
        dense=Trajectories(
            xy,
            visible,
            image_size=(arrays["width"].item(), arrays["height"].item()),
        ),
        evaluated=np.arange(len(xy)),
        labels=Labels(_labels(where, arrays["s"])),
        camera=Camera(K=arrays["K"].reshape(3, 3)),
        provenance={"format": "hopkins155", "source": Path(path).name, "sha256": sha256_file(path)},
    )


def _array(where: str, variables: dict[str, Value], name: str) -> npt.NDArray[Any]:
    value = variables.get(name)
    if not isinstance(value, np.ndarray):
        raise FileFormatError(
            f"{where}: {name}",
            expected="an array, as in every Hopkins155 _truth.mat",
            found=f"variables {', '.join(sorted(variables))}" if value is None else type(value).__name__,
        )
    return value.astype(np.float64)


def _mask(where: str, variables: dict[str, Value], shape: tuple[int, ...]) -> npt.NDArray[np.bool_]:
    if "m" not in variables:
        return np.ones(shape, dtype=np.bool_)
    mask = _array(where, variables, "m")
    if mask.shape != shape or not np.isin(mask, (0, 1)).all():
        raise FileFormatError(f"{where}: m", expected=f"0 or 1, {shape}", found=f"shape {mask.shape}")
    return mask.astype(np.bool_)


def _labels(where: str, values: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
    if not np.isin(values, np.arange(1000)).all():
        raise FileFormatError(f"{where}: s", expected="whole numbers 0..999", found="others")
    return values.ravel().astype(np.int64)
