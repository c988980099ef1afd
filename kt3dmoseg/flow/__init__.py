"""Optical flow: one file and one frozen dataclass per backend, and this table of their names.

>>> flow = create("dis")
>>> field = flow(a, b)  # (H, W, 2) float32  # doctest: +SKIP
"""

from __future__ import annotations

import builtins
from typing import Any

from kt3dmoseg.flow.base import Flow, check_pair
from kt3dmoseg.flow.cache import FlowCache, flow_pair
from kt3dmoseg.flow.sampling import sample
from kt3dmoseg.options import from_mapping
from kt3dmoseg.registry import Registry

FLOWS = Registry(
    "flow",
    {
        "dis": "kt3dmoseg.flow.pyramid:VariationalPyramid",
        "dis_medium": "kt3dmoseg.flow.dis:DisMedium",
        "farneback": "kt3dmoseg.flow.farneback:Farneback",
        "files": "kt3dmoseg.flow.from_files:FlowFiles",
        "raft": "kt3dmoseg.flow.raft:Raft",
    },
    group="kt3dmoseg.flows",
)

__all__ = ["FLOWS", "Flow", "FlowCache", "check_pair", "create", "flow_pair", "list", "sample"]


def list() -> builtins.list[str]:
    """Names of all flow backends, third parties' included."""
    return FLOWS.names()


def create(name: str, **parameters: Any) -> Flow:  # noqa: ANN401
    """Make a flow backend from its name and parameters.

    Parameters
    ----------
    name : str
        A name of `list`.
    **parameters
        Fields of the backend's dataclass; strings are converted.

    Raises
    ------
    UnknownNameError
        For an unknown backend or a misspelt parameter, with the nearest name.
    InvalidValueError
        For a parameter of the wrong type or out of bounds.
    MissingDependencyError
        When the backend needs a package that is not installed.
    """
    backend: Flow = from_mapping(FLOWS.load(name), parameters, where=f"flow {name}")
    return backend
