"""What both command lines share: flags from options dataclasses, plain help, one-line mistakes, TOML files.

A command is a typed function with a numpydoc docstring; cyclopts makes arguments, help and shell completion
of it. Heavy modules are imported inside the functions, so that ``--help`` stays fast.
"""

from __future__ import annotations

import dataclasses
import inspect
import os
import shutil
import sys
import textwrap
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import cyclopts
from cyclopts import Group, Parameter
from cyclopts.config import Dict

from kt3dmoseg import __version__
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.options import presets
from kt3dmoseg.registry import unknown_name

Command = TypeVar("Command", bound=Callable[..., int | None])

_INTERRUPTED = 130
_USAGE = 2
_RARE = " (rarely changed)"
_LABELS = 26  # width of the column of names in help
_FORMER = {"--set": "--parameter"}  # older names of flags, taken and not listed
_FOOTER = "Every command also takes --config FILE (options in TOML, a table per command) and --help-all."


def _positive(_: type, tokens: Sequence[cyclopts.Token]) -> int:
    text = tokens[0].value
    if not text.isdecimal() or int(text) < 1:
        raise ValueError(f"expected a whole number >= 1, found {text!r}")
    return int(text)


def exclusive(arguments: cyclopts.ArgumentCollection) -> None:
    """Refuse several options of a group that offers alternatives."""
    given = [argument.tokens[0].keyword or argument.name for argument in arguments if argument.tokens]
    if len(given) > 1:
        raise ValueError(f"argument {given[1]}: not allowed with argument {given[0]}")


Flag = Annotated[bool, Parameter(negative=(), show_default=False)]
Positive = Annotated[int, Parameter(converter=_positive, metavar="N")]
Whole = Annotated[int, Parameter(metavar="N")]
Name = Annotated[str, Parameter(metavar="NAME")]
Folder = Annotated[Path, Parameter(metavar="FOLDER")]
File = Annotated[Path, Parameter(metavar="FILE")]
Url = Annotated[str, Parameter(metavar="URL")]
Either = Annotated[Path, Parameter(metavar="PATH")]
Parameters = Annotated[
    tuple[str, ...], Parameter(alias=("-p", "--set"), metavar="NAME=VALUE", show_default=False)
]


def application(name: str, purpose: str, commands: Mapping[str, str]) -> cyclopts.App:
    """Make a program of its commands.

    Parameters
    ----------
    name, purpose : str
        Name of the program and one line on what it is for.
    commands : mapping of str to str
        Name -> "module:function", or "module:app" for a group of commands; a module is imported when its
        command is called or listed.
    """
    app = group(name, purpose)
    app.version = f"{name} {__version__}"
    app.default_parameter = Parameter(negative_iterable=(), allow_repeating=True)
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
    """Let a command take the fields of options dataclasses as flags.

    The command gets in its ``**keywords`` those that were given, as they were written: the public function
    that it calls converts and checks them. A field that is a parameter of the command itself is left out.
    """

    def decorate(command: Command) -> Command:
        signature = inspect.signature(command)
        own = [p for p in signature.parameters.values() if p.kind is not p.VAR_KEYWORD]
        added = {flag.name: flag for cls in classes for flag in _flags(cls)}
        for parameter in own:
            added.pop(parameter.name, None)
        changed = signature.replace(parameters=[*own, *added.values()])
        command.__signature__ = changed  # type: ignore[attr-defined]
        return command

    return decorate


def _flags(cls: type[Any]) -> Iterator[inspect.Parameter]:
    title = (inspect.getdoc(cls) or cls.__name__).partition("\n")[0].rstrip(".")
    groups = {rare: Group.create_ordered(title + _RARE * rare) for rare in (False, True)}
    hints = typing.get_type_hints(cls)

    def flag(name: str, default: object, hint: object, **settings: Any) -> inspect.Parameter:  # noqa: ANN401
        annotation = Annotated[hint, Parameter(**settings)]  # type: ignore[valid-type]
        return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)

    for name, preset in presets(cls).items():
        values = ", ".join(f"{key} {value}" for key, value in preset.values.items())
        yield flag(name, False, Flag, help=f"{preset.help}: {values}", group=groups[False])
    for spec in dataclasses.fields(cls):
        hint, about = hints[spec.name], spec.metadata
        metavar = about["metavar"] or {int: "N", float: "X"}.get(hint, spec.name.upper())
        kind = hint if hint is bool or typing.get_origin(hint) is Literal else str | hint
        yield flag(
            spec.name,
            spec.default,
            kind,
            help=about["help"],
            metavar=metavar,
            group=groups[about["rare"]],
            show_default=_shown if isinstance(spec.default, tuple) else None,
        )


