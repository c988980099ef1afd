"""What both command lines do alike: exit codes, mistakes, help, configuration files, completion."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import pytest
from cyclopts import Parameter

from kt3dmoseg import __version__, app
from kt3dmoseg.cli import COMMANDS as DATASET_COMMANDS
from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.options import Preset, from_mapping, option
from mseg.cli import COMMANDS as MSEG_COMMANDS

_BOARD = ("add", "remove", "list", "rank", "export", "site", "submit", "check")
EVERY_COMMAND = [
    *(("kt3dmoseg", command) for command in DATASET_COMMANDS),
    *(("kt3dmoseg", f"catalog {command}") for command in ("list", "check", "add")),
    *(("mseg", command) for command in MSEG_COMMANDS),
    *(("mseg", f"leaderboard {command}") for command in _BOARD),
]


@dataclass(frozen=True)
class Example:
    """What the tests set.

    And more about it.
    """

    alpha: float = option(8.0, "power, 50 % of it", low=0)
    rounds: int = option(3, "rounds", low=1, high=10)
    kind: Literal["a", "b"] = option("a", "kind")
    fast: bool = option(False, "speed")
    limit: int | None = option(None, "limit")
    scales: tuple[float, ...] = option((1.0,), "scales")
    where: str = option("", "where they are", metavar="FOLDER")
    depth: int = option(4, "how deep")
    everyday: ClassVar = ("alpha", "rounds", "kind", "fast", "limit", "scales", "where")
    presets: ClassVar = {"steep": Preset("high powers", {"alpha": 30.0, "rounds": 9})}


seen: list[Any] = []


@app.flags(Example)
def hello(
    name: str, /, *, seeds: app.Positive = 1, count: app.Whole = 0, share: float = 0.5, **options: Any
) -> None:
    """Say hello.

    Parameters
    ----------
    name : str
        Whom to greet.
    count : int
        How often.
    share : float
        How much of it.
    """
    if name == "nobody":
        raise InvalidValueError("name", found="nobody")
    if name == "ctrl-c":
        raise KeyboardInterrupt
    if name == "full":
        raise OSError(28, "No space left on device", "/full/disk")
    if name == "missing":
        raise ModuleNotFoundError("No module named 'starlette'", name="starlette.routing")
    if name == "bug":
        raise ModuleNotFoundError("No module named 'mistake'", name="mistake")
    if name == "gone":
        print("nobody reads this", flush=True)
        Path(sys.argv[1]).write_text("done")
    seen.append(from_mapping(Example, options))
    print("hello", name)


things = app.group("things", "Keep things.")


@things.command
def add(*names: str, db: Annotated[app.File, Parameter(alias="-d")] = "things") -> None:
    """Keep things."""
    print("kept", *names, db)


def pick(number: app.Positive, /) -> None:
    """Pick one."""


TABLE = {"hello": f"{__name__}:hello", "pick": f"{__name__}:pick", "things": f"{__name__}:things"}


@pytest.fixture
def call(capsys):
    program = app.application("prog", "A program.", TABLE)

    def run(*words):
        return app.main(program, words), *capsys.readouterr()

    return run


@pytest.mark.parametrize(("to", "why"), [("&-", "closed"), ("/dev/full", "No space left on device")])
def test_output_that_cannot_be_written_is_a_failure(to, why):
    command = f"{sys.executable} -m kt3dmoseg catalog list >{to}"
    done = subprocess.run(["sh", "-c", command], stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stderr) == (2, f"kt3dmoseg: standard output: {why}\n")


def parsed(call, *flags):
    code, _, err = call("hello", "you", *flags)
    assert (code, err) == (0, "")
    return seen.pop()


def test_exit_codes_and_single_lines(call):
    assert call("hello", "you") == (0, "hello you\n", "")
    assert call("hello", "nobody") == (2, "", "prog: name: found nobody\n")
    assert call("hello", "ctrl-c") == (130, "", "prog: interrupted; what was finished is kept\n")
    assert call("hello", "full") == (2, "", "prog: /full/disk: No space left on device\n")
    missing = "prog: starlette is not installed; pip install 'kt3dmoseg[label]'\n"
    assert call("hello", "missing") == (2, "", missing)
    with pytest.raises(ModuleNotFoundError):
        call("hello", "bug")
    code, _, err = call("helo")
    assert (code, err) == (2, "prog: unknown command 'helo'; did you mean 'hello'?\n")


@pytest.mark.parametrize("to", ["stdout", "stderr"])
def test_behind_a_closed_pipe_the_work_goes_on(to, tmp_path):
    code = f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r}); import test_app as t\n"
    code += "sys.stdout = sys.stderr\n" * (to == "stderr")
    code += "sys.exit(t.app.main(t.app.application('prog', '', t.TABLE), ['hello', 'gone']))"
    reader, writer = os.pipe()
    os.close(reader)
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, to: writer}
    command = [sys.executable, "-c", code, str(tmp_path / "file")]
    done = subprocess.run(command, **streams, check=False)
    os.close(writer)
    assert (done.returncode, done.stdout or b"", done.stderr or b"") == (0, b"", b"")
    assert (tmp_path / "file").read_text() == "done"


def test_the_program_lists_its_commands(call):
    code, out, _ = call("--help")
    assert code == 0
    assert re.search(r"^  hello +Say hello$", out, flags=re.MULTILINE)
    assert call() == (2, out, "")
    assert call("--version") == (0, f"prog {__version__}\n", "")


def test_no_flags_give_the_defaults(call):
    assert parsed(call) == Example()


def test_flags_have_the_types_of_the_fields(call):
    flags = ["--alpha", "2", "--fast", "--kind", "b", "--limit", "4", "--scales", "1,2"]
    assert parsed(call, *flags) == Example(2.0, 3, "b", True, 4, (1.0, 2.0))
    assert parsed(call, "--no-fast", "--depth=5") == Example(depth=5)
    assert parsed(call, "--rounds", "4", "--rounds", "5") == Example(rounds=5)


@pytest.mark.parametrize(
    ("flags", "alpha", "rounds"),
    [
        ([], 8, 3),
        (["--steep"], 30, 9),
        (["--steep", "--rounds", "4"], 30, 4),
        (["--rounds", "4", "--steep"], 30, 4),
    ],
)
def test_a_preset_is_its_values_and_single_options_win(flags, alpha, rounds, call):
    assert parsed(call, *flags) == Example(alpha=alpha, rounds=rounds)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["hello", "x", "--seed", "3"], "unknown option '--seed'; did you mean '--seeds'?"),
        (["hello", "x", "--seed=3"], "unknown option '--seed'; did you mean '--seeds'?"),
        (["hello", "x", "--alp", "3"], "unknown option '--alp'; did you mean '--alpha'?"),
        (["hello", "--sees=3"], "unknown option '--sees'; did you mean '--seeds'?"),
        (["hello", "x", "--clips", "3"], "unknown option '--clips'; known: --help, "),
        (["hello", "x", "--seeds", "two"], "argument --seeds: expected a whole number >= 1, found 'two'"),
        (["hello", "x", "--seeds=0"], "argument --seeds: expected a whole number >= 1, found '0'"),
        (["hello", "x", "--count", "two"], "argument --count: expected a whole number, found 'two'"),
        (["hello", "x", "--count", "1.5"], "argument --count: expected a whole number, found '1.5'"),
        (["hello", "x", "--share", "half"], "argument --share: expected a number, found 'half'"),
        (["hello", "x", "--count"], "argument --count: expected a value"),
        (["hello", "x", "--kind", "c"], "argument --kind: expected one of a, b, found 'c'"),
        (["pick", "two"], "argument NUMBER: expected a whole number >= 1, found 'two'"),
        (["hello", "x", "more"], "unexpected argument 'more'"),
        (["hello"], "the following arguments are required: NAME"),
        (["things", "add", "--bd", "x"], "unknown option '--bd'; did you mean '--db'?"),
        (["things"], "things: expected a command: add, found none"),
        (["things", "ad"], "unknown command 'ad'; did you mean 'add'?"),
    ],
)
def test_a_mistake_in_the_arguments_is_one_line(words, message, call):
    code, out, err = call(*words)
    assert (code, out) == (2, "")
    assert message in err
    assert err.startswith("prog")
    assert err.count("\n") == 1


def test_help_names_the_values_and_the_defaults(call, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    _, out, _ = call("hello", "--help")
    text = " ".join(out.split())
    assert "Usage: prog hello [OPTIONS] NAME Say hello." in text
    assert "NAME Whom to greet" in text
    assert "--alpha X Power, 50 % of it (default: 8.0)" in text
    assert "--kind {a,b} Kind (default: a)" in text
    assert "--where FOLDER Where they are 1 more" in text  # no default
    assert "--steep High powers: alpha 30.0, rounds 9" in text
    assert "--fast, --no-fast Speed (default: False)" in text
    assert "\nWhat the tests set:\n" in out


def test_rare_options_have_a_help_of_their_own(call):
    _, short, _ = call("hello", "--help")
    assert "--depth" not in short
    assert "1 more options, rarely changed: --help-all" in short
    _, full, _ = call("hello", "--help-all")
    assert "--depth N" in full
    assert call("hello", "-h")[1] == short


@pytest.fixture
def config(tmp_path):
    def write(text):
        (tmp_path / "run.toml").write_text(text)
        return str(tmp_path / "run.toml")

    return write


def test_a_file_gives_options_and_the_command_line_wins(call, config):
    file = config('[hello]\nalpha = 2\nfast = true\nscales = "1,2"\ncount = 7\n[things.add]\ndb = "mine"\n')
    assert parsed(call, "--config", file) == Example(alpha=2.0, fast=True, scales=(1.0, 2.0))
    assert parsed(call, f"--config={file}", "--alpha", "3") == Example(3.0, fast=True, scales=(1.0, 2.0))
    assert call("things", "add", "a", "--config", file)[1] == "kept a mine\n"
    assert parsed(call) == Example()  # the next call does not keep the file


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[helo]\nalpha = 2", "unknown command 'helo'; did you mean 'hello'?"),
        ("[hello]\nalhpa = 2", "unknown option 'alhpa'; did you mean 'alpha'?"),
        ("[hello]\nseeds = 0", "expected a whole number >= 1, found '0'"),
        ('[hello]\nkind = "c"', "expected one of a, b, found 'c'"),
        ('[hello]\nfast = "maybe"', "expected true or false, found 'maybe'"),
        ("[hello.options]\nx = 1", "unknown option 'options.x'"),
        ("[hello]\nrounds = 11", "rounds: expected a number >= 1 and <= 10, found 11"),
        ("hello = 3", "hello: expected a table [hello], found 3"),
        ("[things.ad]", "unknown command 'ad'; did you mean 'add'?"),
        ("[hello", "expected TOML, found"),
    ],
)
def test_a_mistake_in_the_file_is_one_line(text, message, call, config):
    code, out, err = call("hello", "x", "--config", config(text))
    assert (code, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1
    assert "run.toml" in err or "rounds" in err


def test_a_file_that_is_not_there_is_one_line(call):
    assert call("hello", "x", "--config", "none.toml")[2] == "prog: none.toml: No such file or directory\n"
    assert call("hello", "x", "--config")[2] == "prog: --config: expected a TOML file, found none\n"


@pytest.mark.parametrize(("package", "command"), EVERY_COMMAND)
def test_every_listed_command_has_help(package, command, capsys):
    assert import_module(f"{package}.cli").main([*command.split(), "--help"]) == 0
    out = capsys.readouterr().out
    assert f"Usage: {package} {command}" in out
    rows = re.findall(r"^  \S.*(?:\n {26}.*)*", out, flags=re.MULTILINE)
    assert rows
    assert all(re.search(r"  +\S", row.strip()) for row in rows), "an option without a text"
    assert "STR" not in out.partition("\n")[2]
    assert "Parameters\n" not in out


HEAVY = ("numpy", "cv2", "sklearn", "matplotlib", "pandas", "scipy", "h5py", "pykitti", "pydantic", "torch")


# Help as from a new process: each command's is a copy of one that has only imported the command line.
_HELP = """
import json, os, resource, sys
from PACKAGE.cli import main

