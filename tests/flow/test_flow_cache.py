"""The flow cache never serves anything but what the backend would compute."""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np
import pytest

import kt3dmoseg
from kt3dmoseg import flow
from kt3dmoseg.errors import InputFileError
from kt3dmoseg.flow import backend_identity, cached_flow, flow_pair
from kt3dmoseg.options import option

ALGORITHM_VERSION = 1
CALLS = []


@dataclass(frozen=True)
class Counting:
    """A backend that notes when it computes."""

    factor: float = option(1.0, "multiplies the mean difference")

    def __call__(self, a, b):
        CALLS.append(self.factor)
        value = self.factor * (float(b.mean()) - float(a.mean()))
        return np.full((*a.shape, 2), value, np.float32)


@pytest.fixture(autouse=True)
def no_calls():
    CALLS.clear()


@pytest.fixture
def pair(rng):
    return tuple(rng.integers(0, 255, (40, 50), dtype=np.uint8) for _ in range(2))


def only_entry(folder):
    (path,) = [p for p in folder.rglob("*") if p.is_file()]
    return path


def test_each_direction_is_computed_once(tmp_path, pair):
    first = flow_pair(Counting(), *pair, tmp_path)
    again = flow_pair(Counting(), *pair, tmp_path)
    reverse = flow_pair(Counting(), *pair[::-1], tmp_path)
    assert len(CALLS) == 2
    for one, two, three in zip(first, again, reversed(reverse), strict=True):
        assert one.dtype == two.dtype == np.float32
        np.testing.assert_array_equal(one, two)
        np.testing.assert_array_equal(one, three)


def test_without_cache_both_directions(pair):
    forward, backward = flow_pair(Counting(), *pair)
    np.testing.assert_array_equal(forward, -backward)
    assert len(CALLS) == 2


def test_other_parameters_or_frames_make_another_entry(tmp_path, pair):
    a, b = pair
    cached_flow(Counting(), a, b, tmp_path)
    doubled = cached_flow(Counting(2.0), a, b, tmp_path)
    changed = b.copy()
    changed[0, 0] ^= 1
    other = cached_flow(Counting(), a, changed, tmp_path)
    np.testing.assert_array_equal(doubled, Counting(2.0)(a, b))
    np.testing.assert_array_equal(other, Counting()(a, changed))


def test_another_version_makes_another_entry(tmp_path, pair, monkeypatch):
    cached_flow(Counting(), *pair, tmp_path)
    monkeypatch.setattr(np, "__version__", "another")
    cached_flow(Counting(), *pair, tmp_path)
    monkeypatch.setattr(sys.modules[__name__], "ALGORITHM_VERSION", 2)
    cached_flow(Counting(), *pair, tmp_path)
    cached_flow(Counting(), *pair, tmp_path)
    assert len(CALLS) == 3


def test_the_versions_of_this_package_and_its_flow_count(monkeypatch):
    dis = flow.create("dis")
    seen = [backend_identity(dis)]
    monkeypatch.setattr(flow, "ALGORITHM_VERSION", 99)
    seen.append(backend_identity(dis))
    monkeypatch.setattr(kt3dmoseg, "__version__", "99")
    seen.append(backend_identity(dis))
    assert len({each["algorithm"] for each in seen}) == 3


def test_a_backend_that_states_no_version_is_not_kept(tmp_path, pair, monkeypatch):
    monkeypatch.delattr(sys.modules[__name__], "ALGORITHM_VERSION")
    for _ in range(2):
        cached_flow(Counting(), *pair, tmp_path)
    assert len(CALLS) == 2
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: b"",
        lambda content: content[:-1],
        lambda content: content[:900] + bytes([content[900] ^ 1]) + content[901:],
        lambda content: b"x" + content[1:],
        lambda content: content.replace(b"(40, 50, 2)", b"(50, 40, 2)"),
        lambda content: b"\n" * len(content),
    ],
)
def test_a_damaged_entry_is_computed_again(tmp_path, pair, damage):
    wanted = cached_flow(Counting(), *pair, tmp_path)
    path = only_entry(tmp_path)
    intact = path.read_bytes()
    path.write_bytes(damage(intact))
    np.testing.assert_array_equal(cached_flow(Counting(), *pair, tmp_path), wanted)
    assert len(CALLS) == 2
    assert path.read_bytes() == intact


def test_an_entry_under_another_name_is_not_used(tmp_path, pair):
    a, b = pair
    cached_flow(Counting(), a, b, tmp_path)
    mine = only_entry(tmp_path)
    cached_flow(Counting(), b, a, tmp_path)
    (other,) = [p for p in tmp_path.rglob("*.npz") if p != mine]
    other.write_bytes(mine.read_bytes())
    np.testing.assert_array_equal(cached_flow(Counting(), b, a, tmp_path), Counting()(b, a))


def test_what_cannot_be_named_is_not_kept(tmp_path, pair):
    def nameless(a, b):
        return Counting()(a, b)

    cached_flow(nameless, *pair, tmp_path)
    assert not list(tmp_path.iterdir())


def test_unwritable_folder_is_one_clear_error(tmp_path, pair):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputFileError, match="cannot write"):
        cached_flow(Counting(), *pair, tmp_path / "file")
