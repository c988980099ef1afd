"""Hopkins155 and its additional sequences: one ``<sequence>_truth.mat`` each.

`y` (3, P, F) homogeneous pixels, `x` = inv(K) y, `s` (P, 1) the motions from 1, `K` (3, 3) the matrix
that normalised them, `width` and `height` of the images, `points` = P, `frames` = F
(Tron and Vidal, CVPR 2007). The additional sequences, Hopkins12 among them, carry a mask `m` (P, F),
1 where a point is visible, and label outliers 0; without it the trajectories are complete.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from kt3dmoseg.io.fields import Fields, clip_name, origin
from kt3dmoseg.types import BoolArray, Camera, Clip, Labels, Trajectories


def read(path: str | os.PathLike[str], variables: Mapping[str, Any]) -> Clip:
    """Read a Hopkins155 sequence.

    Parameters
    ----------
    path : path
        A ``_truth.mat`` file; the clip takes its name.
    variables : mapping of str to value
        What `matlab.read_mat` gives of it.

    Returns
    -------
    Clip
        `y` in pixels, every row evaluated, ``camera.K`` the file's K.

    Raises
    ------
    FileFormatError
        When a variable is missing or has another shape.
    """
    fields = Fields(f"{os.fspath(path)}: ", variables)
    y = fields.array("y", (3, None, None)).astype(np.float64)
    visible = _mask(fields, y.shape[1:])
    if not (np.isfinite(y[:, visible]).all() and (y[2, visible] == 1).all()):
        raise fields.error("y", "finite (x, y, 1) where visible", "others")
    n = y.shape[1]
    for name, size in (("s", n), ("K", 9), ("width", 1), ("height", 1)):
        if fields.array(name).size != size:
            raise fields.error(name, f"{size} numbers", f"{fields.array(name).size}")
    return Clip(
        name=clip_name(path),
        dense=Trajectories(
            np.where(visible[..., None], np.moveaxis(y[:2], 0, -1), np.nan),
            visible,
            image_size=(fields.array("width").item(), fields.array("height").item()),
        ),
        evaluated=np.arange(n),
        labels=Labels(fields.whole("s", None, 0, 999)),
        camera=Camera(K=fields.array("K").reshape(3, 3)),
        provenance=origin(path, "hopkins155"),
    )


def _mask(fields: Fields, shape: tuple[int, ...]) -> BoolArray:
    if "m" not in fields:
        return np.ones(shape, dtype=np.bool_)
    mask = fields.array("m", shape)
    if not np.isin(mask, (0, 1)).all():
        raise fields.error("m", f"0 or 1, {shape}", "others")
    return mask.astype(np.bool_)
