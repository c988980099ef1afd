"""Named things that are imported when used: tables of methods and the like, public names of packages.

Listing names imports nothing. Third parties add to a table through an entry point group.
"""

import ast
import builtins
import inspect
import sys
import typing
from collections import ChainMap, defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import wraps
from importlib import import_module
from os import PathLike
from types import FunctionType, NoneType, UnionType
from typing import Any, TypeVar

from kt3dmoseg.errors import InvalidValueError, KT3DMoSegError, MissingDependencyError, UnknownNameError

CallT = TypeVar("CallT", bound=Callable[..., Any])
_WORDS: dict[Any, str] = {PathLike: "a path", str: "text", Callable: "a function"}
_WORDS |= {Mapping: "a mapping", Sequence: "several", Iterable: "several", NoneType: "None"}
_UNCHECKED = (Any, object, bool, int, float, list, dict, set, tuple)


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
        """Import and return the object named `name`; an `UnknownNameError` proposes the nearest name.

        A KT3DMoSegError when it cannot be imported, where a package is missing a MissingDependencyError.
        """
        # Third parties' names are looked for only when needed: that reads a file of every package.
        target = self.table.get(name) or self.targets().get(name)
        if target is None:
            raise unknown_name(self.kind, name, self.names())
        module, _, attribute = target.partition(":")
        try:
            return getattr(import_module(module), attribute)
        except KT3DMoSegError:
            raise
        except Exception as error:  # a third party's module may raise anything
            raise not_loaded(f"{self.kind} {name!r}", target, error) from error


def not_loaded(where: str, target: str, error: Exception) -> KT3DMoSegError:
    """Make the error for a "module:attribute" target that cannot be imported."""
    kind = MissingDependencyError if isinstance(error, ImportError) else KT3DMoSegError
    expected, found = f"an importable {target}", f"{type(error).__name__}: {error}"
    return kind(where, expected=expected, found=found, fix="repair or uninstall the package that names it")


def nearest(name: str, known: Iterable[str]) -> str:
    """Return the known name that a misspelt one is most like, whatever the case; empty when none is."""
    from difflib import get_close_matches

    folded = {each.lower(): each for each in known}
    cutoff = 0.7 if name.startswith("-") else 0.6  # the dashes of options are always alike
    close = get_close_matches(name.lower(), folded, n=1, cutoff=cutoff)
    return folded[close[0]] if close else ""


def unknown_name(kind: str, name: object, known: Iterable[str], *, where: str = "") -> UnknownNameError:
    """Make the error for an unknown name, with the nearest known one or the whole list."""
    names = list(known)
    meant = nearest(str(name), names)
    fix = f"did you mean {meant!r}?" if meant else f"known: {', '.join(names) or 'none'}"
    message = f"unknown {kind} {str(name)!r}"
    return UnknownNameError(f"{where}: {message}" if where else message, fix=fix)


def lazy(package: str, *own: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Make ``__getattr__``, ``__dir__`` and ``__all__`` of a package whose names are imported on first use.

    They are the names that its source imports as themselves for type checkers, ``if TYPE_CHECKING``, and its
    `own`, which it defines.
    """
    lines = ast.parse(inspect.getsource(sys.modules[package])).body
    typed = [line for line in lines if isinstance(line, ast.If) and ast.unparse(line.test) == "TYPE_CHECKING"]
    imports = [line for block in typed for line in block.body if isinstance(line, ast.ImportFrom)]
    names = {alias.name: line.module or "" for line in imports for alias in line.names if alias.asname}

    def getattr_(name: str) -> Any:  # noqa: ANN401  # the object may be anything
        if names.get(name) == package:
            return import_module(f"{package}.{name}")
        if name not in names:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        found = getattr(import_module(names[name]), name)
        if isinstance(found, FunctionType):  # replaced where it is defined, so that it can be pickled
            found = vars(sys.modules[found.__module__])[name] = strict(found)
        return found

    public = [*own, *names]
    return getattr_, lambda: sorted(public), public


def strict(call: CallT) -> CallT:
    """Let a function or class raise InvalidValueError for arguments of other types than its annotations name.

    What numbers and arrays may be, they check themselves.
    """
    if isinstance(call, type):
        call.__init__ = strict(call.__init__)  # type: ignore[misc]
        return call
    if hasattr(call, "strict"):
        return call
    signature, hints = inspect.signature(call), dict[str, Any]()
    several = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    parameters = [name for name, each in signature.parameters.items() if each.kind not in several]

    @wraps(call)
    def checked(*args: Any, **kwargs: Any) -> Any:  # noqa: ANN401
        if not hints:  # names that are imported for type checkers only may be anything
            known = ChainMap(call.__globals__, vars(builtins), defaultdict(lambda: Any))
            hints.update(dict.fromkeys(parameters, Any) | typing.get_type_hints(call, {}, known))
        for name, value in signature.bind(*args, **kwargs).arguments.items():
            if name in parameters and not _fits(value, hints[name]):
                raise InvalidValueError(name, expected=_in_words(hints[name]), found=_found(value))
        return call(*args, **kwargs)

    checked.strict = True  # type: ignore[attr-defined]
    return typing.cast(CallT, checked)


def _fits(value: object, hint: Any) -> bool:  # noqa: ANN401  # an annotation
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, UnionType):
        return any(_fits(value, each) for each in inner)
    if origin is typing.Annotated:
        return _fits(value, inner[0])
    if origin is typing.Literal:
        return isinstance(value, str) and value in inner
    kind = NoneType if hint is None else origin or hint
    if not isinstance(kind, type) or kind in _UNCHECKED or kind.__module__ == "numpy":
        return True
    if getattr(kind, "_is_protocol", False):
        members = {name for name in [*vars(kind), *inspect.get_annotations(kind)] if not name.startswith("_")}
        called = callable(value) or "__call__" not in vars(kind)
        return called and (not members or any(hasattr(value, name) for name in members))
    if not isinstance(value, kind) or (isinstance(value, bytes) and kind is not bytes):
        return False
    each: Collection[Any] = ()
    if isinstance(value, Collection) and not isinstance(value, Mapping) and len(inner) == 1:
        each = value
    return all(_fits(element, inner[0]) for element in each)


def _in_words(hint: Any) -> str:  # noqa: ANN401  # an annotation
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Annotated:
        return _in_words(inner[0])
    if origin in (typing.Union, UnionType):
        words = [_in_words(each) for each in inner]
        return " or ".join(word for word in dict.fromkeys(words) if word != "text" or "a path" not in words)
    if origin is typing.Literal:
        return " or ".join(inner)
    kind = origin or hint
    word = _WORDS.get(kind, getattr(kind, "__name__", "anything"))
    return f"{word} {_in_words(inner[0])}" if word == "several" else word


def _found(value: object) -> str:
    if isinstance(value, (list, tuple)):
        kinds = sorted({type(each).__name__ for each in value})
        return f"{type(value).__name__} of {', '.join(kinds) or 'nothing'}"
    plain = isinstance(value, (str, bytes, int, float, PathLike, NoneType))
    return f"{value!r:.60}" if plain else type(value).__name__
