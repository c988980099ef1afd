"""How far two labellings of the same trajectories, or two annotators' regions, agree."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from kt3dmoseg.annotate.formats.masks import mask_of
from kt3dmoseg.annotate.geometry import arrays, bounds
from kt3dmoseg.annotate.model import BACKGROUND, REJECT, AnnotatedObject, Annotation, Motion
from kt3dmoseg.annotate.propagation import Region
from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.matching import match_labels
from kt3dmoseg.types import BoolArray, ByteArray, FloatArray, IntArray

# Bytes of eight pixels each, of all objects together, that are compared at once.
_BLOCK = 1 << 18
# Shadows and far walkers that two people outlined overlap by 0.2; neighbours by less than this.
_SAME_PLACE = 0.1
# Intersection over union of what is drawn twice, the pairs looked at, and the grid they are compared on.
_DOUBLED, _MOST_PAIRS, _FINE = 0.5, 200, 64


@dataclass(frozen=True, eq=False)
class Agreement:
    """Agreement of labellings (n,): the labels of `a` renamed to the matching ones of `b`, or to others.

    `matching` maps labels of the given `a` to labels of `b`.
    """

    a: IntArray
    b: IntArray
    matching: dict[int, int]

    @property
    def agreement(self) -> float:
        """Share of trajectories with the same label; one that only one side labelled counts as different.

        >>> agree([1, 1, 2, 0], [1, 1, 1, 1]).agreement
        0.5
        """
        return float(np.mean(self.a == self.b)) if len(self.a) else 1.0

    @property
    def both(self) -> float:
        """Share of the trajectories that both sides labelled with the same label.

        >>> round(agree([1, 1, 2, 0], [1, 1, 1, 1]).both, 3)
        0.667
        """
        labelled = (self.a != 0) & (self.b != 0)
        return float(np.mean((self.a == self.b)[labelled])) if labelled.any() else 1.0

    @property
    def kappa(self) -> float:
        """Cohen's kappa (1960), with "unlabelled" as a category: 1 = equal, 0 = as by chance.

        >>> agree([1, 1, 2, 2], [1, 1, 2, 1]).kappa
        0.5
        """
        either = np.union1d(self.a, self.b)
        chance = sum(float(np.mean(self.a == label) * np.mean(self.b == label)) for label in either)
        return 1.0 if len(either) < 2 else (self.agreement - chance) / (1.0 - chance)

    @property
    def differences(self) -> IntArray:
        """Rows that differ, ascending."""
        return np.flatnonzero(self.a != self.b)

    def groups(self) -> list[tuple[int, int, IntArray]]:
        """Return the differing rows by (label of a, label of b), the largest group first."""
        pairs = np.unique(np.column_stack([self.a, self.b])[self.differences], axis=0).tolist()
        found = [(x, y, np.flatnonzero((self.a == x) & (self.b == y))) for x, y in pairs]
        return sorted(found, key=lambda group: -len(group[2]))


def agree(a: npt.ArrayLike, b: npt.ArrayLike, *, background: int | None = None) -> Agreement:
    """Compare two labellings (n,) of the same trajectories; 0 = unlabelled.

    The labels of `a` are renamed by the one-to-one assignment with the largest overlap (Kuhn 1955), but for
    that of the `background`, if it is the same in both.
    Raises InvalidValueError when the lengths differ.
    """
    mine, other = np.asarray(a, dtype=np.int64), np.asarray(b, dtype=np.int64)
    if mine.ndim != 1 or mine.shape != other.shape:
        found = f"{mine.shape} and {other.shape}"
        raise InvalidValueError("labels", expected="two vectors of one length", found=found)
    moving = (np.where(labels == background, 0, labels) for labels in (mine, other))
    matching = match_labels(*moving) | ({} if background is None else {background: background})
    spare = int(max(other.max(initial=0), mine.max(initial=0))) + 1
    names = {0: 0} | {label: spare + label for label in mine.tolist() if label} | matching
    return Agreement(np.array([names[label] for label in mine.tolist()], dtype=np.int64), other, matching)


def overlaps(
    a: Mapping[int, list[Region]], b: Mapping[int, list[Region]], image_size: tuple[int, int]
) -> FloatArray:
    """Return the intersection over union (len(a), len(b)) of objects, of the visible pixels of all frames."""
    width = -(-image_size[0] * image_size[1] // 8)

    def masks(side: Mapping[int, list[Region]], frame: int) -> ByteArray:
        drawn = [np.packbits(_seen(regions[frame], image_size)) for regions in side.values()]
        return np.array(drawn, dtype=np.uint8).reshape(len(side), width)

    shared, union = np.zeros((len(a), len(b))), np.zeros((len(a), len(b)))
    step = max(1, _BLOCK // (len(a) + len(b) + 1))
    for frame in range(max((len(regions) for regions in (*a.values(), *b.values())), default=0)):
        packed = masks(a, frame), masks(b, frame)
        for first in range(0, width, step):
            mine, theirs = (
                np.unpackbits(side[:, first : first + step], axis=1).astype(np.float32) for side in packed
            )
            both = mine @ theirs.T
            shared += both
            union += mine.sum(axis=1)[:, None] + theirs.sum(axis=1) - both
    return np.asarray(shared / np.maximum(union, 1), dtype=np.float64)


def same_place(annotation: Annotation) -> str:
    """Name two objects of different motions that are drawn in the same place in a key frame, or none."""
    shown: dict[int, list[tuple[AnnotatedObject, list[FloatArray]]]] = {}
    for item in annotation.objects:
        for key in item.key_frames:
            if key.visibility == "visible":
                shown.setdefault(key.frame, []).append((item, arrays(key.polygons)))
    tried = 0
    for frame, drawn in sorted(shown.items()):
        motions = np.array([str(item.motion) for item, _ in drawn])
        low, high = np.array([np.reshape(bounds(polygons), (2, 2)) for _, polygons in drawn]).swapaxes(0, 1)
        sides = np.minimum(high[:, None], high) - np.maximum(low[:, None], low)
        shared, area = np.maximum(sides, 0).prod(axis=2), (high - low).prod(axis=1)
        alike = (shared > _DOUBLED * (area[:, None] + area - shared)) & (motions[:, None] != motions)
        for i, j in np.argwhere(np.triu(alike)).tolist()[: _MOST_PAIRS - tried]:
            tried += 1
            corner = np.minimum(low[i], low[j])
            scale = _FINE / (np.maximum(high[i], high[j]) - corner)
            a, b = (mask_of([(p - corner) * scale for p in drawn[k][1]], (_FINE, _FINE)) for k in (i, j))
            if (a & b).sum() > _DOUBLED * (a | b).sum():
                names = f"{drawn[i][0].name} and {drawn[j][0].name}"
                return f"{names} have different motions in the same place in frame {frame}"
    return ""


@dataclass(frozen=True)
class ObjectPair:
    """What two annotators drew in one place; None on the side of who drew nothing there.

    `iou` is the intersection over union of the visible pixels of all frames; `frame` the one in which the
    outlines differ most; `different` counts the trajectories of either whose labels differ, if there are any;
    `motion` is that of the second's object as the first numbers it, None for one that the first has not.
    """

    first: AnnotatedObject | None
    second: AnnotatedObject | None
    iou: float = 0.0
    frame: int = 0
    different: int | None = None
    motion: Motion | None = None

    @property
    def rank(self) -> int:
        """0: one drew nothing there, 1: another motion, 2: labels differ, 3: they do not."""
        if self.first is None or self.second is None:
            return 0
        return 1 if self.motion != self.first.motion else 2 if self.different else 3

    def verdict(self, first: str, second: str) -> str:
        """Return in words how they differ; the annotators are called so.

        >>> from kt3dmoseg.annotate import KeyFrame
        >>> bus = AnnotatedObject(1, "bus", "car", 1, (KeyFrame(0, "outside"),))
        >>> ObjectPair(None, bus).verdict("A", "B")
        'missed by A: bus'
        """
        names = " / ".join(dict.fromkeys(item.name for item in (self.first, self.second) if item))
        missed = f"missed by {second if self.first else first}"
        same = "same motion" if self.different is None else "same labels"
        return f"{(missed, 'another motion', 'labels differ', same)[self.rank]}: {names}"

    def to_json(self, first: str, second: str) -> dict[str, Any]:
        """Return names, ids and all of the above; None where one drew nothing."""
        sides = {"first": self.first, "second": self.second}
        names = {side: item.name if item else None for side, item in sides.items()}
        ids = {f"{side}_id": item.id if item else None for side, item in sides.items()}
        measures = {name: getattr(self, name) for name in ("iou", "frame", "different", "motion")}
        return names | ids | measures | {"verdict": self.verdict(first, second)}


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two annotations of a clip: how labels agree, where there are trajectories, and the objects."""

    clip: str
    agreement: Agreement | None
    objects: list[ObjectPair]

    def to_json(self, first: str, second: str) -> dict[str, Any]:
        """Return the clip, the measures of agreement if there are any, and all objects; see `ObjectPair`."""
        of_labels: dict[str, Any] = {}
        if found := self.agreement:
            of_labels = {"agreement": found.agreement, "both": found.both, "kappa": found.kappa}
            of_labels |= {"trajectories": len(found.a), "different": len(found.differences)}
        objects = [pair.to_json(first, second) for pair in self.objects]
        return {"clip": self.clip, **of_labels, "objects": objects}


