"""The methods, each a frozen dataclass, and this table of their names; the paper's six are in `paper`."""

from __future__ import annotations

import builtins
import traceback
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from kt3dmoseg.errors import InvalidValueError, KT3DMoSegError
from kt3dmoseg.io.fields import check_axes
from kt3dmoseg.options import from_mapping
from kt3dmoseg.registry import Registry, strict
from kt3dmoseg.types import BoolArray, Clip, FloatArray, Labels, Trajectories
from mseg.errors import FaultyMethodError
from mseg.spreading import spread_labels
from mseg.types import Method, Segmentation

ALGORITHM_VERSION: int = 11
"""Part of the identity of stored results; raised by hand whenever the labels of a method change."""

# Largest number of trajectories that are segmented where all are labelled: kernels grow with its square.
_MOST = 2000
# Pixels that tracks of others leave a picture by.
_BESIDE = 8.0
_FRACTION = 1.5  # without a size, what lies within is not in pixels
_FAULT = "this is a fault of the method"

METHODS = Registry(
    "method",
    {
        "one_motion": "mseg.methods.paper:OneMotion",
        "prevalence": "mseg.methods.paper:OneMotion",
        "affine": "mseg.methods.paper:Affine",
        "homography": "mseg.methods.paper:Homography",
        "fundamental": "mseg.methods.paper:Fundamental",
        "keradd": "mseg.methods.paper:KerAdd",
        "coreg": "mseg.methods.paper:CoReg",
        "subset": "mseg.methods.paper:Subset",
        "lsa": "mseg.methods.subspaces:LSA",
        "gpca": "mseg.methods.subspaces:GPCA",
        "alc": "mseg.methods.alc:ALC",
        "ssc": "mseg.methods.self_expression:SSC",
        "tpv": "mseg.methods.tpv:TPV",
        "lrr": "mseg.methods.self_expression:LRR",
        "tlinkage": "mseg.methods.preferences:TLinkage",
        "s3c": "mseg.methods.self_expression:S3C",
        "rsim": "mseg.methods.subspaces:RSIM",
        "mssc": "mseg.methods.paper:MSSC",
        "ransac": "mseg.methods.subspaces:Ransac",
        "rpa": "mseg.methods.preferences:RPA",
        "lrssc": "mseg.methods.self_expression:LRSSC",
        "consistent": "mseg.methods.consistent:ConsistentMoSeg",
        "multibody": "mseg.methods.multibody:MultiBody",
    },
    group="mseg.methods",
)


def list() -> builtins.list[str]:
    """Names of all methods, third parties' included."""
    return METHODS.names()


@strict
def create(name: str, **parameters: Any) -> Method:  # noqa: ANN401
    """Make a method from its name and parameters.

    Raises
    ------
    UnknownNameError
        For an unknown method or a misspelt parameter, with the nearest name.
    InvalidValueError
        For a parameter of the wrong type or out of bounds, or a method that is no dataclass with defaults.
    KT3DMoSegError
        For a method of a third party that cannot be imported.
    """
    method: Method = from_mapping(METHODS.load(name), parameters, where=f"method {name}")
    return method


