"""What methods produce: hypotheses on the way, a segmentation at the end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.io.predictions import label_vector
from kt3dmoseg.types import BoolArray, Clip, FloatArray, IntArray, Value, frozen

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

ModelKind: TypeAlias = Literal["affine", "homography", "fundamental"]
Grouping: TypeAlias = tuple[IntArray, dict[str, Any]]
"""Labels (m,) int64 of the trajectories that take part, 0 = outlier, and what there is to report."""

MANY = 0.05
"""Share of the trajectories from which on guesses about them are worth a note."""


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """K geometric models between pairs of frames."""

    models: FloatArray  # (K, 3, 3): homogeneous matrices
    pair: IntArray  # (K, 2): the two frames of each model
    kind: ModelKind  # of all models

    def __post_init__(self) -> None:
        if self.models.shape != (len(self.pair), 3, 3) or self.pair.shape[1:] != (2,):
            expected, found = "models (K, 3, 3) and pair (K, 2)", f"{self.models.shape} and {self.pair.shape}"
            raise InvalidValueError("hypotheses", expected=expected, found=found)


@dataclass(frozen=True, eq=False)
class Segmentation(Value):
    """Predicted motions of the evaluated trajectories of a clip, or of all.

    Parameters
    ----------
    labels : (n,) int64
        1, 2, ... = predicted motions; 0 = outlier. In the order of ``clip.evaluated``, or of `rows`.
    report : mapping of str to object
        What the method reports: objective values, convergence, chosen rank, timings. `notes` are the
        sentences that one must know to trust the labels, see `mseg.segment`.
    rows : (n,) int64 or None
        Rows of ``clip.dense`` that the labels belong to; None: the evaluated ones.
    """

    labels: IntArray
    report: Mapping[str, Any] = field(default_factory=dict)
    rows: IntArray | None = None

    def __post_init__(self) -> None:
        rows = None if self.rows is None else frozen(self.rows, np.int64)
        labels = frozen(label_vector(self.labels, "labels"), np.int64)
        self._set(labels=labels, report=MappingProxyType(dict(self.report)), rows=rows)

    @classmethod
    def of_part(cls, labels: IntArray, used: BoolArray, report: Mapping[str, Any]) -> Segmentation:
        """Segmentation of n trajectories of which only the m `used` (n,) took part, with `labels` (m,).

        The others join the largest motion: without evidence that is the best guess. Where all that took part
        are outliers, so are they.
        """
        left, sizes = int((~used).sum()), np.bincount(labels)[1:]
        report = {**report, "trajectories_left_out": left}
        if left > MANY * len(used):
            guess = f"{left} trajectories took no part and were put into the largest motion"
            report["warnings"] = [*report.get("warnings", ()), guess]
        everywhere = np.full(len(used), sizes.argmax() + 1 if len(sizes) else 0, dtype=np.int64)
        everywhere[used] = labels
        return cls(everywhere, report)

    def __repr__(self) -> str:
        """One line: how many trajectories, and the size of each motion."""
        groups, sizes = np.unique(self.labels, return_counts=True)
        shown = ", ".join(f"{g}: {n}" for g, n in zip(groups.tolist(), sizes.tolist(), strict=True))
        notes = "".join(f"; {note}" for note in self.report.get("notes", ()))
        return f"Segmentation({len(self.labels)} trajectories; motion: size {{{shown}}}{notes})"

    def _repr_html_(self) -> str:
        from kt3dmoseg.draw.display import group_labels, html_table, labels_html

        table = labels_html(f"Segmentation of {len(self.labels)} trajectories", group_labels(self.labels))
        plain = [(k, f"{v:g}") for k, v in self.report.items() if isinstance(v, (int, float))]
        return table + html_table("", ("", ""), plain, self.report.get("notes", ()))

    def plot(
        self,
        clip: Clip | None = None,
        frame: int | None = None,
        *,
        picture: npt.ArrayLike | None = None,
        ax: Axes | None = None,
    ) -> Axes:
        """Plot the trajectories of `clip` in the colours of these motions; without one, their sizes.

        Of a labelled clip, a predicted motion has the colour of the labelled one that it shares most with,
        and the trajectories that are then labelled otherwise are ringed. See `kt3dmoseg.Trajectories.plot`.
        """
        from kt3dmoseg.draw.display import group_labels, plot_labels, plot_painting
        from kt3dmoseg.draw.painting import by_prediction

        if clip is not None:
            painting = by_prediction(*self._on(clip))
            return plot_painting(painting, frame, title=clip.name, picture=picture, ax=ax)
        if frame is not None or picture is not None:
            raise InvalidValueError("clip", expected="the clip whose trajectories to plot", found="none")
        return plot_labels(group_labels(self.labels), ax=ax)

    def to_dataframe(self, clip: Clip | None = None) -> pd.DataFrame:
        """Give one row per trajectory: `label`; with `clip` also `track`, by which `mseg.score` joins."""
        import pandas as pd

        if clip is None:
            return pd.DataFrame({"label": self.labels})
        shown, labels = self._on(clip)
        return pd.DataFrame({"track": shown.dense.track_id[shown.evaluated], "label": labels})

    def evaluated_labels(self, clip: Clip) -> IntArray:
        """Return the labels of the evaluated trajectories of `clip`, (n,) int64, whichever `rows` there are.

        Raises InvalidValueError when some have none: it is another clip.
        """
        shown, labels = self._on(clip)
        every = np.full(len(clip.dense), -1)
        every[shown.evaluated] = labels
        found = every[clip.evaluated]
        if (found < 0).any():
            expected = f"labels of its {len(found)} evaluated trajectories"
            raise InvalidValueError(f"clip {clip.name}", expected=expected, found=f"{(found >= 0).sum()}")
        return found

    def _on(self, clip: Clip) -> tuple[Clip, IntArray]:
        """Give the clip with the rows of these labels as the evaluated ones, and the labels."""
        if self.rows is not None and len(clip.dense) > self.rows.max(initial=-1):
            known = np.zeros(len(clip.dense), dtype=np.int64)
            known[clip.evaluated] = clip.labels.label
            clip = replace(clip, evaluated=self.rows, labels=replace(clip.labels, label=known[self.rows]))
        if len(clip.evaluated) != len(self.labels):
            expected, found = f"{len(self.labels)} evaluated trajectories", f"{len(clip.evaluated)}"
            raise InvalidValueError(f"clip {clip.name}", expected=expected, found=found)
        return clip, self.labels


class Method(Protocol):
    """A segmentation method: a frozen dataclass of parameters with one verb.

    One that never draws from `rng` may have a class attribute ``deterministic = True``; a benchmark then
    runs it once for all seeds.
    """

    def segment(self, clip: Clip, *, n_motions: int | None, rng: np.random.Generator) -> Segmentation:
        """Segment the evaluated trajectories of `clip` into `n_motions` motions.

        Parameters
        ----------
        clip : Clip
            The sequence; a method must not use its labels.
        n_motions : int or None
            Number of motions; None where the method finds it itself.
        rng : numpy.random.Generator
            The only source of randomness.

        Raises
        ------
        SegmentationError
            When the clip cannot be segmented by this method.
        """
        ...
