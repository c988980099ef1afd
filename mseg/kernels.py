"""From trajectories to affinities: hypotheses are sampled, residuals ranked, kernels sparsified and kept."""

import time
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.linalg.blas import ssyrk
from scipy.sparse import block_array, csr_array
from scipy.sparse.csgraph import connected_components

from kt3dmoseg import __version__
from kt3dmoseg.parallel import Cache, cache_key
from kt3dmoseg.types import BoolArray, Float32Array, FloatArray, IntArray, Trajectories
from mseg.geometry import hartley
from mseg.geometry.hartley import change_frame, frame_pair
from mseg.geometry.models import MODELS, Distance
from mseg.types import Hypotheses, ModelKind

ALGORITHM_VERSION: int = 1
"""Part of the identity of kept kernels; raised by hand whenever the values of a kernel change."""
GUARD = 0.1
"""The authors' guard against division by zero, part of the values that alpha is applied to."""

Arrays: TypeAlias = dict[str, npt.NDArray[Any]]
_Array = npt.NDArray[Any]
# Kernels kept in memory: a fusion of three views at three gaps; at 1,000 points 4 MB each.
_KEPT = 9
# Powers of the close and the wide neighbourhood; weight of all ties of the wide one over the close one's.
_CLOSE, _WIDE, _TIES = 9.0, 3.0, 0.1
# How often a degenerate sample is drawn.
_TRIES = 12
# Standard deviation of the distance of near points over the largest distance.
_REACH = 0.25
# Rows spread into a sum, entries raised to a power at once: few enough to stay in the cache.
_BLOCK = 128
_BLOCK_ENTRIES = 1 << 16


def sample_hypotheses(
    trajectories: Trajectories,
    kind: ModelKind,
    rng: np.random.Generator,
    *,
    per_pair: int = 500,
    gap: int = 1,
) -> Hypotheses:
    """Fit models to `per_pair` uniform minimal samples of every frame pair, all pairs at once.

    The points of a pair are normalised together (Hartley), and a fundamental matrix is made rank 2
    in that frame. Degenerate samples are drawn again, at most eleven times; then they are left out,
    so a pair may hold fewer models than requested. A pair with fewer visible points than a minimal
    sample holds none. Models are in pixel coordinates, pairs ascending.
    """
    model = MODELS[kind]
    frames = [(f, f + gap) for f in range(trajectories.n_frames - gap)]
    usable = [at for at in frames if len(frame_pair(trajectories, *at).rows) >= model.minimal]
    if not usable:
        return Hypotheses(np.empty((0, 3, 3)), np.empty((0, 2), dtype=np.int64), kind)
    pairs = [frame_pair(trajectories, *at) for at in usable]
    x1, x2 = np.concatenate([pair.x1 for pair in pairs]), np.concatenate([pair.x2 for pair in pairs])
    size = np.array([len(pair.rows) for pair in pairs], dtype=np.int64)
    start = size.cumsum() - size
    of = np.repeat(np.arange(len(pairs)), per_pair)
    models, ok = np.zeros((len(of), 3, 3)), np.zeros(len(of), dtype=np.bool_)
    for _ in range(_TRIES):
        todo = np.flatnonzero(~ok)
        if not len(todo):
            break
        sample = _draw_subsets(size[of[todo]], model.minimal, rng) + start[of[todo], None]
        models[todo], ok[todo] = model.fit(x1[sample], x2[sample])
    kept = of[ok]
    t1, t2 = np.stack([pair.t1 for pair in pairs])[kept], np.stack([pair.t2 for pair in pairs])[kept]
    pixels = change_frame(kind, models[ok], hartley.inverse(t1), hartley.inverse(t2))
    return Hypotheses(pixels, np.array(usable, dtype=np.int64)[kept], kind)


