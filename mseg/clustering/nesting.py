"""What the subset constraint rewards: that points agree in a model as its neighbours in the nesting say.

With S = U U^T the kernel of an embedding U (N, K), points together in the smaller model are rewarded for
being together in the larger, max(S, 0), points apart in the larger for being apart in the smaller,
min(S, 0). Source: Xu, Cheong, Li, CVPR 2018, section 3.2. Computed by blocks of rows that stay in the cache.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.types import FloatArray

_BLOCK_ENTRIES = 1 << 17
_KEPT_ENTRIES = 1 << 27


class Nesting:
    """max(U U^T, 0) of the smaller model plus min(U U^T, 0) of the larger, (N, N) and symmetric.

    Up to `_KEPT_ENTRIES` are computed once and kept; beyond, memory matters more than time. Single
    precision: the weight of the constraint takes its error below that of the eigenvectors.

    Parameters
    ----------
    smaller, larger : (N, K) float64 or None
        Embeddings of the neighbours in the nesting; one of them may be missing.
    size : int
        N.
    """

    def __init__(self, smaller: FloatArray | None, larger: FloatArray | None, size: int) -> None:
        self.smaller, self.larger, self.shape = smaller, larger, (size, size)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> FloatArray:  # noqa: ANN401
        """Write the matrix out, in double precision."""
        return np.concatenate([self._rows(part, np.float64) for part in _parts(self.shape[0])])

    def __matmul__(self, vectors: FloatArray) -> FloatArray:
        """Multiply with (N, b)."""
        single = vectors.astype(np.float32)
        if self._kept is not None:
            return (self._kept @ single).astype(np.float64)
        blocks = [self._rows(part, np.float32) @ single for part in _parts(self.shape[0])]
        return np.concatenate(blocks).astype(np.float64)

    @cached_property
    def _kept(self) -> npt.NDArray[Any] | None:
        if self.shape[0] ** 2 > _KEPT_ENTRIES:
            return None
        whole: npt.NDArray[Any] = np.empty(self.shape, np.float32)
        for part in _parts(self.shape[0]):
            whole[part] = self._rows(part, np.float32)
        return whole

    def _rows(self, part: slice, dtype: npt.DTypeLike) -> npt.NDArray[Any]:
        total, *others = [
            _clipped(clip, embedding.astype(dtype), part)
            for clip, embedding in ((np.maximum, self.smaller), (np.minimum, self.larger))
            if embedding is not None
        ]
        for other in others:
            total += other
        return total


def nested(smaller: FloatArray, larger: FloatArray) -> float:
    """Sum over all entries of max(S, 0) L + min(L, 0) S, S and L the kernels of two embeddings (N, K).

    As the traces of U_L^T max(S, 0) U_L and U_S^T min(L, 0) U_S.
    """
    total = 0.0
    for part in _parts(len(smaller)):
        together = _clipped(np.maximum, smaller, part) @ larger
        apart = _clipped(np.minimum, larger, part) @ smaller
        total += float(np.vdot(together, larger[part]) + np.vdot(apart, smaller[part]))
    return total


def _parts(size: int) -> Iterator[slice]:
    """Blocks of rows of a matrix of that size, few enough to stay in the cache."""
    rows = max(1, _BLOCK_ENTRIES // max(1, size))
    return (slice(start, start + rows) for start in range(0, size, rows))


def _clipped(clip: np.ufunc, embedding: npt.NDArray[Any], part: slice) -> npt.NDArray[Any]:
    """Rows of max(U U^T, 0) or min(U U^T, 0)."""
    agreement: npt.NDArray[Any] = embedding[part] @ embedding.T
    clip(agreement, 0, out=agreement)
    return agreement