def _shown(default: tuple[object, ...]) -> str:
    return ",".join(map(str, default))


class _Help:
    """Help as plain text: it can be searched and piped, and takes no time to draw."""

    everything = False

    def __call__(self, console: object, options: object, panel: Any) -> None:  # noqa: ANN401
        """Print one group of options or commands."""
        if panel.title.endswith(_RARE) and not self.everything:
            print(f"\n{panel.title}: {len(panel.entries)} more, with --help-all")
        elif panel.entries:
            print(f"\n{panel.title}:")
            for entry in panel.entries:
                print(self._row(entry))

    def render_usage(self, console: object, options: object, usage: object) -> None:
        """Print how a command is called."""
        print(f"Usage: {str(usage).strip()}")

    def render_description(self, console: object, options: object, description: Any) -> None:  # noqa: ANN401
        """Print what a command does."""
        print(f"\n{description.primary_renderable.plain.rstrip()}")

    @staticmethod
    def _row(entry: Any) -> str:  # noqa: ANN401
        names = [entry.positional_label] if entry.positional_label else []
        names += [name for name in entry.shorts + entry.names if name not in _FORMER]
        labels = ", ".join(names)
        if entry.choices:
            labels += " {" + ",".join(entry.choices) + "}"
        elif entry.metavar and not entry.positional_label:
            labels += f" {entry.metavar.replace('STR', names[-1].strip('-').upper())}"
        text = entry.description.primary_renderable.plain.rstrip(".") if entry.description else ""
        text = text[:1].upper() + text[1:]
        if entry.default not in (None, '""', "None", "()"):
            text += f" (default: {entry.default})"
        width = shutil.get_terminal_size().columns - 2
        lines = textwrap.wrap(
            text, max(width - _LABELS, 30), break_on_hyphens=False, break_long_words=False
        ) or [""]
        first = f"  {labels:<{_LABELS - 4}}  {lines[0]}" if len(labels) <= _LABELS - 4 else f"  {labels}"
        rest = lines[1:] if len(labels) <= _LABELS - 4 else lines
        return "\n".join([first.rstrip(), *(" " * _LABELS + line for line in rest)])


_HELP = _Help()


def main(app: cyclopts.App, argv: Sequence[str] | None = None) -> int:
    """Run a program and return its exit code.

    Parameters
    ----------
    app : App
        The program, from `application`.
    argv : sequence of str, optional
        Arguments without the program's name; by default those of the process.

    Returns
    -------
    int
        0 on success; an error's own exit code (2, or 1 for a rejected submission) after one line
        on standard error; 130 when interrupted.
    """
    program = app.name[0]
    try:
        return _run(app, list(sys.argv[1:] if argv is None else argv))
    except KT3DMoSegError as error:
        print(f"{program}: {error}", file=sys.stderr)
        return error.exit_code
    except cyclopts.CycloptsError as error:
        command = " ".join([program, *(error.command_chain or ())])
        print(f"{command}: {_mistake(error)} (see '{command} --help')", file=sys.stderr)
        return _USAGE
    except KeyboardInterrupt:
        print(f"{program}: interrupted; what was finished is kept", file=sys.stderr)
        return _INTERRUPTED
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:  # what the system refuses (full disk, no permission) is no bug
        print(f"{program}: {error.filename or 'system'}: {error.strerror or error}", file=sys.stderr)
        return _USAGE


def _run(app: cyclopts.App, words: list[str]) -> int:
    words, file = _without_config(words)
    app.config = [] if file is None else [Dict(_tables(app, file), source=file)]
    _HELP.everything = "--help-all" in words
    words = ["--help" if word == "--help-all" else word for word in words]
    asks_help = not words or "--help" in words or "-h" in words
    chain, apps, rest = app.parse_commands(words)
    if apps[-1].default_command is None:
        commands = [name for name in apps[-1] if not name.startswith("-")]
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
    return (code or 0) if words else _USAGE


