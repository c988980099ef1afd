"""What both command lines share: flags from options dataclasses, plain help, one-line mistakes, TOML files.

A command is a typed function with a numpydoc docstring; cyclopts makes arguments, help and shell completion
of it. Heavy modules are imported inside the functions, so that ``--help`` stays fast.
"""

import dataclasses
import errno
import inspect
import io
import os
import re
import shutil
import sys
import textwrap
import threading
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, TextIO, TypeAlias, TypeVar, cast

import cyclopts
from cyclopts import Group, Parameter
from cyclopts.config import Dict

from kt3dmoseg import __version__
from kt3dmoseg.errors import FileFormatError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.options import presets
from kt3dmoseg.registry import unknown_name
from kt3dmoseg.text import count

Command = TypeVar("Command", bound=Callable[..., object])

_INTERRUPTED = 130
_USAGE = 2
_RARE = " (rarely changed)"
_LABELS = 26  # width of the column of names in help
_FORMER = {"--set": "--parameter"}  # older names of flags, taken and not listed
_RUNNING: list[cyclopts.App] = []  # the command that runs
_EXTRAS = dict.fromkeys(("starlette", "uvicorn", "pycocotools"), "label")  # of modules that may be missing
_EXTRAS["requests"] = "pull"
_NOUNS: dict[object, str] = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}
_FOOTER = "Every command takes --help, --help-all and --config FILE (options in TOML, one table per command)."


def _parse_integer(_: type, tokens: Sequence[cyclopts.Token], *, positive: bool = False) -> int:
    value = tokens[0].value
    if not value.removeprefix("-").isdecimal() or (positive and int(value) < 1):  # cyclopts would round 1.5
        raise ValueError(f"expected a whole number{' >= 1' * positive}, found {value!r}")
    return int(value)


# Types of arguments, with the names of their values in help.
Flag = Annotated[bool, Parameter(negative=(), show_default=False)]
Positive = Annotated[int, Parameter(converter=partial(_parse_integer, positive=True), metavar="N")]
Whole = Annotated[int, Parameter(converter=_parse_integer, metavar="N")]
Name = Annotated[str, Parameter(metavar="NAME")]
Folder = Annotated[Path, Parameter(metavar="FOLDER")]
File = Annotated[Path, Parameter(metavar="FILE")]
Url = Annotated[str, Parameter(metavar="URL")]
Dask = Annotated[str, Parameter(metavar="ADDRESS", help="Dask scheduler, tcp://host:8786.")]
Json = Annotated[Flag, Parameter(help="Print JSON.")]
Catalogs = Annotated[
    tuple[File, ...], Parameter(name="--catalog", help="A catalog of your own; may be repeated.")
]
Either = Annotated[Path, Parameter(metavar="PATH")]
# Of functions that are commands, too: whatever is a path in Python.
AnyPath: TypeAlias = str | os.PathLike[str]
AnyFile = Annotated[AnyPath, Parameter(metavar="FILE")]
AnyFolder = Annotated[AnyPath, Parameter(metavar="FOLDER")]
AnyEither = Annotated[AnyPath, Parameter(metavar="PATH")]
Range = Annotated[str, Parameter(name="--range", metavar="FIRST-LAST")]
Size = Annotated[str, Parameter(metavar="WIDTHxHEIGHT")]
Parameters = Annotated[
    tuple[str, ...], Parameter(alias=("-p", "--set"), metavar="NAME=VALUE", show_default=False)
]


def application(name: str, purpose: str, commands: Mapping[str, str]) -> cyclopts.App:
    """Make a program of commands: "module:function", or "module:app" for a group; imported when needed."""
    app = group(name, purpose)
    app.version = f"{name} {__version__}"
    app.default_parameter = Parameter(negative_iterable=(), allow_repeating=True, json_list=False)
    app.help_format, app.help_formatter = "plaintext", _HELP
    app.suppress_keyboard_interrupt = False
    for number, (command, target) in enumerate(commands.items()):
        app.command(target, name=command, sort_key=number)
    app.register_install_completion_command(
        help="install the completion of commands and options in the shell"
    )
    return app


def group(name: str, purpose: str) -> cyclopts.App:
    """Make a group of commands; add each with ``@group.command``."""
    titles = Group("Options", sort_key=0)
    return cyclopts.App(name=name, help=purpose, group_arguments=titles, group_parameters=titles)


