"""Public names of a package that are imported on first use, so that ``--help`` stays fast."""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Mapping
from importlib import import_module
from typing import Any


def lazy(
    package: str, names: Mapping[str, str], modules: Collection[str] = ()
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Make the ``__getattr__`` and the ``__dir__`` of a package.

    Parameters
    ----------
    package : str
        Its ``__name__``.
    names : mapping of str to str
        Public name -> the module of the package that has it, or the full name of another module.
    modules : collection of str
        Modules of the package that are public themselves.
    """

    def getattr_(name: str) -> Any:  # noqa: ANN401  # whatever the name stands for
        if name in names:
            module = names[name]
            return getattr(import_module(module if "." in module else f"{package}.{module}"), name)
        if name in modules:
            return import_module(f"{package}.{name}")
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    def dir_() -> list[str]:
        return sorted(sys.modules[package].__all__)

    return getattr_, dir_
