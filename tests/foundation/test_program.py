from __future__ import annotations

import subprocess
import sys
from importlib import import_module

import pytest

from kt3dmoseg import __version__, program
from kt3dmoseg.cli import COMMANDS as DATASET_COMMANDS
from mseg.cli import COMMANDS as MSEG_COMMANDS

MODULE = """
'''Say hello.'''
from kt3dmoseg.errors import InvalidValueError
def configure(parser): parser.add_argument("name")
def run(arguments):
    if arguments.name == "nobody": raise InvalidValueError("name", found="nobody")
    if arguments.name == "ctrl-c": raise KeyboardInterrupt
    print("hello", arguments.name)
"""


@pytest.fixture
def call(tmp_path, monkeypatch):
    (tmp_path / "hello_command.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    table = {"hello": ("hello_command", "say hello"), "absent": ("no_such_module", "never imported")}
    return lambda *argv: program.main("prog", "A program.", table, argv)


def test_exit_codes_and_single_lines(call, capsys):
    assert call("hello", "you") == 0
    assert capsys.readouterr().out == "hello you\n"
    assert call("hello", "nobody") == 2
    assert capsys.readouterr().err == "prog: name: found nobody\n"
    assert call("hello", "ctrl-c") == 130
    assert call("helo") == 2
    assert "did you mean 'hello'?" in capsys.readouterr().err


def test_overview_imports_no_command(call, capsys):
    assert call("--help") == 0
    assert "never imported" in capsys.readouterr().out
    assert call() == 2
    assert call("--version") == 0
    assert capsys.readouterr().out.endswith(f"prog {__version__}\n")


@pytest.mark.parametrize(
    ("package", "command"),
    [("kt3dmoseg", c) for c in DATASET_COMMANDS] + [("mseg", c) for c in MSEG_COMMANDS],
)
def test_every_listed_command_has_help(package, command, capsys):
    main = import_module(f"{package}.cli").main
    with pytest.raises(SystemExit) as stopped:
        main([command, "--help"])
    assert stopped.value.code == 0
    assert f"usage: {package} {command}" in capsys.readouterr().out


@pytest.mark.parametrize("package", ["kt3dmoseg", "mseg"])
def test_help_imports_nothing_heavy(package):
    heavy = ["cv2", "sklearn", "matplotlib", "pandas", "scipy", "h5py", "pykitti", "dask", "torch"]
    code = (
        f"import sys; from {package}.cli import main; main(['--help']); "
        f"print([m for m in {heavy} if m in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stderr.strip() == "[]"


def test_both_packages_list_and_resolve_their_public_names():
    import kt3dmoseg
    import mseg

    for package in (kt3dmoseg, mseg):
        for name in package.__all__:
            assert getattr(package, name) is not None
        with pytest.raises(AttributeError, match="no attribute 'nothing'"):
            _ = package.nothing


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--seed", "3"], "unknown option '--seed'; did you mean '--seeds'?"),
        (["--see=3"], "unknown option '--see'; did you mean '--seeds'?"),
        (["--seeds", "two"], "argument --seeds: invalid int value: 'two'"),
        (["more"], "unexpected argument 'more'"),
        (["add", "--bd", "x"], "unknown option '--bd'; did you mean '--db'?"),
    ],
)
def test_a_mistake_in_the_arguments_is_answered_in_one_line(words, said, capsys):
    parser = program.Parser(prog="prog act")
    if words[0] == "add":
        parser.add_subparsers().add_parser("add").add_argument("--db")
    parser.add_argument("--seeds", type=int)
    with pytest.raises(SystemExit) as stopped:
        parser.parse_args(words)
    assert stopped.value.code == 2
    told = capsys.readouterr().err
    assert said in told
    assert told.startswith("prog act")
    assert told.count("\n") == 1


def test_what_the_system_refuses_is_one_line(call, capsys, monkeypatch):
    hello_command = import_module("hello_command")

    def full(arguments):
        raise OSError(28, "No space left on device", "/full/disk")

    monkeypatch.setattr(hello_command, "run", full)
    assert call("hello", "you") == 2
    assert capsys.readouterr().err == "prog: /full/disk: No space left on device\n"
