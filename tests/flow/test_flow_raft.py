"""The RAFT adapter around a fake torch: errors when something is missing, and what it passes on."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from fake_torch import Array, Module, install

from kt3dmoseg import flow
from kt3dmoseg.errors import MissingDependencyError
from kt3dmoseg.flow import backend_identity


class Network(Module):
    """Notes its input; the flow is (column, row) of each padded pixel."""

    seen = ()

    def __init__(self, weights):
        assert weights is None  # torchvision would download its own

    def __call__(self, a, b, num_flow_updates):
        Network.seen = a.array, b.array, num_flow_updates
        height, width = a.array.shape[2:]
        rows, columns = np.indices((height, width))
        return [None, Array(np.stack([columns, rows])[None])]


@pytest.fixture
def torch(monkeypatch):
    torch = install(monkeypatch, "torchvision", "torchvision.models")
    nets = SimpleNamespace(raft_large=Network, raft_small=None)
    sys.modules["torchvision.models"].optical_flow = nets
    return torch


@pytest.fixture
def frames(rng):
    return tuple(rng.integers(0, 255, (130, 45), dtype=np.uint8) for _ in range(2))


@pytest.mark.parametrize("package", ["torch", "torchvision"])
def test_a_missing_package_is_named(torch, frames, monkeypatch, package):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingDependencyError, match=rf"no {package}; pip install 'kt3dmoseg\[gpu\]'"):
        flow.create("raft")(*frames)


def test_missing_weights_are_named(torch, frames):
    with pytest.raises(
        MissingDependencyError, match=r"raft: weights: .* found none; .*weights=FILE; nothing is downloaded"
    ):
        flow.create("raft")(*frames)


def test_a_missing_weights_file_is_named(torch, frames):
    def absent(path, **_):
        raise FileNotFoundError(f"{path} not found")

    torch.load = absent
    with pytest.raises(MissingDependencyError, match=r"weights my\.pth: .*not found"):
        flow.create("raft", weights="my.pth")(*frames)


def test_frames_are_padded_for_the_network_and_its_flow_is_cut_back(torch, frames):
    field = flow.create("raft", weights="my.pth", updates=7)(*frames)
    a, _, updates = Network.seen
    assert a.shape == (1, 3, 136, 128)
    assert updates == 7
    np.testing.assert_allclose(a[0, 1, :130, :45], frames[0] / 127.5 - 1, atol=1e-6)
    assert field.shape == (130, 45, 2)
    assert field.dtype == np.float32
    assert field[100, 30].tolist() == [30, 100]


def test_torch_and_torchvision_that_do_not_fit_are_reported(torch, frames, monkeypatch):
    class Unfit:
        def find_spec(self, name, *_):
            if name == "torchvision":
                raise RuntimeError("operator torchvision::nms does not exist")

    monkeypatch.delitem(sys.modules, "torchvision")
    monkeypatch.setattr(sys, "meta_path", [Unfit(), *sys.meta_path])
    with pytest.raises(MissingDependencyError, match=r"torchvision, found RuntimeError: operator .*nms"):
        flow.create("raft")(*frames)


def test_a_device_that_is_not_there_is_named(torch, frames):
    with pytest.raises(MissingDependencyError, match=r"device cuda: .*CUDA enabled; use device=cpu"):
        flow.create("raft", weights="my.pth", device="cuda")(*frames)


def test_the_cache_identifies_weights_by_content(tmp_path):
    one, other = tmp_path / "one.pth", tmp_path / "other.pth"
    one.write_bytes(b"1")
    other.write_bytes(b"1")
    first = backend_identity(flow.create("raft", weights=str(one)))
    assert first == backend_identity(flow.create("raft", weights=str(other)))
    assert str(tmp_path) not in str(first)
    one.write_bytes(b"2")
    assert first != backend_identity(flow.create("raft", weights=str(one)))
