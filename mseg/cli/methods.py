"""List the methods, or describe one: source, input, cost and parameters."""

from __future__ import annotations

import argparse
import inspect


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("method", nargs="?", metavar="METHOD", help="describe this one")


def run(arguments: argparse.Namespace) -> None:
    """List or describe."""
    from kt3dmoseg.options import describe
    from mseg.methods import METHODS

    if arguments.method:
        cls = METHODS.load(arguments.method)
        print(f"{arguments.method}: {inspect.cleandoc(cls.__doc__ or '')}\n\nparameters (-p name=value):")
        for name, default, text in describe(cls):
            print(f"  {name} = {default}\n      {text}")
        return
    names = METHODS.names()
    width = max(map(len, names))
    for name in names:
        print(f"{name:<{width}}  {_purpose(name)}")


def _purpose(name: str) -> str:
    """First line of a method's docstring."""
    from mseg.methods import METHODS

    try:
        cls = METHODS.load(name)
    except ImportError as error:
        return f"(not available: {error})"
    return inspect.cleandoc(cls.__doc__ or "").partition("\n")[0]
