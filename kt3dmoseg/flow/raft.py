"""RAFT from torchvision: an adapter, imported on demand."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, Literal

import numpy as np

from kt3dmoseg.errors import MissingDependencyError
from kt3dmoseg.flow import check_pair
from kt3dmoseg.options import option
from kt3dmoseg.types import ByteArray, Float32Array

_MULTIPLE = 8
_LEAST = 128


@dataclass(frozen=True)
class Raft:
    """RAFT (Teed and Deng, ECCV 2020) with torchvision's weights."""

    files: ClassVar[tuple[str, ...]] = ("weights",)
    packages: ClassVar[tuple[str, ...]] = ("torch", "torchvision")

    model: Literal["large", "small"] = option("large", "which of torchvision's two networks")
    weights: str = option("", "file with the network's state; by default torchvision's, downloaded once")
    updates: int = option(12, "recurrent updates of the flow", low=1, high=100)
    device: str = option("cpu", "where torch computes: cpu, cuda, ...")

    def __call__(self, a: ByteArray, b: ByteArray) -> Float32Array:
        """Displacement of every pixel of `a`; see `kt3dmoseg.flow.Flow`.

        Raises
        ------
        MissingDependencyError
            When torch, torchvision or the weights are not there.
        """
        check_pair(a, b)
        torch = _torch()
        network = _network(self.model, self.weights, self.device)
        with torch.inference_mode():
            pair = [torch.from_numpy(_prepared(frame)).to(self.device) for frame in (a, b)]
            field = network(*pair, num_flow_updates=self.updates)[-1][0]
        height, width = a.shape
        return np.ascontiguousarray(field.permute(1, 2, 0).cpu().numpy()[:height, :width], dtype=np.float32)


def _prepared(frame: ByteArray) -> Float32Array:
    """Three equal channels in -1..1, the sides padded to what the network takes."""
    padding = [(0, max(_LEAST, -(-side // _MULTIPLE) * _MULTIPLE) - side) for side in frame.shape]
    padded = np.pad(frame, padding, mode="edge").astype(np.float32) / 127.5 - 1
    return np.repeat(padded[None, None], 3, axis=1)


def _torch() -> Any:  # noqa: ANN401
    try:
        import torch
        import torchvision  # noqa: F401
    except Exception as error:  # of two releases that do not fit: RuntimeError, OSError, ...
        missing = error.name if isinstance(error, ModuleNotFoundError) else None
        raise MissingDependencyError(
            "flow raft",
            expected="torch and torchvision of matching releases",
            found=f"no {missing}" if missing else _first_sentence(error),
            fix="pip install 'kt3dmoseg[gpu]', or use another flow: dis",
        ) from error
    return torch


@cache
def _network(model: str, weights: str, device: str) -> Any:  # noqa: ANN401
    torch = _torch()
    from torchvision.models import optical_flow

    build = getattr(optical_flow, f"raft_{model}")
    try:
        if weights:
            network = build(weights=None)
            network.load_state_dict(torch.load(weights, map_location="cpu", weights_only=True))
        else:
            network = build(weights="DEFAULT")
    except Exception as error:  # torch raises a different class for each way a file or download fails
        raise MissingDependencyError(
            f"flow raft: weights {weights or 'of torchvision'}",
            found=_first_sentence(error),
            fix="connect once so that torchvision can fetch them, or give weights=FILE",
        ) from error
    try:
        return network.eval().to(device)
    except Exception as error:  # the same holds for devices
        raise MissingDependencyError(
            f"flow raft: device {device}", found=_first_sentence(error), fix="use device=cpu"
        ) from error


def _first_sentence(error: Exception) -> str:
    # Of weights that hold code, torch's next sentence is how to run it.
    text = str(error).partition("\n")[0].partition(". ")[0]
    return f"{type(error).__name__}: {text or 'no detail'}"