def compare(
    annotations: tuple[Annotation, Annotation],
    regions: tuple[Mapping[int, list[Region]], Mapping[int, list[Region]]],
    labels: tuple[IntArray, IntArray] | None = None,
) -> Comparison:
    """Compare two annotations of a clip, with their objects paired so that they overlap most (Kuhn 1955).

    Those that differ most come first. What overlaps by an IoU of less than 0.1 is two objects, of which each
    annotator missed one; what is never visible is missed by nobody. `labels` (n,) of the same trajectories
    join the motions; where they tell nothing, those of paired objects correspond.
    """
    one, two = ({item.id: item for item in side.objects} for side in annotations)
    (ids, others), size = map(list, regions), annotations[0].image_size
    overlap = overlaps(*regions, size)
    chosen = zip(*linear_sum_assignment(overlap, maximize=True), strict=True)
    found = [(ids[i], others[j], float(overlap[i, j])) for i, j in chosen if overlap[i, j] > _SAME_PLACE]
    mine, theirs = (
        {i for i, of in side.items() if any(r.visibility == "visible" and r.polygons for r in of)}
        for side in regions
    )
    found += [(i, 0, 0.0) for i in sorted(mine - {i for i, _, _ in found})]
    found += [(0, j, 0.0) for j in sorted(theirs - {j for _, j, _ in found})]
    compared = agree(*labels, background=1) if labels else None
    out = []
    for i, j, iou in found:
        a, b = one.get(i), two.get(j)
        frame = _most_apart(regions[0].get(i, ()), regions[1].get(j, ()), size)
        different = None
        if labels and compared:
            of_either = (labels[0] == _label(a)) | (labels[1] == _label(b))
            different = int((of_either & (compared.a != compared.b)).sum())
        out.append(ObjectPair(a, b, iou, frame, different, _renumbered(a, b, compared)))
    out.sort(key=lambda pair: (pair.rank, -(pair.different or 0), pair.iou))
    return Comparison(annotations[0].clip, compared, out)