@strict
def segment(
    clip: Clip | Trajectories | npt.ArrayLike | tuple[npt.ArrayLike, npt.ArrayLike],
    method: str | Method = "subset",
    *,
    n_motions: int | None = None,
    seed: int = 0,
    visible: npt.ArrayLike | None = None,
    rows: Literal["evaluated", "all"] = "evaluated",
    **parameters: Any,  # noqa: ANN401
) -> Segmentation:
    """Segment the evaluated trajectories of a clip, or all of some trajectories.

    Parameters
    ----------
    clip : Clip, Trajectories, (N, F, 2) array, or pair of arrays (xy, visible)
        The sequence; its labels are not looked at. Arrays hold pixels; by default a point is visible where
        both coordinates are finite.
    method : str or Method
        A name of `list`, or a method object.
    n_motions : int or None
        Number of motions, background included; None for methods that find it themselves.
    seed : int
        Same seed, same labels.
    visible : (N, F) bool, optional
        Where the points of an array are visible, and finite.
    rows : {"evaluated", "all"}
        What is labelled. With "all", the method segments the evaluated trajectories, or 2,000 of them drawn
        at random when there are more, and every other one gets the label of the nearest in position and
        motion.
    **parameters
        Parameters of the method, when it is given by name.

    Returns
    -------
    Segmentation
        One label per (evaluated) trajectory; with "all" also `rows`. ``report["notes"]`` has one sentence
        each on another number of groups than asked for, outliers that were not asked for, a method that did
        not converge, parts of the clip that no trajectory links, and what the method has in
        ``report["warnings"]``.

    Raises
    ------
    SegmentationError
        When the method cannot segment this clip; where it raised another error, from that one.
    UnknownNameError, InvalidValueError
        For a bad method name, parameter, number of motions, seed, clip or array.
    """
    from mseg.kernels import parts  # which takes long to import

    check_whole("seed", seed, 0)
    seed = int(seed)  # of few bits, numpy's would overflow
    if n_motions is not None:
        check_whole("n_motions", n_motions, 1)
        n_motions = int(n_motions)
    if not isinstance(method, str) and parameters:
        raise InvalidValueError("parameters", expected="none with a method object", found=str([*parameters]))
    hidden = _clip(clip, visible).without_labels()
    if rows == "all" and len(hidden.evaluated) > _MOST:
        drawn = np.random.default_rng(seed).choice(hidden.evaluated, _MOST, replace=False)
        hidden = replace(hidden, evaluated=np.sort(drawn), labels=Labels(np.zeros(_MOST, dtype=np.int64)))
    chosen = create(method, **parameters) if isinstance(method, str) else method
    if isinstance(chosen, type):
        expected = "the name of a method, or an object with the function segment"
        raise InvalidValueError("method", expected=expected, found=f"{chosen!r:.60}")
    result = _segmentation(chosen, hidden, n_motions, seed)
    outliers, gap = bool(getattr(chosen, "reject_outliers", False)), getattr(chosen, "gap", 1)
    part = parts(hidden.evaluated_trajectories.visible, gap if isinstance(gap, int) else 1)
    notes = _notes(result, n_motions, outliers=outliers, parts=int(part.max(initial=-1)) + 1)
    report = {**result.report, "notes": notes}
    if rows == "evaluated":
        return Segmentation(result.labels, report)
    every = spread_labels(hidden.dense, hidden.evaluated, result.labels)
    report["trajectories_segmented"] = len(hidden.evaluated)
    return Segmentation(every, report, np.arange(len(every)))


def _segmentation(method: Method, clip: Clip, n_motions: int | None, seed: int) -> Segmentation:
    """Call a method; whatever it does wrong is a FaultyMethodError, which in a run costs this clip only."""
    try:
        # With several BLAS threads sums are rounded in another order: one, for the same bytes anywhere.
        with threadpool_limits(limits=1, user_api="blas"):
            result = method.segment(clip, n_motions=n_motions, rng=np.random.default_rng(seed))
    except (KT3DMoSegError, MemoryError):
        raise
    except (Exception, SystemExit) as error:
        frames = traceback.extract_tb(error.__traceback__)
        place = [frame for frame in frames if frame.filename == frames[:2][-1].filename][-1]
        found = f"{type(error).__name__} in {Path(place.filename).name}, line {place.lineno}: {error}"
        raise FaultyMethodError(clip.name, found=found, fix=_FAULT) from error
    given = len(result.labels) if isinstance(result, Segmentation) else type(result).__name__
    if given != len(clip.evaluated):
        expected = f"a Segmentation of {len(clip.evaluated)} labels"
        raise FaultyMethodError(clip.name, expected=expected, found=f"{given}", fix=_FAULT)
    return result


