"""Where new trajectories start: free, structured cells of a grid."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from kt3dmoseg.tracking.options import TrackOptions
from kt3dmoseg.tracking.structure import structured
from kt3dmoseg.types import ByteArray, FloatArray


def grid(height: int, width: int, options: TrackOptions) -> FloatArray:
    """Seed grid: offset, offset + spacing, ..., strictly inside the frame less the offset.

    Returns
    -------
    (G, 2) float64
        (x, y), row by row.
    """
    x = np.arange(options.offset, width - options.offset, options.spacing, dtype=np.float64)
    y = np.arange(options.offset, height - options.offset, options.spacing, dtype=np.float64)
    return np.stack([np.tile(x, len(y)), np.repeat(y, len(x))], axis=1)


def uncovered(cells: FloatArray, live: FloatArray, radius: float) -> FloatArray:
    """Keep the cells (G, 2) that no live trajectory (L, 2) is closer to than `radius`.

    Live positions are truncated to whole pixels first: so the release's start cells come out.
    """
    if not len(live) or not len(cells):
        return cells
    tree = cKDTree(np.trunc(live), compact_nodes=False, balanced_tree=False)
    nearest, _ = tree.query(cells, distance_upper_bound=radius + 1)
    return cells[nearest >= radius]


def new_seeds(frame: ByteArray, live: FloatArray, options: TrackOptions) -> FloatArray:
    """Start points of a frame.

    Parameters
    ----------
    frame : (H, W) uint8
        The frame.
    live : (L, 2) float64
        Positions of the trajectories that are alive in it.
    options : TrackOptions
        Grid, coverage and structure.

    Returns
    -------
    (S, 2) float64
    """
    height, width = frame.shape
    cells = grid(height, width, options)
    column, row = cells.astype(np.intp).T
    return uncovered(cells[structured(frame, options)[row, column]], live, options.coverage)
