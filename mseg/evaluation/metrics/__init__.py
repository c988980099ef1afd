"""The metrics: pure functions of a contingency table, and this table of their names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Literal

from kt3dmoseg.registry import Registry
from mseg.evaluation.contingency import Contingency
from mseg.evaluation.metrics import motions, partition, regions


@dataclass(frozen=True)
class Metric:
    """A metric with what a table must know about it.

    Parameters
    ----------
    function : callable
        From a contingency table to a number; never NaN.
    title : str
        Head of its column.
    better : {"lower", "higher"}
        Which way is good.
    worst : callable
        The value of a failed or missing clip, from the number of its motions.
    percent : bool
        Whether it is a fraction that tables print in per cent.
    """

    function: Callable[[Contingency], float]
    title: str
    better: Literal["lower", "higher"]
    worst: Callable[[int], float]
    percent: bool = True

    def __call__(self, table: Contingency) -> float:
        """Compute the metric."""
        return self.function(table)


def _one(n_motions: int) -> float:
    return 1.0


def _zero(n_motions: int) -> float:
    return 0.0


def _all(n_motions: int) -> float:
    return float(n_motions)


def _below_chance(n_motions: int) -> float:
    return -0.5  # the lower bound of the adjusted Rand index (Chacon and Rastrojo 2023)


ERROR = Metric(partition.classification_error, "error", "lower", _one)
ADJUSTED_RAND = Metric(partition.adjusted_rand, "adj. Rand", "higher", _below_chance)
NMI = Metric(partition.normalised_mutual_information, "NMI", "higher", _zero)
PRECISION = Metric(motions.precision, "precision", "higher", _zero)
RECALL = Metric(motions.recall, "recall", "higher", _zero)
F_MEASURE = Metric(motions.f_measure, "F", "higher", _zero)
IOU = Metric(motions.iou, "IoU", "higher", _zero)
MOVING_ERROR = Metric(motions.moving_error, "moving error", "lower", _one)
MOVING_F = Metric(motions.moving_f, "moving F", "higher", _zero)
OVER = Metric(partition.over_segmentation, "over-seg.", "lower", _one)
UNDER = Metric(partition.under_segmentation, "under-seg.", "lower", _one)
COUNT_ERROR = Metric(partition.motion_count_error, "count error", "lower", _all, percent=False)
REGION_PRECISION = Metric(regions.region_precision, "region P", "higher", _zero)
REGION_RECALL = Metric(regions.region_recall, "region R", "higher", _zero)
REGION_F = Metric(regions.region_f, "region F", "higher", _zero)
OBJECTS = Metric(regions.objects_found, "objects F>=.75", "higher", _zero, percent=False)

METRICS = Registry(
    "metric",
    {
        "error": "mseg.evaluation.metrics:ERROR",
        "adjusted_rand": "mseg.evaluation.metrics:ADJUSTED_RAND",
        "nmi": "mseg.evaluation.metrics:NMI",
        "precision": "mseg.evaluation.metrics:PRECISION",
        "recall": "mseg.evaluation.metrics:RECALL",
        "f_measure": "mseg.evaluation.metrics:F_MEASURE",
        "iou": "mseg.evaluation.metrics:IOU",
        "moving_error": "mseg.evaluation.metrics:MOVING_ERROR",
        "moving_f": "mseg.evaluation.metrics:MOVING_F",
        "over_segmentation": "mseg.evaluation.metrics:OVER",
        "under_segmentation": "mseg.evaluation.metrics:UNDER",
        "count_error": "mseg.evaluation.metrics:COUNT_ERROR",
        "region_precision": "mseg.evaluation.metrics:REGION_PRECISION",
        "region_recall": "mseg.evaluation.metrics:REGION_RECALL",
        "region_f": "mseg.evaluation.metrics:REGION_F",
        "objects": "mseg.evaluation.metrics:OBJECTS",
    },
    group="mseg.metrics",
)


@cache
def all_metrics() -> dict[str, Metric]:
    """Every metric by name, third parties' included."""
    return {name: METRICS.load(name) for name in METRICS.names()}
