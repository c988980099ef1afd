"""The methods, each a frozen dataclass, and this table of their names; the paper's six are in `paper`."""

from __future__ import annotations

import builtins
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.options import from_mapping
from kt3dmoseg.registry import Registry
from kt3dmoseg.types import Clip
from mseg.errors import SegmentationError
from mseg.types import Method, Segmentation

ALGORITHM_VERSION: int = 1
"""Part of the identity of stored results; raised by hand whenever the labels of a method change."""

METHODS = Registry(
    "method",
    {
        "one_motion": "mseg.methods.one_motion:OneMotion",
        "prevalence": "mseg.methods.one_motion:OneMotion",
        "affine": "mseg.methods.paper:Affine",
        "homography": "mseg.methods.paper:Homography",
        "fundamental": "mseg.methods.paper:Fundamental",
        "keradd": "mseg.methods.paper:KerAdd",
        "coreg": "mseg.methods.paper:CoReg",
        "subset": "mseg.methods.paper:Subset",
        "lsa": "mseg.methods.lsa:LSA",
        "gpca": "mseg.methods.gpca:GPCA",
        "alc": "mseg.methods.alc:ALC",
        "ssc": "mseg.methods.ssc:SSC",
        "tpv": "mseg.methods.tpv:TPV",
        "lrr": "mseg.methods.lrr:LRR",
        "tlinkage": "mseg.methods.tlinkage:TLinkage",
        "s3c": "mseg.methods.s3c:S3C",
        "rsim": "mseg.methods.rsim:RSIM",
        "mssc": "mseg.methods.mssc:MSSC",
        "ransac": "mseg.methods.ransac:Ransac",
        "rpa": "mseg.methods.rpa:RPA",
        "lrssc": "mseg.methods.lrssc:LRSSC",
        "consistent": "mseg.methods.consistent:ConsistentMoSeg",
    },
    group="mseg.methods",
)


def list() -> builtins.list[str]:
    """Names of all methods, third parties' included."""
    return METHODS.names()


def create(name: str, **parameters: Any) -> Method:  # noqa: ANN401
    """Make a method from its name and parameters.

    Raises
    ------
    UnknownNameError
        For an unknown method or a misspelt parameter, with the nearest name.
    InvalidValueError
        For a parameter of the wrong type or out of bounds.
    """
    method: Method = from_mapping(METHODS.load(name), parameters, where=f"method {name}")
    return method


def segment(
    clip: Clip,
    method: str | Method = "subset",
    *,
    n_motions: int | None = None,
    seed: int = 0,
    **parameters: Any,  # noqa: ANN401
) -> Segmentation:
    """Segment the evaluated trajectories of a clip.

    Parameters
    ----------
    clip : Clip
        The sequence; its labels are not looked at.
    method : str or Method
        A name of `list`, or a method object.
    n_motions : int or None
        Number of motions, background included; None for methods that find it themselves.
    seed : int
        Same seed, same labels.
    **parameters
        Parameters of the method, when it is given by name.

    Returns
    -------
    Segmentation
        One label per evaluated trajectory.

    Raises
    ------
    SegmentationError
        When the method cannot segment this clip.
    UnknownNameError, InvalidValueError
        For a bad method name, parameter or number of motions.
    """
    if n_motions is not None and n_motions < 1:
        raise InvalidValueError("n_motions", expected="at least 1", found=str(n_motions))
    chosen = create(method, **parameters) if isinstance(method, str) else method
    hidden = clip.without_labels()
    # With several BLAS threads sums are rounded in another order: one, for the same bytes anywhere.
    with threadpool_limits(limits=1, user_api="blas"):
        result = chosen.segment(hidden, n_motions=n_motions, rng=np.random.default_rng(seed))
    if len(result.labels) != len(clip.evaluated):
        raise SegmentationError(
            f"{method} on {clip.name}",
            expected=f"{len(clip.evaluated)} labels",
            found=f"{len(result.labels)}",
            fix="this is a fault of the method",
        )
    return result
