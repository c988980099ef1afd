"""As much of torch as the adapters of networks use, around arrays."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from types import ModuleType

from kt3dmoseg.networks import network


class Array:
    """As much of a tensor as the adapters use, around an array."""

    def __init__(self, array):
        self.array = array

    def to(self, device):
        return self

    def __getitem__(self, item):
        return Array(self.array[item])

    def permute(self, *axes):
        return Array(self.array.transpose(axes))

    def cpu(self):
        return self

    def numpy(self):
        return self.array


class Module:
    """As much of a network: it keeps the state that it is given."""

    def load_state_dict(self, state):
        self.state = dict(state)

    def eval(self):
        return self

    def to(self, device):
        if device == "cuda":
            raise AssertionError("Torch not compiled with CUDA enabled")
        return self


def install(monkeypatch, *others):
    """Put a torch and empty packages of other names where they are imported from; return torch."""
    network.cache_clear()
    for name in ("torch", *others):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    torch = sys.modules["torch"]
    torch.from_numpy, torch.inference_mode = Array, nullcontext
    torch.load = lambda path, **_: {"from": path}
    return torch