def _without_config(words: list[str]) -> tuple[list[str], str | None]:
    """Take ``--config FILE`` out of a command line, wherever it is."""
    for number, word in enumerate(words):
        if word == "--":
            break
        if word == "--config":
            if number + 1 == len(words):
                raise InvalidValueError("--config", expected="a TOML file", found="none")
            return [*words[:number], *words[number + 2 :]], words[number + 1]
        if word.startswith("--config="):
            return [*words[:number], *words[number + 1 :]], word.partition("=")[2]
    return words, None


def _tables(app: cyclopts.App, file: str) -> dict[str, Any]:
    """Read a configuration file, one table per command; names of options are checked when they are used."""
    import tomllib

    try:
        tables = tomllib.loads(Path(file).read_text(encoding="utf-8"))
    except (ValueError, UnicodeError) as error:
        raise FileFormatError(file, expected="TOML", found=str(error)) from None
    except OSError as error:
        raise InputFileError(file, found=error.strerror or str(error)) from None
    _check_tables(app, tables, file)
    return tables


def _check_tables(app: cyclopts.App, tables: dict[str, Any], where: str) -> None:
    commands = [name for name in app if not name.startswith("-")]
    for name, table in tables.items():
        if name not in commands:
            raise unknown_name("command", name, commands, where=where)
        if not isinstance(table, dict):
            raise FileFormatError(f"{where}: {name}", expected=f"a table [{name}]", found=repr(table))
        if app[name].default_command is None:
            _check_tables(app[name], table, f"{where}: {name}")


def _mistake(error: cyclopts.CycloptsError) -> str:
    """Say in one line what is wrong with the arguments."""
    if isinstance(error, cyclopts.UnknownOptionError):
        return _unknown_option(error)
    if isinstance(error, cyclopts.UnusedCliTokensError):
        return f"unexpected argument {(error.unused_tokens or ['?'])[0]!r}"
    if isinstance(error, cyclopts.MissingArgumentError):
        return _missing(error)
    if isinstance(error, cyclopts.CoercionError) and error.token is not None:
        token = error.token
        where = f"argument {token.keyword}" if token.source == "cli" else f"{token.source}: {token.keyword}"
        if error.msg is not None:
            return f"{where}: {error.msg}"
        nouns: dict[Any, str] = {int: "a whole number", float: "a number"}
        choices = ", ".join(map(str, typing.get_args(error.target_type)))
        expected = f"one of {choices}" if choices else nouns.get(error.target_type, "another value")
        return f"{where}: expected {expected}, found {token.value!r}"
    return " ".join(str(error).split())


def _unknown_option(error: cyclopts.UnknownOptionError) -> str:
    token = error.token
    names = [
        n
        for argument in error.argument_collection
        for n in argument.names
        if n[0] == "-" and n not in _FORMER
    ]
    if token.source == "cli":
        name = (token.keyword or token.value).partition("=")[0]
        return str(unknown_name("option", name, ["--help", *names]))
    known = [name.removeprefix("--") for name in names if name.startswith("--")]
    return str(unknown_name("option", (token.keyword or "").strip("[]"), known, where=token.source))


def _missing(error: cyclopts.MissingArgumentError) -> str:
    argument = error.argument
    assert argument is not None
    if error.keyword:
        return f"argument {error.keyword}: expected a value"
    unknown = [word for word in error.unused_tokens or () if word.startswith("--")]
    also = f"; unknown option {unknown[0]!r}" if unknown else ""
    names = sorted(argument.names, key=len) or [argument.name]
    return f"the following arguments are required: {'/'.join(names)}{also}"


@contextmanager
def progress_bar(unit: str, *, quiet: bool = False, **settings: Any) -> Iterator[Callable[..., None]]:  # noqa: ANN401
    """Give a function (done, total, text="") that draws progress on standard error, on a terminal only."""
    from tqdm import tqdm

    with tqdm(unit=unit, disable=True if quiet else None, smoothing=0, **settings) as bar:

        def show(done: int, total: int | None, text: str = "") -> None:
            bar.total = total
            bar.set_postfix_str(text, refresh=False)
            bar.update(done - bar.n)

        yield show
