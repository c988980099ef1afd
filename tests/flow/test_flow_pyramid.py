"""The default flow is exact on smooth motion and finds objects with a motion of their own."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest

from kt3dmoseg import flow
from kt3dmoseg.errors import InvalidValueError


def waves(x, y, seed=0):
    """A texture known at every point, so that it can be moved exactly: waves of 8 to 60 pixels."""
    rng = np.random.default_rng(seed)
    length, turn, phase = 8 * 7.5 ** rng.random(80), *rng.uniform(0, 2 * np.pi, (2, 80))
    parts = zip(length, turn, phase, strict=True)
    total = sum(n * np.cos(2 * np.pi / n * (x * np.cos(t) + y * np.sin(t)) + p) for n, t, p in parts)
    return np.clip(np.rint(128 + 45 * total / total.std()), 0, 255).astype(np.uint8)


def test_a_zoom_is_found_to_a_few_hundredths_of_a_pixel():
    x, y = np.meshgrid(np.arange(320.0), np.arange(160.0))
    a, b = waves(x, y), waves((x + 3) / 1.03, (y + 3.5) / 1.03)
    exact = np.stack([0.03 * x - 3, 0.03 * y - 3.5], axis=2)
    error = np.linalg.norm(flow.create("dis")(a, b) - exact, axis=2)[16:-16, 16:-16]
    assert np.median(error) < 0.03
    assert np.percentile(error, 95) < 0.1


def test_an_object_keeps_a_motion_of_over_20_pixels():
    x, y = np.meshgrid(np.arange(320.0), np.arange(160.0))
    step, left = 24, 100
    a, b, patch = waves(x, y), waves(x - 2, y), waves(x, y, seed=1)[50:98, 100:164]
    a[50:98, left : left + 64] = patch
    b[50:98, left + step : left + step + 64] = patch
    field = flow.create("dis")(a, b)
    on_it, around = field[56:92, 106:158], field[16:38, 60:260]
    assert np.mean(np.linalg.norm(on_it - (step, 0), axis=2) < 0.5) > 0.9
    assert np.mean(np.linalg.norm(around - (2, 0), axis=2) < 0.2) > 0.95


def test_threads_and_other_sizes_in_between_change_nothing():
    x, y = np.meshgrid(np.arange(120.0), np.arange(90.0))
    pairs = [(waves(x, y, seed), waves(x - seed, y, seed)) for seed in range(4)]
    default, other = flow.create("dis"), flow.create("dis", alpha=30)
    alone = [default(a, b) for a, b in pairs]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(lambda pair: default(*pair), pairs))
    for (a, b), expected, found in zip(pairs, alone, together, strict=True):
        other(a[:64, :80], b[:64, :80])
        np.testing.assert_array_equal(default(a, b), expected)
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(("height", "width"), [(40, 61), (45, 52), (33, 3), (3, 33)])
def test_each_level_gives_the_bits_of_opencvs_solver(height, width):
    rng = np.random.default_rng(height)
    settings = {"alpha": 18, "delta": 2, "gamma": 6, "epsilon": 0.01}
    pyramid, solver = flow.create("dis", **settings, iterations=2), cv2.VariationalRefinement.create()
    settings |= {"omega": pyramid.overrelaxation, "fixedPointIterations": 2, "sorIterations": 5}
    for name, value in settings.items():
        getattr(solver, f"set{name[0].upper()}{name[1:]}")(value)
    first, second = rng.normal(size=(2, height, width)).astype(np.float32)
    field = rng.normal(0, 3, (height, width, 2)).astype(np.float32)
    found = pyramid._refined(first, second, field.copy())
    np.testing.assert_array_equal(found, solver.calc(first, second, field))


@pytest.mark.parametrize("scales", [(), (0.5, 0.7), (0.05, 1.0), (0.5, 1.2, 1.0)])
def test_levels_that_do_not_end_at_full_size_are_refused(scales):
    with pytest.raises(InvalidValueError, match="scales"):
        flow.create("dis", scales=scales)


def test_sweeps_that_would_diverge_are_refused():
    with pytest.raises(InvalidValueError, match="overrelaxation"):
        flow.create("dis", overrelaxation=2.0)
