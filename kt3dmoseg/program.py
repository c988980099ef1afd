"""A command-line program as a table of commands, each imported only when it is called.

A command is a module with ``configure(parser)`` and ``run(arguments) -> int | None``.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any, NoReturn

from kt3dmoseg import __version__
from kt3dmoseg.errors import KT3DMoSegError
from kt3dmoseg.registry import unknown_name

_INTERRUPTED = 130
_USAGE = 2


class Parser(argparse.ArgumentParser):
    """The arguments of one command: none may be abbreviated, and a mistake is answered in one line.

    Abbreviations are refused because a flag that is added later would change what they mean.
    """

    def __init__(self, *args: Any, **settings: Any) -> None:  # noqa: ANN401  # argparse's own
        super().__init__(*args, **{"allow_abbrev": False} | settings)

    def error(self, message: str) -> NoReturn:
        """Say what is wrong, and where help is, without the long list of options."""
        self.exit(_USAGE, f"{self.prog}: {message} (see '{self.prog} --help')\n")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:  # noqa: ANN401
        """Parse, and refuse what is unknown with the nearest option; sub-commands come here too."""
        found, unknown = super().parse_known_args(args, namespace)
        if unknown and unknown[0].startswith("-"):
            flag = unknown[0].partition("=")[0]
            self.error(str(unknown_name("option", flag, self._option_string_actions)))
        if unknown:
            self.error(f"unexpected argument {unknown[0]!r}")
        return found, unknown


def main(
    program: str,
    purpose: str,
    commands: Mapping[str, tuple[str, str]],
    argv: Sequence[str] | None = None,
) -> int:
    """Run one command of a program and return its exit code.

    Parameters
    ----------
    program, purpose : str
        Name of the program and one line on what it is for.
    commands : mapping of str to (module, help)
        The commands; a module is imported only when its command is called.
    argv : sequence of str, optional
        Arguments without the program's name; by default those of the process.

    Returns
    -------
    int
        0 on success; an error's own exit code (2, or 1 for a rejected submission) after one line
        on standard error; 130 when interrupted.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        return _dispatch(program, purpose, commands, arguments)
    except KT3DMoSegError as error:
        print(f"{program}: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print(f"{program}: interrupted; what was finished is kept", file=sys.stderr)
        return _INTERRUPTED
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:  # what the system refuses (full disk, no permission) is no bug
        print(f"{program}: {error.filename or 'system'}: {error.strerror or error}", file=sys.stderr)
        return _USAGE


def _dispatch(
    program: str, purpose: str, commands: Mapping[str, tuple[str, str]], arguments: list[str]
) -> int:
    first = arguments[0] if arguments else "--help"
    if first in ("-h", "--help"):
        print(_overview(program, purpose, commands))
        return 0 if arguments else _USAGE
    if first == "--version":
        print(f"{program} {__version__}")
        return 0
    if first not in commands:
        raise unknown_name("command", first, commands)
    module = import_module(commands[first][0])
    parser = Parser(
        prog=f"{program} {first}",
        description=module.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    module.configure(parser)
    return module.run(parser.parse_args(arguments[1:])) or 0


def _overview(program: str, purpose: str, commands: Mapping[str, tuple[str, str]]) -> str:
    width = max(map(len, commands), default=0)
    lines = [f"usage: {program} COMMAND [options]", "", purpose, "", "commands:"]
    lines += [f"  {name:<{width}}  {text}" for name, (_, text) in commands.items()]
    return "\n".join([*lines, "", f"'{program} COMMAND --help' tells more; '{program} --version'."])
