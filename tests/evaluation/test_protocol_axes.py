"""Breaking the error down by what makes clips hard."""

import numpy as np
import pytest

from mseg.evaluation.protocol import Axis, Group, Protocol, load_protocol
from mseg.evaluation.results import axis_table


@pytest.mark.parametrize(
    ("bounds", "values", "bins"),
    [
        ((), {"a": "turning", "b": "standing", "c": "turning"}, {"standing": ["b"], "turning": ["a", "c"]}),
        ((1, 4), {"a": 0.5, "b": 1.0, "c": 9}, {"under 1": ["a"], "1 to 4": ["b"], "4 and over": ["c"]}),
        ((1, 4), {"a": 4.0}, {"4 and over": ["a"]}),
        ((), {"a": 2, "b": 10, "c": 2}, {"2": ["a", "c"], "10": ["b"]}),
    ],
)
def test_clips_are_sorted_into_bins(bounds, values, bins):
    found = Axis("x", "X", bounds).bins(values)
    assert found == bins
    assert list(found) == list(bins)


def test_every_clip_with_a_value_counts_once_in_each_axis():
    clips = ("a", "b", "c")
    protocol = Protocol(
        "p", "P", 3, (Group("all", "all", 3, clips),),
        axes=(Axis("motions", "motions"), Axis("size", "size", (10,))),
        attributes={"a": {"size": 3}, "b": {"size": 30}},
    )  # fmt: skip
    errors = {"m": np.array([[0.1], [0.2], [0.6]])}
    table = axis_table("T", protocol, {"a": 2, "b": 3, "c": 2}, errors)
    assert [list(row) for row in table.rows] == [
        ["motions: 2", "2", "35.00"],
        ["motions: 3", "1", "20.00"],
        ["size: under 10", "1", "10.00"],
        ["size: 10 and over", "1", "20.00"],
    ]


def test_a_benchmark_without_axes_has_no_such_table():
    assert axis_table("T", load_protocol("hopkins155"), {"cars1": 2}, {"m": np.zeros((1, 1))}) is None
