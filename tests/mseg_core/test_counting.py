"""Counting clusters: criteria on plain graphs, methods without a number."""

from __future__ import annotations

import numpy as np
import pytest

import mseg
from mseg.clustering.counting import _align, count_clusters
from mseg.clustering.spectral import normalised_laplacian

CRITERIA = ("eigengap", "self_tuning", "vote")


def blocks(sizes: list[int], rng: np.random.Generator) -> np.ndarray:
    group = np.repeat(np.arange(len(sizes)), sizes)
    weights = np.where(group[:, None] == group, 1.0, 0.02) * rng.uniform(0.8, 1.2, size=(len(group),) * 2)
    return (weights + weights.T) / 2


@pytest.mark.parametrize("criterion", CRITERIA)
@pytest.mark.parametrize("sizes", [[30, 30], [40, 25, 10], [20, 20, 20, 20, 20]])
def test_plain_blocks_are_counted(criterion, sizes, rng):
    count = count_clusters(normalised_laplacian(blocks(sizes, rng)), criterion, rng)
    assert count.number == len(sizes)
    assert sorted([count.number, *count.runners_up]) == list(count.scores)


def test_a_rotated_indicator_is_turned_back(rng):
    indicator = np.eye(3)[np.repeat([0, 1, 2], 20)] / np.sqrt(20)
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    _, cost = _align(indicator @ rotation)
    assert cost < 1.02


def test_the_code_length_finds_the_bodies(make_clip):
    clip = make_clip(points=20, motions=3, frames=8)
    found = mseg.segment(clip, "subset")
    assert found.report["n_motions"] == 3
    assert np.array_equal(found.labels, mseg.segment(clip, "subset", n_motions=3).labels)


def test_groups_too_small_for_a_body_are_counted_by_self_tuning(make_clip):
    clip = make_clip(points=2, motions=2, frames=4)
    number = mseg.segment(clip, "affine", count="self_tuning").report["n_motions"]
    assert mseg.segment(clip, "affine", count="code_length").report["n_motions"] == number


@pytest.mark.parametrize("method", ["affine", "homography", "keradd", "coreg", "subset", "consistent"])
@pytest.mark.parametrize("criterion", CRITERIA)
def test_methods_of_the_paper_find_the_number(method, criterion, make_clip):
    clip = make_clip(points=40, motions=2, frames=12)
    found = mseg.segment(clip, method, count=criterion)
    assert found.report["n_motions"] == 2 == len(set(found.labels.tolist()))
    assert sorted([2, *found.report["runners_up"]]) == list(found.report["count_scores"])
    given = mseg.segment(clip, method, n_motions=2)
    assert "runners_up" not in given.report


@pytest.mark.parametrize("criterion", CRITERIA)
def test_two_points_are_one_cluster(criterion, rng):
    assert count_clusters(np.eye(2), criterion, rng).number == 1


def test_points_that_coincide_are_no_clusters_to_vote_for(rng):
    count = count_clusters(normalised_laplacian(np.ones((5, 5))), "vote", rng)
    assert sorted(count.scores) == [2, 3, 4]
