"""Every command, flag and alias of version 0.1.0 is still taken and, unless hidden, listed with its default.

`commands.json` is that version's list, written once from its parsers and never regenerated. `example` is a
value that a flag takes.
"""

from __future__ import annotations

import json
import re
from importlib import import_module
from itertools import chain, zip_longest
from pathlib import Path

import pytest

FROZEN = json.loads(Path(__file__).with_name("commands.json").read_text())
COMMANDS = [(program, command) for program, commands in FROZEN.items() for command in commands]


def call(capsys, program, *argv):
    """Exit code and both outputs of a command line."""
    try:
        code = import_module(f"{program}.cli").main(list(argv))
    except SystemExit as stopped:
        code = stopped.code
    return code, *capsys.readouterr()


def needed(frozen):
    """The least that the command asks for."""
    words = ["x" for argument in frozen["arguments"] if argument["nargs"] in (1, "+")]
    for option in frozen["options"]:
        words += [option["flags"][-1], option["example"]] if option.get("required") else []
    return words


def forms(option):
    """Every way to write an option."""
    for flag in option["flags"]:
        if "example" not in option:
            yield [flag]
            continue
        yield [flag, option["example"]]
        if flag.startswith("--"):
            yield [f"{flag}={option['example']}"]
        if option.get("repeated"):
            yield [flag, option["example"], flag, option["example"]]
        if option.get("nargs") == "+":
            yield [flag, "x", "y", "z"]
        if option.get("nargs") == "?":
            yield [flag]


@pytest.mark.parametrize(("program", "command"), COMMANDS)
def test_every_flag_is_still_taken(program, command, capsys):
    frozen = FROZEN[program][command]
    # On one line the first way to write each option with a value, then the second, and so on; other options
    # may exclude each other: each has a line of its own.
    valued = [option for option in frozen["options"] if "example" in option]
    lines = [[*chain(*line)] for line in zip_longest(*map(forms, valued), fillvalue=())]
    lines += chain(*(forms(option) for option in frozen["options"] if "example" not in option))
    for line in lines:
        words = [*command.split(), *needed(frozen), *line, "--zzz"]
        code, _, err = call(capsys, program, *words)
        assert code == 2
        assert "unknown option '--zzz'" in err, words  # and nothing else is wrong with it
        assert err.count("\n") == 1


@pytest.mark.parametrize(("program", "command"), COMMANDS)
def test_every_argument_is_still_taken(program, command, capsys):
    frozen = FROZEN[program][command]
    options = needed(frozen)[sum(argument["nargs"] in (1, "+") for argument in frozen["arguments"]) :]
    words = []
    for argument in frozen["arguments"]:
        words += ["x"] * (3 if argument["nargs"] in ("*", "+") else 1)
    code, _, err = call(capsys, program, *command.split(), *words, *options, "--zzz")
    assert code == 2
    assert "unknown option '--zzz'" in err


@pytest.mark.parametrize(("program", "command"), COMMANDS)
def test_every_flag_is_listed_with_its_default(program, command, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    code, text, err = call(capsys, program, *command.split(), "--help-all")
    assert (code, err) == (0, "")
    listed = {}
    for paragraph in re.split(r"\n(?=  \S)", text):
        for flag in re.findall(r"(?<![\w-])--?[a-z][a-z-]*", paragraph.strip().split("  ")[0]):
            listed[flag] = " ".join(paragraph.split())
    for option in FROZEN[program][command]["options"]:
        if option.get("hidden"):
            assert not set(option["flags"]) & set(listed)
            continue
        for flag in option["flags"]:
            assert flag in listed
            for choice in option.get("choices", []):
                assert choice in listed[flag]
            if "default" in option:
                assert f"default: {option['default']}" in listed[flag]


@pytest.mark.parametrize("program", FROZEN)
def test_every_command_is_listed(program, capsys):
    code, text, _ = call(capsys, program, "--help")
    assert code == 0
    for command in FROZEN[program]:
        assert re.search(rf"^  {command.split()[0]} ", text, flags=re.MULTILINE)


@pytest.mark.parametrize("program", FROZEN)
@pytest.mark.parametrize(
    ("words", "code", "facts"),
    [
        ([], 2, ["Usage"]),
        (["--version"], 0, ["0.1.0"]),
        (["nonsense"], 2, ["unknown command 'nonsense'", "known: "]),
        (["reprot"], 2, ["unknown command 'reprot'"]),
    ],
)
def test_the_program_itself(program, words, code, facts, capsys):
    found, out, err = call(capsys, program, *words)
    assert found == code
    for fact in facts:
        assert fact in out + err
