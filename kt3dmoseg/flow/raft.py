"""RAFT from torchvision: an adapter, imported on demand."""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from kt3dmoseg.flow import check_pair
from kt3dmoseg.networks import TorchNetwork, network
from kt3dmoseg.options import option
from kt3dmoseg.types import ByteArray, Float32Array

_MULTIPLE = 8
_LEAST = 128


@dataclass(frozen=True)
class Raft(TorchNetwork):
    """RAFT (Teed and Deng, ECCV 2020) as torchvision has it."""

    called: ClassVar[str] = "flow raft"
    packages: ClassVar[tuple[str, ...]] = ("torch", "torchvision")
    install: ClassVar[str] = "pip install 'kt3dmoseg[gpu]' with matching releases, or use another flow: dis"

    model: Literal["large", "small"] = option("large", "which of torchvision's two networks")
    updates: int = option(12, "recurrent updates of the flow", low=1, high=100)

    def __call__(self, a: ByteArray, b: ByteArray) -> Float32Array:
        """Displacement of every pixel of `a`; see `kt3dmoseg.flow.Flow` and `kt3dmoseg.networks.network`."""
        check_pair(a, b)
        torch, raft = network(self)
        with torch.inference_mode():
            pair = [torch.from_numpy(_prepared(frame)).to(self.device) for frame in (a, b)]
            field = raft(*pair, num_flow_updates=self.updates)[-1][0]
        height, width = a.shape
        return np.ascontiguousarray(field.permute(1, 2, 0).cpu().numpy()[:height, :width], dtype=np.float32)

    def make(self, state: Any) -> Any:  # noqa: ANN401
        """Return torchvision's network with these weights."""
        from torchvision.models import optical_flow

        made = getattr(optical_flow, f"raft_{self.model}")(weights=None)
        made.load_state_dict(state)
        return made


def _prepared(frame: ByteArray) -> Float32Array:
    """Three equal channels in -1..1, the sides padded to what the network takes."""
    padding = [(0, max(_LEAST, -(-side // _MULTIPLE) * _MULTIPLE) - side) for side in frame.shape]
    padded = np.pad(frame, padding, mode="edge").astype(np.float32) / 127.5 - 1
    return np.repeat(padded[None, None], 3, axis=1)