def flags(*classes: type[Any]) -> Callable[[Command], Command]:
    """Let a command take the fields of options dataclasses as flags; it gets those given, as written.

    A field that is a parameter of the command itself is left out. Where a class names its `everyday` options,
    ``--help`` lists no others; ``--help-all`` does.
    """

    def decorate(command: Command) -> Command:
        signature = inspect.signature(command)
        own = [p for p in signature.parameters.values() if p.kind is not p.VAR_KEYWORD]
        added = [flag for cls in classes for flag in _flags(cls) if flag.name not in signature.parameters]
        command.__signature__ = signature.replace(parameters=own + added)  # type: ignore[attr-defined]
        return command

    return decorate


def _flags(cls: type[Any]) -> Iterator[inspect.Parameter]:
    title = (inspect.getdoc(cls) or cls.__name__).partition("\n")[0].rstrip(".")
    groups = {rare: Group.create_ordered(title + _RARE * rare) for rare in (False, True)}
    hints = typing.get_type_hints(cls)
    everyday = getattr(cls, "everyday", hints)

    def flag(
        name: str, default: object, hint: object, rare: bool, help: str, metavar: str = ""
    ) -> inspect.Parameter:
        about = Parameter(help=help, group=groups[rare], metavar=metavar or None)
        annotation = Annotated[hint, about]  # type: ignore[valid-type]
        return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)

    for name, preset in presets(cls).items():
        values = ", ".join(f"{key} {value}" for key, value in preset.values.items())
        yield flag(name, False, Flag, False, f"{preset.help}: {values}")
    for spec in dataclasses.fields(cls):
        hint, about = hints[spec.name], spec.metadata
        metavar = about["metavar"] or {int: "N", float: "X"}.get(hint, spec.name.upper())
        kind = hint if hint is bool or typing.get_origin(hint) is Literal else str | hint
        yield flag(spec.name, spec.default, kind, spec.name not in everyday, about["help"], metavar)


class _Help:
    """Help as plain text: it can be searched and piped, and takes no time to draw."""

    everything = False

    def __call__(self, console: object, options: object, panel: Any) -> None:  # noqa: ANN401
        if panel.title.endswith(_RARE) and not self.everything:
            print(f"\n{len(panel.entries)} more options, rarely changed: --help-all")
        elif panel.entries:
            print("", f"{panel.title}:", *map(_row, panel.entries), sep="\n")

    def render_usage(self, console: object, options: object, usage: object) -> None:
        print(f"Usage: {str(usage).strip()}")

    def render_description(self, console: object, options: object, description: Any) -> None:  # noqa: ANN401
        print(f"\n{description.primary_renderable.plain.rstrip()}")


def _row(entry: Any) -> str:  # noqa: ANN401
    names = [entry.positional_label] if entry.positional_label else []
    names += [name for name in entry.shorts + entry.names if name not in _FORMER]
    labels = ", ".join(names)
    if entry.choices:
        labels += " {" + ",".join(entry.choices) + "}"
    elif entry.metavar and not entry.positional_label:
        labels += " " + {"STR": names[-1].strip("-").upper(), "FLOAT": "X"}.get(entry.metavar, entry.metavar)
    text = re.sub(r"(?<!\.)\.$", "", entry.description.primary_renderable.plain)
    text = text[:1].upper() + text[1:]
    if entry.default not in (None, '""', "None", "()"):
        text += f" (default: {entry.default})"
    width, indent = max(shutil.get_terminal_size().columns - 2, 60), " " * _LABELS
    lines = textwrap.wrap(text, width - _LABELS, break_on_hyphens=False, break_long_words=False)
    if len(labels) < _LABELS - 3:
        return f"  {labels:<{_LABELS - 2}}" + f"\n{indent}".join(lines)
    return f"\n{indent}".join([f"  {labels}", *lines])


_HELP = _Help()


def main(app: cyclopts.App, argv: Sequence[str] | None = None) -> int:
    """Run a program with these arguments, by default the process's; return its exit code."""
    program = app.name[0]
    if sys.stdout is None:  # closed: writing fails, and no other file gets its number
        sys.stdout = open(os.devnull)  # noqa: SIM115
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    if isinstance(sys.stdout, io.TextIOWrapper):  # as standard error: a file's name may be no UTF-8
        sys.stdout.reconfigure(errors="backslashreplace")
    out, err = (cast(TextIO, _Output(stream)) for stream in (sys.stdout, sys.stderr))
    with redirect_stdout(out), redirect_stderr(err):
        try:
            code = _run(app, list(sys.argv[1:] if argv is None else argv))
            sys.stdout.flush()
            return code
        except SystemExit:  # of --install-completion, which has printed why
            return _USAGE
        except KeyboardInterrupt:
            print(f"{program}: interrupted; what was finished is kept", file=sys.stderr)
            return _INTERRUPTED
        except (KT3DMoSegError, cyclopts.CycloptsError, ModuleNotFoundError, OSError) as error:
            print(" ".join(_failure(program, error).split()), file=sys.stderr)  # a path may hold a line break
            return getattr(error, "exit_code", _USAGE)
        finally:
            _RUNNING.clear()


