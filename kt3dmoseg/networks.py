"""Networks of others, run through torch: the user has their code and weights; what is missing is named."""

from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from typing import Any, ClassVar

from kt3dmoseg.errors import MissingDependencyError
from kt3dmoseg.options import option


@dataclass(frozen=True)
class TorchNetwork:
    """What adapters of networks have in common; nothing is ever downloaded.

    A subclass states what it is called in messages, the packages that it needs and how to get them, and
    makes the network with the weights of a state (`make`).
    """

    called: ClassVar[str]
    packages: ClassVar[tuple[str, ...]]
    install: ClassVar[str]
    files: ClassVar[tuple[str, ...]] = ("weights",)

    weights: str = option("", "file with the network's state", metavar="FILE")
    device: str = option("cpu", "where torch computes: cpu, cuda, ...")

    def make(self, state: Any) -> Any:  # noqa: ANN401  # a dictionary of tensors, a module of torch
        """Return the network with the weights of a state."""
        raise NotImplementedError


@lru_cache(maxsize=2)
def network(adapter: TorchNetwork) -> tuple[Any, Any]:
    """Return torch and an adapter's network, ready for inference.

    MissingDependencyError when a package, the weights or the device are not there, or do not fit each other.
    """
    try:
        torch: Any = import_module("torch")
        for package in adapter.packages:
            import_module(package)
    except Exception as error:  # of two releases that do not fit: RuntimeError, OSError, ...
        missing = error.name if isinstance(error, ModuleNotFoundError) else None
        found = f"no {missing}" if missing else _first_sentence(error)
        expected, fix = " and ".join(adapter.packages), adapter.install
        raise MissingDependencyError(adapter.called, expected=expected, found=found, fix=fix) from error
    where, fix = f"{adapter.called}: weights", "give the parameter weights=FILE; nothing is downloaded"
    if not adapter.weights:
        raise MissingDependencyError(where, expected="a file with the network's state", found="none", fix=fix)
    try:
        made = adapter.make(torch.load(adapter.weights, map_location="cpu", weights_only=True))
    except Exception as error:  # torch raises a different class for each way a file fails
        found = _first_sentence(error)
        raise MissingDependencyError(f"{where} {adapter.weights}", found=found, fix=fix) from error
    try:
        return torch, made.eval().to(adapter.device)
    except Exception as error:  # the same holds for devices
        where, found = f"{adapter.called}: device {adapter.device}", _first_sentence(error)
        raise MissingDependencyError(where, found=found, fix="use device=cpu") from error


def _first_sentence(error: Exception) -> str:
    # Of weights that hold code, torch's next sentence is how to run it.
    text = str(error).partition("\n")[0].partition(". ")[0]
    return f"{type(error).__name__}: {text or 'no detail'}"
