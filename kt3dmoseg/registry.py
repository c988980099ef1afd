"""Named things that are imported when used: tables of methods and the like, public names of packages.

Listing names imports nothing. Third parties add to a table through an entry point group.
"""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from types import MappingProxyType
from typing import Any

from kt3dmoseg.errors import UnknownNameError


class Registry:
    """A table of names to "module:attribute" targets.

    `kind` is what it holds, in the singular, for messages: ``"method"``; `group` the entry point group of
    third parties, which cannot replace a built-in name.
    """

    def __init__(self, kind: str, table: Mapping[str, str], group: str) -> None:
        self.kind, self.table, self.group = kind, dict(table), group

    def targets(self) -> dict[str, str]:
        """Every name and its target; built-in names first, then third parties' by name."""
        from importlib.metadata import entry_points

        others = sorted((point.name, point.value) for point in entry_points(group=self.group))
        return self.table | {name: value for name, value in others if name not in self.table}

    def names(self) -> list[str]:
        """All names, built-in first."""
        return list(self.targets())

    def load(self, name: str) -> Any:  # noqa: ANN401  # the object behind the name, of the table's kind
        """Import and return the object named `name`; an `UnknownNameError` proposes the nearest name."""
        # Third parties' names are looked for only when needed: that reads a file of every package.
        target = self.table.get(name) or self.targets().get(name)
        if target is None:
            raise unknown_name(self.kind, name, self.names())
        module, _, attribute = target.partition(":")
        return getattr(import_module(module), attribute)


def nearest(name: str, known: Iterable[str]) -> str:
    """Return the known name that a misspelt one is most like, whatever the case; empty when none is."""
    from difflib import get_close_matches

    folded = {each.lower(): each for each in known}
    close = get_close_matches(name.lower(), folded, n=1)
    return folded[close[0]] if close else ""


def unknown_name(kind: str, name: object, known: Iterable[str], *, where: str = "") -> UnknownNameError:
    """Make the error for an unknown name, with the nearest known one or the whole list."""
    names = list(known)
    meant = nearest(str(name), names)
    fix = f"did you mean {meant!r}?" if meant else f"known: {', '.join(names) or 'none'}"
    message = f"unknown {kind} {str(name)!r}"
    return UnknownNameError(f"{where}: {message}" if where else message, fix=fix)


def lazy(
    package: str, *own: str, former: Mapping[str, str] = MappingProxyType({})
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Make ``__getattr__``, ``__dir__`` and ``__all__`` of a package whose names are imported on first use.

    They are the names that its source imports as themselves for type checkers, ``if TYPE_CHECKING``, and its
    `own`, which it defines. `former` are modules of the package by older names.
    """
    lines = ast.parse(inspect.getsource(sys.modules[package])).body
    typed = [line for line in lines if isinstance(line, ast.If) and ast.unparse(line.test) == "TYPE_CHECKING"]
    imports = [line for block in typed for line in block.body if isinstance(line, ast.ImportFrom)]
    names = {alias.name: line.module or "" for line in imports for alias in line.names if alias.asname}

    def getattr_(name: str) -> Any:  # noqa: ANN401  # the object may be anything
        if name in former or names.get(name) == package:
            return import_module(f"{package}.{former.get(name, name)}")
        if name not in names:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(names[name]), name)

    public = [*own, *names]
    return getattr_, lambda: sorted(public), public
