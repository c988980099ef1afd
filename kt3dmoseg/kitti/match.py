"""From evidence per frame to the frame numbers of a clip: pure functions, no files.

Evidence is exact (per frame of the clip, the numbers of the drive's frames that equal it) or graded (a
correlation of every frame of the clip with every frame of the drive).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kt3dmoseg.catalog.entries import format_numbers
from kt3dmoseg.types import ByteArray, Float32Array, FloatArray

_WIDTH = 320
_SIGMA = 2.0
_LEAST_SCORE = 0.8
_LEAST_MARGIN = 0.02
_LEAST_AGREEMENT = 0.9
_MOST = 3


@dataclass(frozen=True)
class Candidate:
    """A place where the clip may be, and why."""

    numbers: tuple[int, ...]
    reason: str

    def __str__(self) -> str:
        """Say ``40-59 (17 of 20 frames equal)``."""
        return f"{format_numbers(self.numbers)} ({self.reason})"


@dataclass(frozen=True)
class Verdict:
    """Frame numbers when they are proved; otherwise the best candidates, best first, at most three."""

    numbers: tuple[int, ...] | None
    candidates: tuple[Candidate, ...] = ()
    ambiguous: bool = False


def match_exact(equal: Sequence[Sequence[int]]) -> Verdict:
    """Find the frame numbers from exact equality.

    Parameters
    ----------
    equal : sequence of sequence of int
        For each frame of the clip, the numbers of the drive's frames that equal it.

    Returns
    -------
    Verdict
        Proved when every frame has exactly one equal and these ascend, or when, among repeated equal
        frames, exactly one choice has a constant step.
    """
    if all(len(found) == 1 for found in equal):
        numbers = tuple(found[0] for found in equal)
        if all(b > a for a, b in pairwise(numbers)):
            return Verdict(numbers)
        return Verdict(None, (Candidate(numbers, "all frames equal, but not in ascending order"),))
    if all(equal):
        steady = _steady(equal)
        if len(steady) == 1:
            return Verdict(steady[0])
        found = steady or [tuple(found[0] for found in equal)]
        all_equal = tuple(Candidate(numbers, "all frames equal") for numbers in found[:_MOST])
        return Verdict(None, all_equal, ambiguous=True)
    votes = Counter(number - index for index, found in enumerate(equal) for number in found)
    best = [
        Candidate(tuple(range(first, first + len(equal))), f"{n} of {len(equal)} frames equal")
        for first, n in votes.most_common(_MOST)
        if first >= 0
    ]
    return Verdict(None, tuple(best))


def match_graded(similarity: FloatArray | Float32Array, numbers: Sequence[int]) -> Verdict:
    """Find the consecutive frame numbers from correlations.

    Parameters
    ----------
    similarity : (F, D) float
        Correlation of each frame of the clip with each frame of the drive.
    numbers : sequence of D int
        Numbers of the drive's frames, ascending.

    Returns
    -------
    Verdict
        Proved when the best run of F consecutive numbers correlates by at least 0.8 on average, the next
        best by at least 0.02 less, and nine frames in ten have their best match there. On KITTI frames
        that were re-encoded (JPEG quality 30, gamma 0.7, halved and enlarged, noise of 10 gray levels),
        the true run reaches at least 0.97 and a shift by one frame at most 0.90.
    """
    length, row = len(similarity), {number: k for k, number in enumerate(numbers)}
    firsts = [n for n in numbers if all(n + k in row for k in range(length))]
    index = np.arange(length)
    scored = sorted(
        ((float(similarity[index, [row[n + k] for k in range(length)]].mean()), n) for n in firsts),
        reverse=True,
    )
    if not scored:
        return Verdict(None)
    (score, first), second = scored[0], scored[1][0] if len(scored) > 1 else -1.0
    columns = np.array([row[first + k] for k in range(length)])
    agreement = float(np.mean(similarity.argmax(axis=1) == columns))
    clear = score - second >= _LEAST_MARGIN and agreement >= _LEAST_AGREEMENT
    if score >= _LEAST_SCORE and clear:
        return Verdict(tuple(range(first, first + length)))
    best = [Candidate(tuple(range(n, n + length)), f"correlation {s:.3f}") for s, n in scored[:_MOST]]
    return Verdict(None, tuple(best), ambiguous=score >= _LEAST_SCORE)


def descriptor(image: ByteArray) -> Float32Array:
    """Describe an image's fine structure for correlation: unit vector, (n,) float32.

    The image is made gray, shrunk to a width of 320 pixels, and freed of its local mean (Gaussian,
    sigma 2 pixels): what two neighbouring frames of a drive share is mostly smooth, what tells them apart
    is not. The dot product of two descriptors is their normalised cross-correlation.
    """
    import cv2

    gray = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    height = max(1, round(gray.shape[0] * _WIDTH / gray.shape[1]))
    small = cv2.resize(gray, (_WIDTH, height), interpolation=cv2.INTER_AREA).astype(np.float32)
    fine = (small - cv2.GaussianBlur(small, (0, 0), _SIGMA)).ravel()
    fine -= fine.mean()
    return np.asarray(fine / max(float(np.linalg.norm(fine)), 1e-6), dtype=np.float32)


def _steady(equal: Sequence[Sequence[int]]) -> list[tuple[int, ...]]:
    sets = [set(found) for found in equal]
    steps = sorted({b - a for a in equal[0] for b in equal[1] if b > a}) if len(equal) > 1 else [1]
    runs = []
    for step in steps:
        for first in equal[0]:
            numbers = tuple(first + step * k for k in range(len(equal)))
            if all(n in found for n, found in zip(numbers, sets, strict=True)):
                runs.append(numbers)
    return runs