def used():
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime

begun, said = used(), os.dup(1)
os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
for command in COMMANDS:
    if os.fork() == 0:
        before = used()
        code = main([*command.split(), "--help"])
        heavy = [module for module in HEAVY if module in sys.modules]
        os.write(said, json.dumps([command, code, begun + used() - before, heavy]).encode() + b"\\n")
        os._exit(0)
    os.wait()
"""


@pytest.fixture(scope="module")
def helped():
    """Give for each command (its exit code, seconds of processor time, what is imported that is heavy)."""
    found = {}
    for package in ("kt3dmoseg", "mseg"):
        # Bytecode of everything that prints help is there, as after the first command.
        subprocess.run([sys.executable, "-m", package, "--help"], check=True, capture_output=True)
        commands = ["", *(command for where, command in EVERY_COMMAND if where == package)]
        code = _HELP.replace("PACKAGE", package).replace("COMMANDS", repr(commands))
        code = code.replace("HEAVY", repr(HEAVY))
        done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
        for line in done.stdout.splitlines():
            command, *rest = json.loads(line)
            found[package, command] = rest
    return found


@pytest.mark.parametrize(("package", "command"), [("kt3dmoseg", ""), ("mseg", ""), *EVERY_COMMAND])
def test_help_is_fast_and_imports_nothing_heavy(package, command, helped):
    code, seconds, heavy = helped[package, command]
    assert (code, heavy) == (0, [])
    assert seconds < 0.5


@pytest.mark.parametrize("module", ["kt3dmoseg", "mseg"])
def test_a_program_is_also_a_module(module):
    done = subprocess.run([sys.executable, "-m", module, "--version"], capture_output=True, text=True)
    assert done.stdout == f"{module.partition('.')[0]} {__version__}\n"


@pytest.mark.parametrize("package", ["kt3dmoseg", "mseg"])
@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_installed_for_a_shell(package, shell, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("ZSH", raising=False)
    monkeypatch.delenv("ZSH_CUSTOM", raising=False)
    assert import_module(f"{package}.cli").main(["--install-completion", "--shell", shell]) == 0
    assert "installed" in capsys.readouterr().out
    [script] = [path for path in tmp_path.rglob("*") if path.is_file() and package in path.name]
    text = script.read_text()
    assert all(word in text for word in ("show", "--trail") if package == "kt3dmoseg")
    assert all(word in text for word in ("leaderboard", "rank", "--seeds") if package == "mseg")


def test_an_unknown_shell_is_one_line(call, monkeypatch):
    from cyclopts.completion import detect

    def unknown():
        raise detect.ShellDetectionError

    monkeypatch.setattr(detect, "detect_shell", unknown)
    code, out, err = call("--install-completion")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "--shell" in err


def test_both_packages_list_and_resolve_their_public_names():
    import kt3dmoseg
    import mseg

    for package in (kt3dmoseg, mseg):
        for name in package.__all__:
            assert getattr(package, name) is not None
        with pytest.raises(AttributeError, match="no attribute 'nothing'"):
            _ = package.nothing


def test_two_configuration_files_are_one_line(call, config):
    code, _, err = call("hello", "x", "--config", config("[hello]\nalpha = 2"), "--config", "other.toml")
    assert code == 2
    assert "--config: expected one file, found more" in err


def test_help_keeps_dots_that_go_on():
    for words, text in (
        (["mseg", "run"], "seed-1/, ... (default: 1)"),
        (["kt3dmoseg", "build"], "20, ... (default"),
    ):
        done = subprocess.run(
            [sys.executable, "-m", *words, "--help-all"], capture_output=True, text=True, check=True
        )
        assert text in " ".join(done.stdout.split())


def test_a_closed_standard_error_changes_nothing(tmp_path):
    line = f"{sys.executable} -m mseg example-submission -o {tmp_path}/made 2>&-"
    assert subprocess.run(line, shell=True).returncode == 0
    assert (tmp_path / "made").is_dir()
    line = f"{sys.executable} -m mseg run {tmp_path}/made-data -o {tmp_path}/run --method one_motion 2>&-"
    assert subprocess.run(line, shell=True).returncode == 0
    assert list((tmp_path / "run").glob("*.csv"))
