"""Breaking the error down by what makes clips hard."""

import pytest

from mseg.evaluation.protocol import Axis, Group, Protocol, load_protocol
from mseg.evaluation.results import by_axis
from mseg.evaluation.scoring import ClipScore, ScoreTable


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


def _scores(protocol, **clips):
    runs = (
        ClipScore(name, 0, motions, 10, motions, 0.5, "", {"error": e})
        for name, (motions, e) in clips.items()
    )
    return ScoreTable(tuple(runs), protocol=protocol)


def test_every_clip_with_a_value_counts_once_in_each_axis():
    clips = ("a", "b", "c")
    protocol = Protocol(
        "p", "P", 3, (Group("all", "all", 3, clips),),
        axes=(Axis("motions", "motions"), Axis("size", "size", (10,))),
        attributes={"a": {"size": 3}, "b": {"size": 30}},
    )  # fmt: skip
    table = by_axis(_scores(protocol, a=(2, 0.1), b=(3, 0.2), c=(2, 0.6)))
    assert [list(row) for row in table.rows] == [
        ["motions: 2", "2", "35.00"],
        ["motions: 3", "1", "20.00"],
        ["size: under 10", "1", "10.00"],
        ["size: 10 and over", "1", "20.00"],
    ]


def test_a_benchmark_without_axes_has_no_such_table():
    assert by_axis(_scores(load_protocol("hopkins155"), cars1=(2, 0.0))) is None