def _renumbered(
    a: AnnotatedObject | None, b: AnnotatedObject | None, compared: Agreement | None
) -> Motion | None:
    """Return the motion of the second's object as the first numbers it; None where the first has it not."""
    if b is None or _label(b) < 0:
        return b.motion if b else None
    matching = compared.matching if compared else {}
    label = {other: mine for mine, other in matching.items()}.get(_label(b))
    if label is not None:
        return label - 1 or None
    # No trajectory tells: in one place they are the same, unless the first's is another of the second's.
    return a.motion if a and _label(a) not in {-1, *matching} else None


def _label(item: AnnotatedObject | None) -> int:
    return -1 if item is None or item.motion in (BACKGROUND, REJECT) else int(item.motion) + 1


def _most_apart(a: Sequence[Region], b: Sequence[Region], size: tuple[int, int]) -> int:
    """Return the frame in which the visible pixels of two objects differ most."""
    pairs = zip_longest(a, b, fillvalue=Region("outside"))
    counts = [int(np.count_nonzero(_seen(x, size) != _seen(y, size))) for x, y in pairs]
    return int(np.argmax(counts or [0]))


def _seen(region: Region, size: tuple[int, int]) -> BoolArray:
    return mask_of(region.polygons if region.visibility == "visible" else (), size)