class _Output:
    """A stream that a command prints to; when its reader has closed the pipe, the work goes on."""

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        return getattr(self.stream, name)

    def write(self, text: str) -> int:
        try:
            return self.stream.write(text)
        except BrokenPipeError:
            _discard_output(self.stream)
            return len(text)

    def flush(self) -> None:
        try:
            self.stream.flush()
        except BrokenPipeError:
            _discard_output(self.stream)


def _discard_output(stream: TextIO) -> None:
    """Let what is left of the output go nowhere: Python would fail again when it ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _failure(program: str, error: Exception) -> str:
    """One line on what is wrong; a bug is raised again."""
    if isinstance(error, cyclopts.CycloptsError):
        command = " ".join([program, *(error.command_chain or ())])
        return f"{command}: {_mistake(error)} (see '{command} --help')"
    if isinstance(error, ModuleNotFoundError):
        package = str(error.name).partition(".")[0]
        if package not in _EXTRAS:
            raise error
        return f"{program}: {package} is not installed; pip install 'kt3dmoseg[{_EXTRAS[package]}]'"
    if isinstance(error, OSError) and not isinstance(error, KT3DMoSegError):  # a full disk, no permission
        if isinstance(error, io.UnsupportedOperation) or (error.errno, error.filename) == (
            errno.ENOSPC,
            None,
        ):
            _discard_output(sys.stdout)
            return f"{program}: standard output: {error.strerror or 'closed'}"
        return f"{program}: {error.filename or 'system'}: {error.strerror or error}"
    message, where = str(error), " ".join(getattr(error, "where", "").split())  # as the message has it
    return f"{program}: {_flags_of_running().get(where, where)}{typed(message.removeprefix(where))}"


def typed(text: str) -> str:
    """Give text with ``n_motions=N`` as ``--n-motions N``, where that is an argument of the running command.

    The functions speak of their arguments as in Python; where none of them runs as a command, text stays.
    """
    flags = _flags_of_running()

    def argument(match: re.Match[str]) -> str:
        flag, value = flags.get(match[1]), match[2].strip("'")
        if flag is None:
            return match[0]
        return flag if value == "True" else f"{flag} {value.replace('None', 'none')}"

    return re.sub(r"(?<![^\s(])([a-z]\w*)=('\w+'|[A-Z]\w*)(?![\w/.-])", argument, text)


def _flags_of_running() -> dict[str, str]:
    """Give the flags of the running command by the names that their arguments have in Python."""
    if not _RUNNING or _RUNNING[0].default_command is None:
        return {}
    arguments = _RUNNING[0].assemble_argument_collection()
    return {each.field_info.name: each.name for each in arguments if each.name.startswith("-")}


def _run(app: cyclopts.App, words: list[str]) -> int:
    words, file = _without_config(words)
    app.config = []
    if file:
        from kt3dmoseg.files import TOML_BYTES, parse_toml, read_bytes

        tables = parse_toml(read_bytes(file, TOML_BYTES), file)
        _check_tables(app, tables, file)
        app.config = [Dict(tables, source=file), _prefer_line]
    _HELP.everything = "--help-all" in words
    words = _join_dash(["--help" if word == "--help-all" else word for word in words])
    asks_help = not words or "--help" in words or "-h" in words
    chain, apps, rest = app.parse_commands(words)
    _RUNNING[:] = apps[-1:]
    if apps[-1].default_command is None:
        commands = _commands(apps[-1])
        if rest:
            raise unknown_name("command", rest[0], commands)
        if chain:
            expected = f"a command: {', '.join(commands)}"
            raise InvalidValueError(" ".join(chain), expected=expected, found="none")
    if asks_help and all(name.startswith("-") for name in chain):
        for command in app:
            app[command]  # imported, so that it is listed with the first line of its docstring
    code = app(words, exit_on_error=False, print_error=False, result_action="return_value")
    if asks_help:
        print(f"\n{_FOOTER}")
    return getattr(code, "exit_code", code if isinstance(code, int) else 0) if words else _USAGE


def _join_dash(words: list[str]) -> list[str]:
    """Write ``--json -`` as ``--json=-``: by itself, cyclopts takes ``-`` for an option."""
    joined: list[str] = []
    for word in words:
        if word == "-" and joined[-1:] == ["--json"]:
            joined[-1] = "--json=-"
        else:
            joined.append(word)
    return joined


def _prefer_line(_: object, commands: object, arguments: cyclopts.ArgumentCollection) -> None:
    """Drop the file's options of a group with a rule, as "only one", where the command line gives others."""
    for group in arguments.groups:
        those = arguments.filter_by(group=group) if group.validator else ()
        if any(token.source == "cli" for argument in those for token in argument.tokens):
            for argument in those:
                argument.tokens = [token for token in argument.tokens if token.source == "cli"]


