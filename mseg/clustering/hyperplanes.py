"""Groups of points of which each has a hyperplane in every view: merging, reassigning, describing them.

Views come as from `whiten`: (V, D, N), zero columns where a view does not see a point.
"""

from __future__ import annotations

import numpy as np

from kt3dmoseg.types import FloatArray, IntArray

_RELATIVE_FLOOR = 1e-3
# Squared distances under this are noise; those of whitened points at random are 1 / D.
_PRECISION = 1e-3


def whiten(view: FloatArray) -> FloatArray:
    """Coordinates in which the seen points scatter alike in all directions, each at unit length.

    A hyperplane stays one under a linear map. What tells two motions apart, however, is small beside what
    tells two places of the image apart; here both count alike. Directions under a thousandth of the widest
    are noise and are not drawn out further.

    Parameters
    ----------
    view : (D, N) float64
        Points as columns; zero where not seen, and still so in what returns.
    """
    left, values, _ = np.linalg.svd(view, full_matrices=False)
    scaled = (left.T @ view) / np.hypot(values, _RELATIVE_FLOOR * values[0])[:, None]
    length = np.linalg.norm(scaled, axis=0)
    return np.asarray(np.divide(scaled, length, out=np.zeros_like(scaled), where=length > 0))


def merge_by_hyperplanes(views: FloatArray, groups: IntArray, count: int) -> IntArray:
    """Merge two groups at a time, those that one hyperplane per view serves best.

    With S_a the second moments of group a in a view, the least eigenvalue of S_a is the squared error of
    its best hyperplane through the origin. The two groups merge for which the increase
    ``lambda(S_a + S_b) - lambda(S_a) - lambda(S_b)``, summed over the views that see both, is least per
    point and view.

    Parameters
    ----------
    views : (V, D, N) float64
        Whitened points.
    groups : (N,) int64
        Labels 1..L.
    count : int
        Number of groups wanted; L stay if it is larger.

    Returns
    -------
    (N,) int64
        Labels 1..min(L, count).

    Notes
    -----
    Merging one group into another adds their moments, so that after one pass over the points, O(V N D^2),
    a merge costs O(L^2 V D^3).
    """
    labels, owner = np.unique(groups, return_inverse=True)
    moments = np.stack([_moments(views[:, :, owner == group]) for group in range(len(labels))])
    merged = np.arange(len(labels))
    while len(moments) > count:
        into, gone = sorted(divmod(int(_increase(moments).argmin()), len(moments)))
        moments[into] += moments[gone]
        moments = np.delete(moments, gone, axis=0)
        merged[merged == gone] = into
        merged[merged > gone] -= 1
    return np.asarray(merged[owner] + 1)


def reassign_by_hyperplanes(views: FloatArray, labels: IntArray, sweeps: int) -> IntArray:
    """Give every point to the group in whose hyperplanes it is likeliest, until nothing changes.

    The distance from a group's hyperplane is taken for Gaussian with the group's own variance; the
    logarithms are averaged over the views that see the point and at least D points of the group.

    Parameters
    ----------
    views : (V, D, N) float64
        Whitened points.
    labels : (N,) int64
        Groups 1..K.
    sweeps : int
        Cap on repetitions.

    Returns
    -------
    (N,) int64
        Labels 1..K; points that nothing is known about keep theirs.
    """
    for _ in range(sweeps):
        nats = np.array([_mean_nats(views, labels == k) for k in range(1, int(labels.max()) + 1)])
        known = np.isfinite(nats).any(axis=0)
        before, labels = labels, np.where(known, nats.argmin(axis=0) + 1, labels)
        if np.array_equal(before, labels):
            break
    return labels


def hyperplane_code_length(views: FloatArray, labels: IntArray) -> float:
    """Nats that describe the distances of points (V, D, N) from their groups' hyperplanes, and the groups.

    For n of N points ``n (1/2 sum_v log lambda_v - log(n / N))`` with lambda_v the mean squared distance in
    view v, to which 0.001 is added; nothing for less than D points in a view.
    """
    total = 0.0
    for k in np.unique(labels):
        members = views[:, :, labels == k]
        variances, _, seen = _hyperplanes(members)
        total += float((seen * np.log(variances))[seen >= views.shape[1]].sum()) / 2
        total -= members.shape[2] * float(np.log(members.shape[2] / len(labels)))
    return total


def _moments(members: FloatArray) -> FloatArray:
    return np.asarray(members @ members.transpose(0, 2, 1))


def _hyperplanes(members: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Per view the variance of distances, the normal (V, D) and the number of points seen."""
    moments = _moments(members)
    # Columns have unit length.
    seen = np.trace(moments, axis1=1, axis2=2).round()
    values, vectors = np.linalg.eigh(moments)
    return np.maximum(values[:, 0], 0) / np.maximum(seen, 1) + _PRECISION, vectors[:, :, 0], seen


def _mean_nats(views: FloatArray, members: FloatArray) -> FloatArray:
    """Nats (N,) per view as a member of a group; infinite where no view tells."""
    variances, normals, seen = _hyperplanes(views[:, :, members])
    distances = np.einsum("vd,vdn->vn", normals, views)
    usable = views.any(axis=1) & (seen >= views.shape[1])[:, None]
    nats = (distances**2 / variances[:, None] + np.log(variances)[:, None]) / 2
    number = usable.sum(axis=0)
    summed = np.where(usable, nats, 0).sum(axis=0)
    return np.asarray(np.divide(summed, number, out=np.full(len(number), np.inf), where=number > 0))


def _increase(moments: FloatArray) -> FloatArray:
    """Increase of squared error per point and view (L, L) under merging, huge where nothing is known."""
    alone = np.linalg.eigvalsh(moments)[..., 0]
    seen = np.trace(moments, axis1=2, axis2=3)
    both = (seen[:, None] > 0) & (seen > 0)
    joint = np.linalg.eigvalsh(moments[:, None] + moments)[..., 0]
    more = np.where(both, joint - alone[:, None] - alone, 0).sum(axis=2)
    points = np.where(both, seen[:, None] + seen, 0).sum(axis=2)
    each = np.divide(more, points, out=np.full(more.shape, np.finfo(np.float64).max), where=points > 0)
    np.fill_diagonal(each, np.inf)
    return np.asarray(each)