def _draw_subsets(sizes: IntArray, count: int, rng: np.random.Generator) -> IntArray:
    """One uniform subset (K, count) of 0..size-1 for each of K sizes >= count, without replacement."""
    # Floyd's algorithm, in Bentley and Floyd, "A sample of brilliance", CACM 1987.
    draws = rng.random((len(sizes), count))
    chosen = np.empty((len(sizes), count), dtype=np.int64)
    for k in range(count):
        last = sizes - count + k
        candidate = np.minimum((draws[:, k] * (last + 1)).astype(np.int64), last)
        taken = (chosen[:, :k] == candidate[:, None]).any(axis=1)
        chosen[:, k] = np.where(taken, last, candidate)
    return chosen


def draw_near_subsets(points: FloatArray, count: int, size: int, rng: np.random.Generator) -> IntArray:
    """Draw subsets (M, p) of near points (N, D): they more often belong to one motion.

    The first points run through all points in turn; the others are drawn one by one, without
    replacement, with probability proportional to ``exp(-d^2 / sigma^2)``, d the distance to the first and
    sigma a quarter of the largest distance between points.
    """
    # Toldo and Fusiello, "Robust multiple structures estimation with J-linkage", ECCV 2008, section 2.1;
    # by the largest perturbed logarithms: Vieira, "Gumbel-max trick and weighted reservoir sampling", 2014.
    squares = (points**2).sum(axis=1)
    distance = np.maximum(squares[:, None] + squares - 2 * (points @ points.T), 0)
    widest = _REACH**2 * float(distance.max())
    logarithm = -distance / widest if widest > 0 else np.zeros_like(distance)
    np.fill_diagonal(logarithm, np.inf)
    first = np.arange(count) % len(points)
    subsets = np.empty((count, size), dtype=np.int64)
    # One turn through the points at a time bounds the memory to N^2.
    for start in range(0, count, len(points)):
        part = first[start : start + len(points)]
        keys = logarithm[part] + rng.gumbel(size=(len(part), len(points)))
        others = np.argpartition(-keys, size - 1, axis=1)[:, :size]
        at_first = np.arange(len(part)), (others == part[:, None]).argmax(axis=1)
        others[at_first], others[:, 0] = others[:, 0], part
        subsets[start : start + len(part)] = others
    return subsets


def view_kernel(
    trajectories: Trajectories,
    hypotheses: Hypotheses,
    *,
    fraction: float = 0.1,
    distance: Distance = "sampson",
) -> Float32Array:
    """Accumulate ordered residual kernels over frame pairs and divide by co-visibility: (N, N) in 0..1.

    The ordered residual kernel of two points in a frame pair is |S_i and S_j| / h: the share of common
    hypotheses among the h that each of them prefers, a `fraction` of the pair's. The sum is divided by the
    number of frames in which both points are visible, plus 0.1; it is zero for points that never meet.
    """
    # Xu, Cheong, Li, CVPR 2018, section 3.1, after Chin, Wang, Suter, "Robust fitting of multiple structures:
    # the statistical learning approach", ICCV 2009, with the first window alone.
    change = np.flatnonzero((hypotheses.pair[1:] != hypotheses.pair[:-1]).any(axis=1)) + 1
    bounds = [0, *change.tolist(), len(hypotheses.pair)]
    sizes = np.diff(bounds)
    pairs = [frame_pair(trajectories, *at) for at in hypotheses.pair[bounds[:-1]].tolist()]
    # In the normalised frames of their pairs, where single precision is enough to rank.
    t1 = np.stack([pair.t1 for pair in pairs]).repeat(sizes, axis=0)
    t2 = np.stack([pair.t2 for pair in pairs]).repeat(sizes, axis=0)
    models = change_frame(hypotheses.kind, hypotheses.models, t1, t2)
    usual = _top_count(int(sizes.max()), fraction)
    total: Float32Array = np.zeros((len(trajectories), len(trajectories)), dtype=np.float32)
    for pair, (start, stop) in zip(pairs, pairwise(bounds), strict=True):
        if not len(pair.rows):
            continue
        points = pair.x1.astype(np.float32), pair.x2.astype(np.float32)
        residuals = MODELS[hypotheses.kind].residuals[distance](models[start:stop], *points)
        count = _top_count(stop - start, fraction)
        marks = _preferences(residuals, count).astype(np.float32)
        # Upper triangle of marks marks^T: counts, exact in single precision. A pair that has fewer
        # hypotheses than usual weighs as much as the others.
        _add_upper(total, pair.rows, ssyrk(usual / count, marks.T, trans=1, lower=1).T)
    _mirror(total)
    total /= np.float32(usual) * (covisible_frames(trajectories) + np.float32(GUARD))
    return total


