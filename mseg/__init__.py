"""mseg: 3D motion segmentation of point trajectories; methods and evaluation."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from kt3dmoseg import __version__ as __version__

if TYPE_CHECKING:
    from mseg import benchmark as benchmark
    from mseg import methods as methods
    from mseg.evaluation import score as score
    from mseg.methods import segment as segment
    from mseg.types import Hypotheses as Hypotheses
    from mseg.types import Segmentation as Segmentation

# Public names and where they live; imported on first use so that `--help` stays fast.
_PUBLIC = {
    "segment": "mseg.methods",
    "score": "mseg.evaluation",
    "Segmentation": "mseg.types",
    "Hypotheses": "mseg.types",
}
_MODULES = ("methods", "benchmark", "errors", "types")

__all__ = [*_PUBLIC, *_MODULES, "__version__"]  # noqa: PLE0604


def __getattr__(name: str) -> Any:  # noqa: ANN401
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    if name in _MODULES:
        return import_module(f"mseg.{name}")
    raise AttributeError(f"module 'mseg' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
