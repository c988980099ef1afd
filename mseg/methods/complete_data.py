"""What methods that need complete trajectories share: filling gaps, and the rules for bad input.

Rules, the same for all of them:

* Trajectories seen in fewer than two frames show no motion. They take no part; at the end
  they join the largest motion, the best guess without evidence.
* Frames in which no other trajectory is seen are left out.
* Gaps are filled in pixels, or refused, by the option ``completion``: from one subspace, or by
  robust principal components, which repair gross errors of seen positions as well.
* Fewer trajectories than motions, fewer than two frames, or trajectories that all coincide are an error.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.options import option
from kt3dmoseg.types import BoolArray, Clip, FloatArray, IntArray
from mseg.completion import Completion, complete, robust_pca
from mseg.errors import IncompleteTrajectoriesError, SegmentationError, TooFewPointsError
from mseg.geometry.subspaces import normalised, normalising_matrix, trajectory_matrix
from mseg.types import MANY, Grouping, Segmentation

_FEWEST_FRAMES = 2
# Of 640 x 480 pixels, the images of most Hopkins155 sequences, where thresholds were chosen.
_DIAGONAL = 800.0


@dataclass(frozen=True, eq=False)
class CompleteData:
    """Complete trajectories of a clip."""

    pixels: FloatArray  # (2F', n'): trajectory matrix, rows x1, y1, x2, y2, ...
    # Pixels per unit of thresholds: an image with a diagonal of 800 pixels (640 x 480) has 1; of an unknown
    # size, the range of the positions takes its place.
    unit: float
    normalised: FloatArray  # (2F', n'): in the coordinates of `normalising_matrix`
    used: BoolArray  # (n,): which evaluated trajectories the columns are
    report: Mapping[str, Any]  # what completion did

    @property
    def n_points(self) -> int:
        """Number of trajectories n' that take part."""
        return int(self.pixels.shape[1])

    @property
    def homogeneous(self) -> FloatArray:
        """`normalised` with one more row of ones: affine subspaces become linear ones."""
        return np.vstack([self.normalised, np.ones(self.n_points)])


def complete_data(
    clip: Clip, completion: Literal["chen", "rpca", "none"] = "chen", rank: int = 5
) -> CompleteData:
    """Trajectory matrices of the evaluated trajectories, without gaps.

    `completion` fills gaps by `mseg.completion.complete`, takes the low-rank part of `robust_pca`, gaps or
    not, or refuses gaps; `rank` is that of the completion "chen".
    """
    trajectories = clip.evaluated_trajectories
    used = trajectories.lengths >= _FEWEST_FRAMES
    kept = trajectories.select(used)
    frames = kept.visible.any(axis=0)
    if used.sum() < 2 or frames.sum() < _FEWEST_FRAMES:
        found = f"{int(used.sum())} seen twice or more, {int(frames.sum())} frames"
        raise TooFewPointsError(clip.name, expected="at least 2 trajectories and 2 frames", found=found)
    gaps = int((~trajectories.visible).sum())
    if completion == "none" and not (kept.visible.all() and used.all()):
        raise IncompleteTrajectoriesError(
            clip.name, expected="complete trajectories", found=f"{gaps} missing positions",
            fix="use completion='chen'",
        )  # fmt: skip
    extent = np.ptp(kept.xy[kept.visible], axis=0) if kept.image_size is None else kept.image_size
    unit = float(np.hypot(*extent)) / _DIAGONAL or 1.0
    filled = _filled(trajectory_matrix(kept.xy[:, frames]), completion, rank)
    pixels = filled.matrix
    if np.ptp(pixels, axis=1).max() <= np.finfo(np.float64).eps * np.abs(pixels).max():
        raise SegmentationError(clip.name, expected="trajectories that differ", found="one, repeated")
    report = {
        "completion_rank": filled.rank,
        "completion_rms_pixels": filled.rms,
        "completion_undetermined": filled.undetermined,
        **filled.convergence.report("completion_"),
    }
    xy = normalised(pixels.T.reshape(len(kept), -1, 2), normalising_matrix(trajectories, clip.camera))
    if filled.undetermined > MANY * len(kept):
        report["warnings"] = [f"{filled.undetermined} trajectories are too short to fill their gaps"]
    report = report if gaps or completion == "rpca" else {}
    return CompleteData(pixels, unit, trajectory_matrix(xy), used, report)


def _filled(matrix: FloatArray, completion: str, rank: int) -> Completion:
    if completion != "rpca":
        return complete(matrix, rank)
    seen = np.isfinite(matrix)
    # Far from the origin the common position would be the one direction that counts.
    centre = np.nanmean(matrix, axis=1, keepdims=True)
    split = robust_pca(matrix - centre)
    found = int(np.linalg.matrix_rank(split.low_rank, tol=1e-6 * float(np.linalg.norm(split.low_rank, 2))))
    rms = float(np.sqrt((split.sparse[seen] ** 2).mean()))
    undetermined = int((seen.sum(axis=0) < found).sum())
    return Completion(split.low_rank + centre, found, rms, undetermined, split.convergence)


@dataclass(frozen=True)
class CompleteDataMethod(ABC):
    """Base of the methods that need complete trajectories; a subclass groups the completed ones."""

    finds_n_motions: ClassVar[bool] = False
    """Whether `n_motions` may be None."""

    completion: Literal["chen", "rpca", "none"] = option(
        "chen",
        "how gaps are filled: 'chen' (fixed rank), 'rpca' (repairs gross errors too), 'none' to refuse",
    )
    completion_rank: int = option(5, "rank of the completion of gaps", low=1)

    def segment(self, clip: Clip, *, n_motions: int | None, rng: np.random.Generator) -> Segmentation:
        """Complete the evaluated trajectories of `clip` and group them.

        See `mseg.types.Method.segment` for parameters and `mseg.methods.complete_data` for the rules.
        """
        if n_motions is None and not self.finds_n_motions:
            expected, fix = f"a number: {type(self).__name__} cannot find it", "give n_motions=N"
            raise InvalidValueError("n_motions", expected=expected, found="none", fix=fix)
        data = complete_data(clip, self.completion, self.completion_rank)
        if n_motions is not None and data.n_points < n_motions:
            raise TooFewPointsError(
                clip.name, expected=f"at least {n_motions} trajectories", found=str(data.n_points)
            )
        labels, report = self.group(data, n_motions, rng)
        return Segmentation.of_part(labels, data.used, {**data.report, **report})

    @abstractmethod
    def group(self, data: CompleteData, n_motions: int | None, rng: np.random.Generator) -> Grouping:
        """Return labels (n',) of the columns, 0 = outlier, and what there is to report."""


def by_size(cluster: IntArray) -> IntArray:
    """Rename clusters (N,) to 1, 2, ... by decreasing size, of equal sizes the one that appears first."""
    _, first, inverse, counts = np.unique(cluster, return_index=True, return_inverse=True, return_counts=True)
    rank = np.empty(len(counts), dtype=np.int64)
    rank[np.lexsort((first, -counts))] = np.arange(1, len(counts) + 1)
    return np.asarray(rank[inverse])
