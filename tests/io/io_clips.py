"""Small clips for the tests of readers and writers: one fixed, and a hypothesis strategy."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from kt3dmoseg.types import Camera, Clip, Labels, Trajectories

_COORDINATE = st.floats(-1e6, 1e6, allow_nan=False)
_NAME = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12)


def _of_a_file(name: str) -> bool:
    return name.isprintable() and name not in ("", ".", "..") and not set(name) & set("/\\")


def small_clip(name: str = "tiny") -> Clip:
    rng = np.random.default_rng(0)
    visible = rng.random((6, 5)) > 0.3
    xy = np.where(visible[..., None], rng.random((6, 5, 2)) * 50, np.nan)
    return Clip(
        name=name,
        dense=Trajectories(xy, visible, image_size=(64, 48)),
        evaluated=np.array([0, 2, 5, 3]),
        labels=Labels(np.array([1, 1, 2, 0]), 1, {1: "background", 2: "car"}),
        frame_numbers=np.arange(7, 12),
        timestamps=np.arange(5) / 10,
        camera=Camera("image_00", np.array([[700.0, 0, 32], [0, 700, 24], [0, 0, 1]])),
        provenance={"made": "by a test", "numbers": [1, 2.5, None]},
    )


@st.composite
def clips(draw: st.DrawFn) -> Clip:
    n, frames = draw(st.integers(0, 5)), draw(st.integers(1, 5))
    visible = draw(hnp.arrays(np.bool_, (n, frames)))
    xy = draw(hnp.arrays(np.float64, (n, frames, 2), elements=_COORDINATE))
    rows = draw(st.permutations(range(n)))[: draw(st.integers(0, n))]
    size = st.tuples(st.integers(1, 9999), st.integers(1, 9999))
    matrix = hnp.arrays(np.float64, (3, 3), elements=_COORDINATE)
    return Clip(
        name=draw(_NAME.filter(_of_a_file)),
        dense=Trajectories(
            np.where(visible[..., None], xy, np.nan),
            visible,
            draw(hnp.arrays(np.int64, n, unique=True)),
            draw(st.none() | size),
        ),
        evaluated=np.array(rows, dtype=np.int64),
        labels=Labels(
            draw(hnp.arrays(np.int64, len(rows), elements=st.integers(0, 9))),
            draw(st.none() | st.integers(1, 9)),
            draw(st.dictionaries(st.integers(0, 9), _NAME, max_size=3)),
        ),
        frame_numbers=draw(hnp.arrays(np.int64, frames, unique=True)),
        timestamps=draw(st.none() | hnp.arrays(np.float64, frames, elements=_COORDINATE)),
        camera=draw(st.none() | st.builds(Camera, _NAME, st.none() | matrix)),
        provenance=draw(st.dictionaries(_NAME, st.none() | st.integers() | _NAME, max_size=3)),
    )


def assert_same_tracks(a: Trajectories, b: Trajectories) -> None:
    np.testing.assert_array_equal(a.xy.view(np.int64)[a.visible], b.xy.view(np.int64)[b.visible])
    np.testing.assert_array_equal(a.visible, b.visible)


def assert_same(a: Clip, b: Clip) -> None:
    assert_same_tracks(a.dense, b.dense)
    np.testing.assert_array_equal(a.dense.track_id, b.dense.track_id)
    assert a.dense.image_size == b.dense.image_size
    np.testing.assert_array_equal(a.evaluated, b.evaluated)
    np.testing.assert_array_equal(a.labels.label, b.labels.label)
    assert (a.labels.background, dict(a.labels.names)) == (b.labels.background, dict(b.labels.names))
    np.testing.assert_array_equal(a.frame_numbers, b.frame_numbers)
    assert (a.timestamps is None) == (b.timestamps is None)
    if a.timestamps is not None:
        np.testing.assert_array_equal(a.timestamps, b.timestamps)
    assert (a.camera is None) == (b.camera is None)
    if a.camera is not None and b.camera is not None:
        assert a.camera.name == b.camera.name
        assert (a.camera.K is None) == (b.camera.K is None)
        assert a.camera.K is None or np.array_equal(a.camera.K, b.camera.K)
    assert a.name == b.name
    assert dict(a.provenance) == dict(b.provenance)