def _without_config(words: list[str]) -> tuple[list[str], str]:
    """Take ``--config FILE`` out of a command line, wherever it is."""
    at = next((k for k, word in enumerate(words) if word.partition("=")[0] == "--config"), None)
    if at is None:
        return words, ""
    file, *rest = words[at].split("=", 1)[1:] + words[at + 1 :] or [""]
    if not file:
        raise InvalidValueError("--config", expected="a TOML file", found="none")
    if any(word.partition("=")[0] == "--config" for word in rest):
        raise InvalidValueError("--config", expected="one file", found="more", fix="join them")
    return words[:at] + rest, file


def _check_tables(app: cyclopts.App, tables: dict[str, Any], where: str) -> None:
    """Check a configuration file, one table per command; cyclopts checks the names of its options."""
    for name, table in tables.items():
        if name not in _commands(app):
            raise unknown_name("command", name, _commands(app), where=where)
        if not isinstance(table, dict):
            raise FileFormatError(f"{where}: {name}", expected=f"a table [{name}]", found=repr(table))
        if app[name].default_command is None:
            _check_tables(app[name], table, f"{where}: {name}")


def _commands(app: cyclopts.App) -> list[str]:
    return [name for name in app if not name.startswith("-")]


def _mistake(error: cyclopts.CycloptsError) -> str:
    """Describe in one line what is wrong with the arguments."""
    if isinstance(error, cyclopts.UnknownOptionError):
        return _unknown_option(error)
    if isinstance(error, cyclopts.UnusedCliTokensError):
        return f"unexpected argument {(error.unused_tokens or ['?'])[0]!r}"
    names = sorted(error.argument.names, key=len) or [error.argument.name] if error.argument else []
    if isinstance(error, cyclopts.MissingArgumentError) and names:
        if isinstance(error, cyclopts.ConsumeMultipleError) and error.actual_count:
            most = count(error.max_allowed or 1, "value")
            return f"argument {error.keyword}: expected at most {most}, found {error.actual_count}"
        if error.keyword:
            return f"argument {error.keyword}: expected a value"
        return f"the following arguments are required: {'/'.join(names)}"
    if isinstance(error, cyclopts.CoercionError) and error.token is not None:
        source, flag = error.token.source, error.token.keyword or "/".join(names)
        where = f"argument {flag}" if source == "cli" else f"{source}: {flag}"
        literal = typing.get_origin(error.target_type) is Literal
        noun = _NOUNS.get(error.target_type, "a number or text")
        if literal:
            noun = f"one of {', '.join(map(str, typing.get_args(error.target_type)))}"
        return f"{where}: " + str(error.msg or f"expected {noun}, found {error.token.value!r}")
    return " ".join(str(error).split())


def _unknown_option(error: cyclopts.UnknownOptionError) -> str:
    name = error.token.keyword or error.token.value
    taken = (argument for argument in error.argument_collection if argument.parse)
    known = [name for argument in taken for name in argument.names]
    known = [name for name in known if name.startswith("-") and name not in _FORMER]
    if error.token.source == "cli":
        return str(unknown_name("option", name.partition("=")[0], ["--help", *known]))
    keys = [name.removeprefix("--") for name in known if name.startswith("--")]
    name = name.strip("[]").replace("][", ".")
    return str(unknown_name("option", name, keys, where=error.token.source))


def warn(text: str) -> None:
    """Print a warning of `kt3dmoseg` on standard error."""
    print(f"kt3dmoseg: warning: {text}", file=sys.stderr)


@contextmanager
def progress_bar(unit: str, *, quiet: bool = False) -> Iterator[Callable[..., None]]:
    """Give a function (done, total, text="") that draws progress on standard error, on a terminal only.

    Its clock runs while nothing is reported, so that long steps do not look dead.
    """
    from tqdm import tqdm

    over = threading.Event()

    def tick() -> None:
        while not over.wait(1):
            bar.refresh()

    with tqdm(unit=unit, disable=True if quiet else None, smoothing=0) as bar:
        if not bar.disable:
            threading.Thread(target=tick, daemon=True).start()

        def show(done: int, total: int | None, text: str = "") -> None:
            bar.total = total
            bar.update(done - bar.n)
            bar.set_postfix_str(text)

        try:
            yield show
        finally:
            over.set()
