"""A command-line program as a table of commands, each imported only when it is called.

A command is a module with ``configure(parser)`` and ``run(arguments) -> int | None``.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from importlib import import_module

from kt3dmoseg import __version__
from kt3dmoseg.errors import KT3DMoSegError
from kt3dmoseg.registry import unknown_name

_INTERRUPTED = 130
_USAGE = 2


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
    parser = argparse.ArgumentParser(
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