def covisible_frames(trajectories: Trajectories) -> Float32Array:
    """Count (N, N) the frames in which both of two trajectories are visible."""
    seen = trajectories.visible.astype(np.float32)
    return np.asarray(seen @ seen.T)


def parts(visible: BoolArray, gap: int) -> IntArray:
    """Part trajectories (n, F) that no pair of frames sees together, or no frame (gap 0).

    The parts (n,) are 0, 1, ... by their first trajectories; -1 is what no pair sees.
    """
    pairs = (visible[:, : max(visible.shape[1] - gap, 0)] & visible[:, gap:]).astype(np.int64)
    found, seen = np.full(len(visible), -1), pairs.any(axis=1)
    if seen.any():
        joined = csr_array(pairs[seen][:, pairs.any(axis=0)])
        graph: Any = block_array([[None, joined], [csr_array(joined.T), None]])
        part = connected_components(graph)[1][: seen.sum()]
        found[seen] = np.unique(part, return_inverse=True)[1]
    return found


def _top_count(n_hypotheses: int, fraction: float) -> int:
    """Count the preferred hypotheses: the fraction rounded half up, at least 1 of any."""
    return min(n_hypotheses, max(1, int(np.floor(fraction * n_hypotheses + 0.5))))


def _preferences(residuals: _Array, count: int) -> BoolArray:
    """Mark in each row (P, K) the `count` least residuals, of equal ones the earlier; NaN counts as worst."""
    limit = np.partition(residuals, count - 1, axis=1)[:, count - 1 : count]
    chosen: BoolArray = residuals <= limit
    if np.count_nonzero(chosen) == count * len(chosen) and not np.isnan(limit).any():
        return chosen
    tied = np.flatnonzero(np.count_nonzero(chosen, axis=1) != count)
    if len(tied):
        order = np.argsort(residuals[tied], axis=1, kind="stable")[:, :count]
        rows = np.zeros((len(tied), residuals.shape[1]), dtype=np.bool_)
        np.put_along_axis(rows, order, True, axis=1)
        chosen[tied] = rows
    return chosen


def sparsify(kernel: _Array, alpha: float | None = None) -> _Array:
    """Keep the neighbours of an entropy-based neighbourhood of every point of a kernel (N, N) in 0..1.

    With B = K^alpha, the distances s_ij = max_j B_ij - B_ij of row i are read as a distribution
    P_ij = s_ij / sum_j s_ij, and those neighbours stay whose log P_ij lies below its mean under P,
    the negative entropy of the row. A constant row distinguishes no neighbours and keeps none. An entry stays
    where both points keep each other, half of it where one of them does.

    No power suits all clips: a high one cuts the kernels of long complete tracks to pieces, a low one ties
    motions together where depths differ. Without `alpha`, close neighbours (power 9) make the graph, and weak
    ties to wide ones (power 3) join its pieces: together they weigh a tenth of the close neighbours,
    whatever the sizes of the two neighbourhoods in the clip.
    """
    # Xu, Cheong, Li, CVPR 2018, section 4 (neighbourhood of the authors' code). The weak ties are ours.
    close: _Array = _neighbourhood_mask(kernel, _CLOSE if alpha is None else alpha)
    close *= kernel
    if alpha is None:
        wide = _neighbourhood_mask(kernel, _WIDE)
        wide *= kernel
        total = float(wide.sum())
        wide *= kernel.dtype.type(_TIES * float(close.sum()) / total if total > 0 else 0.0)
        close += wide
    return close


