"""Trajectories that lie near each other and move alike: what one region may hold."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from kt3dmoseg.types import BoolArray, IntArray, Trajectories

# Trajectories of one object have neighbours on it within this many pixels, and differ in their steps over
# `_ALIKE_GAP` frames by less than one pixel and this share, in this share of the frames.
_REACH = 26.0
_SAME_MOTION = 0.25
_ALIKE_GAP = 2
_SHARE = 0.6
_SMALLEST = 12


def groups(tracks: Trajectories, rows: IntArray) -> list[IntArray]:
    """Part rows into groups of near ones that move alike, the largest first; small groups are left out."""
    pairs = near_pairs(tracks, rows)
    return connected(pairs[alike(tracks, pairs)], rows, _SMALLEST)


def connected(pairs: IntArray, rows: IntArray, smallest: int) -> list[IntArray]:
    """Part rows into those that pairs (P, 2) of them connect, the largest first; small parts are left out."""
    size = 1 + int(max(rows.max(initial=0), pairs.max(initial=0)))
    links = coo_array((np.ones(len(pairs)), pairs.T), shape=(size, size))
    group = connected_components(links, directed=False)[1][rows]
    names, sizes = np.unique(group, return_counts=True)
    large = [k for k in np.argsort(-sizes, kind="stable") if sizes[k] >= smallest]
    return [rows[group == names[k]] for k in large]


def near_pairs(tracks: Trajectories, rows: IntArray) -> IntArray:
    """Pairs (P, 2) of the rows that come near each other in some frame."""
    size = 1 + int(rows.max(initial=0))
    found = [np.zeros(0, dtype=np.int64)]
    for frame in range(tracks.n_frames):
        here = rows[tracks.visible[rows, frame]]
        if len(here) > 1:
            near = here[cKDTree(tracks.xy[here, frame]).query_pairs(_REACH, output_type="ndarray")]
            found.append(near[:, 0] * size + near[:, 1])  # one number each: rows of two are sorted slowly
    return np.stack(np.divmod(np.unique(np.concatenate(found)), size), axis=1)


def alike(tracks: Trajectories, pairs: IntArray, strictness: float = 1.0) -> BoolArray:
    """Whether the two of each pair move alike in most of the frames that show both, (P,)."""
    gap = min(_ALIKE_GAP, tracks.n_frames - 1)
    step = tracks.xy[:, gap:] - tracks.xy[:, : tracks.n_frames - gap]
    a, b = step[pairs[:, 0]], step[pairs[:, 1]]
    apart = np.linalg.norm(a - b, axis=2) * strictness
    longer = np.maximum(np.linalg.norm(a, axis=2), np.linalg.norm(b, axis=2))
    with np.errstate(invalid="ignore"):
        alike = (apart <= 1.0 + _SAME_MOTION * longer).sum(axis=1)
    return np.asarray(alike >= np.maximum(_SHARE * np.isfinite(apart).sum(axis=1), 1))
