from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import ClassVar, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kt3dmoseg.errors import InvalidValueError, UnknownNameError
from kt3dmoseg.options import (
    Preset,
    check,
    describe,
    from_mapping,
    option,
    option_names,
    parse_assignments,
)
from kt3dmoseg.tracking import TrackOptions


@dataclass(frozen=True)
class Example:
    """What the tests set."""

    alpha: float = option(8.0, "power, 50 % of it", low=0)
    rounds: int = option(3, "rounds", low=1, high=10)
    kind: Literal["a", "b"] = option("a", "kind")
    fast: bool = option(False, "speed")
    limit: int | None = option(None, "limit")
    scales: tuple[float, ...] = option((1.0,), "scales")
    frames: str = option("", "where they are", metavar="FOLDER")
    presets: ClassVar = {"steep": Preset("high powers", {"alpha": 30.0, "rounds": 9})}


def test_toml_values_and_strings_agree():
    strings = {"alpha": "2", "fast": "yes", "kind": "b", "limit": "4", "scales": "1,2"}
    by_string = from_mapping(Example, strings)
    by_toml = from_mapping(Example, {"alpha": 2, "fast": True, "kind": "b", "limit": 4, "scales": [1, 2]})
    assert by_string == by_toml == Example(2.0, 3, "b", True, 4, (1.0, 2.0))
    assert from_mapping(Example, {}) == Example()


def test_a_misspelt_key_names_the_nearest():
    with pytest.raises(UnknownNameError, match=r"run.toml: unknown option 'alhpa'; did you mean 'alpha'\?"):
        from_mapping(Example, {"alhpa": 1}, where="run.toml")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"alpha": "x"}, "alpha: expected a number"),
        ({"alpha": "nan"}, "alpha: expected a number"),
        ({"alpha": "1e400"}, "alpha: expected a finite number >= 0, found inf"),
        ({"alpha": float("inf")}, "alpha: expected a finite number >= 0, found inf"),
        ({"rounds": float("inf")}, "rounds: expected a whole number"),
        ({"alpha": -1}, "alpha: expected a number >= 0"),
        ({"rounds": 2.5}, "rounds: expected a whole number"),
        ({"rounds": 11}, "rounds: expected a number >= 1 and <= 10"),
        ({"rounds": True}, "rounds: expected a whole number"),
        ({"kind": "c"}, "kind: expected one of a, b"),
        ({"fast": "maybe"}, "fast: expected true or false"),
        ({"limit": "many"}, "limit: expected a whole number"),
        ({"scales": 3}, "scales: expected several values, found 3"),
        ({"scales": "1,x"}, "scales: expected a number, found 'x'"),
    ],
)
def test_bad_values_are_one_clear_line(values, message):
    with pytest.raises(InvalidValueError, match=message):
        from_mapping(Example, values)


def test_infinity_is_a_value_where_it_is_a_bound():
    floors = {"consistency_floor": "inf", "boundary_floor": "inf", "appearance_floor": float("inf")}
    made = from_mapping(TrackOptions, floors)
    assert {vars(made)[name] for name in floors} == {float("inf")}


def test_bounds_hold_for_instances_too():
    with pytest.raises(InvalidValueError, match="rounds"):
        check(Example(rounds=0))


@given(
    st.dictionaries(
        st.text(max_size=8), st.one_of(st.none(), st.text(max_size=5), st.floats(), st.integers())
    )
)
def test_any_mapping_gives_an_instance_or_one_of_our_errors(values):
    try:
        assert isinstance(from_mapping(Example, values), Example)
    except (InvalidValueError, UnknownNameError) as error:
        assert "\n" not in str(error)


def test_assignments_and_descriptions():
    assert parse_assignments(["alpha=8", "k-means=a=b"]) == {"alpha": "8", "k_means": "a=b"}
    with pytest.raises(InvalidValueError, match="name=value"):
        parse_assignments(["alpha"])
    assert [*(row[0] for row in describe(Example)), "steep"] == option_names(Example)


def test_a_preset_is_true_or_false():
    assert from_mapping(Example, {"steep": "yes"}).alpha == 30
    assert from_mapping(Example, {"rounds": 4, "steep": True}) == Example(alpha=30.0, rounds=4)
    assert from_mapping(Example, {"steep": True, "rounds": 4}) == Example(alpha=30.0, rounds=4)
    assert from_mapping(Example, {"steep": False}).alpha == 8
    with pytest.raises(InvalidValueError, match="steep: expected true or false"):
        from_mapping(Example, {"steep": "very"})
    with pytest.raises(UnknownNameError, match="did you mean 'steep'"):
        from_mapping(Example, {"steeep": True})


@pytest.mark.parametrize(
    "line",
    [
        ["kt3dmoseg", "build", str(Path(__file__).parents[1] / "golden" / "frames"), "-o", "out"],
        ["kt3dmoseg", "track", "f", "-o", "out.h5"],
        ["mseg", "run", "data", "-o", "out"],
        ["mseg", "benchmark", "kt3dmoseg"],
    ],
)
def test_parameters_are_given_alike_in_every_command(line, capsys):
    program, *words = line
    main = import_module(f"{program}.cli").main
    given = ["-p", "a=1", "--parameter", "b=2", "--set", "c=3"]
    assert main([*words[:4], *given, "-p", "zzz"]) == 2
    assert capsys.readouterr().err == f"{program}: --parameter: expected name=value, found 'zzz'\n"
    assert main([words[0], "--help"]) == 0
    text = capsys.readouterr().out
    assert "-p, --parameter NAME=VALUE" in text
    assert "--set" not in text