def _neighbourhood_mask(kernel: _Array, alpha: float) -> _Array:
    """1 where both points keep each other, 0.5 where one of them does, else 0; see `sparsify`.

    In double precision: most distances of a row are nearly equal to its largest, and the threshold
    lies among them.
    """
    keep = np.empty(kernel.shape, dtype=np.bool_)
    rows = max(1, _BLOCK_ENTRIES // max(1, len(kernel)))
    for start in range(0, len(kernel), rows):
        power = _power(kernel[start : start + rows].astype(np.float64), alpha)
        distance = power.max(axis=1, keepdims=True) - power
        total = distance.sum(axis=1, keepdims=True)
        np.divide(distance, total, out=distance, where=total > 0)
        logarithm = np.log(distance + np.finfo(np.float64).eps)
        mean = np.einsum("ij,ij->i", distance, logarithm)
        keep[start : start + rows] = (logarithm < mean[:, None]) & (total > 0)
    mask: _Array = keep.astype(kernel.dtype)
    mask += keep.T
    mask *= kernel.dtype.type(0.5)
    return mask


def _add_upper(total: Float32Array, rows: IntArray, shared: Float32Array) -> None:
    """Add the upper triangle of a matrix over some rows (ascending) to that over all, in place.

    First to their columns, then to their rows: an index into both axes at once takes five times as long.
    """
    for start in range(0, len(rows), _BLOCK):
        part = slice(start, start + _BLOCK)
        spread = np.zeros((len(rows[part]), len(total)), dtype=np.float32)
        spread[:, rows[start:]] = shared[part, start:]
        total[rows[part]] += spread


def _mirror(upper: Float32Array) -> None:
    """Copy the upper triangle of a square matrix to the lower, in place, by blocks of rows."""
    for start in range(0, len(upper), _BLOCK):
        stop = min(start + _BLOCK, len(upper))
        upper[stop:, start:stop] = upper[start:stop, stop:].T
        block = upper[start:stop, start:stop]
        block[:] = np.triu(block) + np.triu(block, 1).T


def _power(base: FloatArray, exponent: float) -> FloatArray:
    """Raise to a power; an integer one by products, since a general power takes twenty times as long."""
    if exponent <= 2 or exponent % 1:
        return base**exponent
    half = _power(base, exponent // 2)
    half *= half
    if exponent % 2:
        half *= base
    return half


# --- kernels shared between calls: methods, sweeps of alpha and fusions on one clip do not sample again -----
# So are the representations of methods whose programme draws nothing, between seeds and numbers of motions.


class KernelCache:
    """Kernels by what they depend on, the latest few in memory and, in a folder if given, all of them."""

    def __init__(self, folder: str | Path | None = None) -> None:
        self.saved_seconds = 0.0
        """CPU time of the kernels that were found instead of made."""
        self._disk = Cache(folder)
        self._memory: OrderedDict[str, Arrays] = OrderedDict()

    def get(self, depends_on: Mapping[str, object], make: Callable[[], Arrays]) -> Arrays:
        """Return arrays, made when they are not there; versions are added to what they depend on."""
        key = cache_key({"versions": [__version__, ALGORITHM_VERSION], **depends_on})
        entry = self._memory.pop(key, None) or self._disk.get(key)
        if entry is None:
            start = time.process_time()
            entry = make()
            entry["seconds"] = np.array(time.process_time() - start)
            self._disk.put(key, entry)
        else:
            self.saved_seconds += float(entry["seconds"])
        for array in entry.values():
            array.flags.writeable = False
        self._memory[key] = entry
        if len(self._memory) > _KEPT:
            self._memory.popitem(last=False)
        return entry


_cache: ContextVar[KernelCache | None] = ContextVar("kernel_cache", default=None)


def shared(depends_on: Mapping[str, object], make: Callable[[], Arrays]) -> Arrays:
    """Return what `make` returns, or returned to a call that depended on the same in the cache in force."""
    cache = _cache.get()
    return make() if cache is None else cache.get(depends_on, make)


@contextmanager
def kernel_cache(folder: str | Path | None = None) -> Iterator[KernelCache]:
    """Share kernels between the `segment` calls inside the block.

    Calls share a kernel when clip, seed and everything that shapes it (hypotheses, gap, residual)
    are the same; alpha, lambda, gamma, the fusion and k-means may differ. With a folder, later runs do too.
    """
    cache = KernelCache(folder)
    token = _cache.set(cache)
    try:
        yield cache
    finally:
        _cache.reset(token)
