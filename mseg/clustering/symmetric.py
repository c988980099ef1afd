"""Symmetric matrices of which a product with vectors is all that is asked: many are never written out."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from kt3dmoseg.types import FloatArray


class Symmetric(Protocol):
    """A symmetric (N, N) matrix that may exist only as a product with vectors."""

    @property
    def shape(self) -> tuple[int, ...]:
        """(N, N)."""

    def __matmul__(self, vectors: FloatArray, /) -> Any:  # noqa: ANN401  # ndarray, whatever its stubs say
        """Multiply with (N, b) float64."""


class LowRank:
    """U U^T of a thin factor U (N, b)."""

    def __init__(self, factor: FloatArray) -> None:
        self.factor, self.shape = factor, (len(factor),) * 2

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> FloatArray:  # noqa: ANN401
        """Write the matrix out."""
        return np.asarray(self.factor @ self.factor.T)

    def __matmul__(self, vectors: FloatArray) -> FloatArray:
        """Multiply with (N, b)."""
        return np.asarray(self.factor @ (self.factor.T @ vectors))


class WeightedSum:
    """A sum of matrices, each times its weight.

    Parameters
    ----------
    *terms : (float, Symmetric)
        Weights and matrices, at least one, all of one shape.
    """

    def __init__(self, *terms: tuple[float, Symmetric]) -> None:
        self.terms, self.shape = terms, terms[0][1].shape

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> FloatArray:  # noqa: ANN401
        """Write the matrix out."""
        return np.asarray(sum(weight * np.asarray(matrix) for weight, matrix in self.terms))

    def __matmul__(self, vectors: FloatArray) -> FloatArray:
        """Multiply with (N, b)."""
        return np.asarray(sum(weight * (matrix @ vectors) for weight, matrix in self.terms))