def check_whole(name: str, value: object, least: int) -> None:
    """Raise InvalidValueError for anything but a whole number that is at least `least`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        expected = f"a whole number, {least} or more"
        raise InvalidValueError(name, expected=expected, found=f"{value!r:.60}")


def _clip(value: Any, visible: npt.ArrayLike | None) -> Clip:  # noqa: ANN401  # checked
    if not isinstance(value, (Clip, Trajectories)):
        pair = isinstance(value, tuple) and len(value) == 2
        if pair and visible is not None:
            raise InvalidValueError("visible", expected="nothing with a pair (xy, visible)", found="an array")
        value = _trajectories(*(value if pair else (value, visible)))
    elif visible is not None:
        raise InvalidValueError("visible", expected="nothing with a clip", found="an array")
    if isinstance(value, Clip):
        clip = value
    else:
        clip = Clip("clip", value, np.arange(len(value)), Labels(np.zeros(len(value), dtype=np.int64)))
    _check_pixels(clip.name, clip.dense.xy[clip.dense.visible], clip.dense.image_size)
    return clip


def _check_pixels(name: str, points: FloatArray, size: tuple[int, int] | None) -> None:
    """Refuse points (n, 2) that cannot be pixels of a picture of that size: thresholds would mean nothing."""
    if not points.size:
        return
    farthest = float(np.abs(points).max())
    if farthest <= (_FRACTION if size is None else min(size) / 16):
        found, fix = f"all within {farthest:.3g}", "multiply fractions by width and height, and subtract 0.5"
    elif size and np.median(((points < -_BESIDE) | (points > np.add(size, _BESIDE))).any(axis=1)) == 1:
        found, fix = f"most points outside, up to {farthest:.4g}", "give the size of the frames tracked"
    else:
        return
    expected = f"pixels of {size[0]} x {size[1]}" if size else "pixels"
    raise InvalidValueError(name, expected=expected, found=found, fix=fix)


def _trajectories(points: Any, visible: npt.ArrayLike | None) -> Trajectories:  # noqa: ANN401  # checked
    try:
        given = np.ma.asanyarray(points).astype(
            np.float64, casting="same_kind"
        )  # of complex numbers a TypeError
        xy: FloatArray = np.ma.filled(given, np.nan)
    except (TypeError, ValueError):
        expected = "a Clip, Trajectories, an array (N, F, 2) or (xy, visible)"
        fix = "kt3dmoseg.load(path) reads a file"
        raise InvalidValueError("clip", expected=expected, found=f"{points!r:.60}", fix=fix) from None
    if xy.ndim != 3 or xy.shape[2] != 2:
        raise InvalidValueError("xy", expected="shape (N, F, 2)", found=f"{xy.shape}")
    mask = np.asarray(np.isfinite(xy).all(axis=2) if visible is None else visible)
    if np.ma.is_masked(visible):
        raise InvalidValueError(
            "visible", expected="no masked values", found="some", fix="give True or False"
        )
    if not np.isin(mask, (0, 1)).all():
        raise InvalidValueError("visible", expected="True or False", found=f"values of type {mask.dtype}")
    seen: BoolArray = mask.astype(np.bool_)
    if seen.shape == xy.shape[:2]:  # else Trajectories raises
        xy[~seen] = np.nan
        check_axes("xy", xy, seen)
    return Trajectories(xy, seen)


def _notes(result: Segmentation, n_motions: int | None, *, outliers: bool, parts: int) -> tuple[str, ...]:
    """Say what one must know to trust the labels."""
    found, none = len(np.unique(result.labels[result.labels > 0])), int((result.labels == 0).sum())
    converged = [value for key, value in result.report.items() if key.endswith("converged")]
    notes = {
        f"groups found: {found}, asked for: {n_motions}": n_motions not in (None, found),
        f"{none} trajectories are outliers (label 0), which was not asked for": none and not outliers,
        "the method did not converge": not all(converged),
        f"{parts} parts of the clip have no trajectory in common; none of their motions were seen together": (
            parts > 1
        ),
        **dict.fromkeys(result.report.get("warnings", ()), True),
    }
    return tuple(note for note, applies in notes.items() if applies)
