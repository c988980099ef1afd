"""The methods for users of scikit-learn: one estimator with `fit` and `fit_predict`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from sklearn.base import BaseEstimator, ClusterMixin
from sklearn.utils import check_random_state
from sklearn.utils.validation import validate_data

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import Clip, IntArray, Trajectories
from mseg.methods import create, segment
from mseg.types import Method, Segmentation

_SEEDS = 1 << 31


@dataclass(eq=False, repr=False)
class MotionSegmenter(ClusterMixin, BaseEstimator):  # type: ignore[misc]  # scikit-learn has no types
    """Cluster trajectories by rigid motion, as a scikit-learn clusterer.

    Parameters
    ----------
    method : str or Method
        A name of `mseg.methods.list`, or a method object.
    n_motions : int or None
        Number of motions, background included; None for methods that find it themselves.
    random_state : int, numpy.random.RandomState or None
        An int is the `seed` of `mseg.segment`: same labels in every call of `fit`.
    parameters : mapping of str to object, optional
        Parameters of the method, when it is given by name.

    Attributes
    ----------
    labels_ : (N,) int64
        As scikit-learn numbers clusters: 0, 1, ... = motions, -1 = outlier. `mseg.score` and files number
        from 1 and call outliers 0: give them `segmentation_`.
    segmentation_ : Segmentation
        What `mseg.segment` returned, with its report and notes.
    n_features_in_ : int
        Number of columns, where `X` was a table.
    """

    method: str | Method = "multibody"
    _: KW_ONLY
    n_motions: int | None = None
    random_state: int | np.random.RandomState | None = 0
    parameters: Mapping[str, Any] | None = None

    def fit(self, X: Clip | Trajectories | npt.ArrayLike, y: object = None) -> MotionSegmenter:
        """Segment `X`: a clip, trajectories, an array (N, F, 2), or a table (N, 2F).

        The columns of a table are x and y in pixels of the first frame, then of the second, and so on; both
        are NaN where a point is not visible. `y` is ignored. Raises what `mseg.segment` raises.
        """
        generator = self.random_state
        if not isinstance(generator, (int, np.integer)):
            generator = check_random_state(generator).randint(_SEEDS)
        method = self.method
        if self.parameters:
            if not isinstance(method, str) or not isinstance(self.parameters, Mapping):
                found = f"{self.parameters!r:.60} for {method!r:.40}"
                expected = "a mapping, for a method given by name"
                raise InvalidValueError("parameters", expected=expected, found=found)
            method = create(method, **self.parameters)
        self.segmentation_: Segmentation = segment(
            self._points(X), method, n_motions=self.n_motions, seed=int(generator)
        )
        groups = np.unique(self.segmentation_.labels, return_inverse=True)[1]
        self.labels_: IntArray = groups - bool((self.segmentation_.labels == 0).any())
        return self

    def _points(self, given: Any) -> Any:  # noqa: ANN401  # `segment` checks it
        if isinstance(given, (Clip, Trajectories)) or np.ndim(given) == 3:
            return given
        if isinstance(given, np.ma.MaskedArray):
            given = np.ma.filled(given.astype(np.float64), np.nan)
        least = {"ensure_min_samples": self.n_motions if isinstance(self.n_motions, int) else 1}
        table = validate_data(self, given, dtype=np.float64, ensure_all_finite="allow-nan", **least)
        if table.shape[1] % 2:
            expected = "an even number of columns, x and y of every frame"
            raise InvalidValueError("X", expected=expected, found=f"shape {table.shape}")
        return table.reshape(len(table), -1, 2)

    def __sklearn_tags__(self) -> Any:  # noqa: ANN401  # scikit-learn has no types
        tags = super().__sklearn_tags__()
        tags.input_tags.allow_nan = tags.input_tags.three_d_array = True
        return tags
