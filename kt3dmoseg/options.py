"""Options as dataclass fields: one definition gives keywords, CLI flags, TOML keys and help.

>>> from dataclasses import dataclass
>>> @dataclass(frozen=True)
... class Grid:
...     spacing: int = option(8, "distance of seeds in pixels", low=1)
>>> from_mapping(Grid, {"spacing": "4"})
Grid(spacing=4)
"""

from __future__ import annotations

import argparse
import dataclasses
import inspect
import types
import typing
from collections.abc import Iterable, Mapping
from typing import Any, Literal, TypeVar, Union

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.registry import unknown_name

T = TypeVar("T")


def option(
    default: Any,  # noqa: ANN401
    help: str,
    *,
    low: float | None = None,
    high: float | None = None,
    metavar: str = "",
) -> Any:  # noqa: ANN401  # a dataclass field, which must pose as the field's own type
    """Make a dataclass field with its help text and inclusive bounds.

    Parameters
    ----------
    default : object
        Immutable default value.
    help : str
        One line: meaning, unit, source.
    low, high : float, optional
        Inclusive bounds of a number, checked by `check` and `from_mapping`.
    metavar : str
        What stands for the value in ``--help``, for instance FOLDER.
    """
    about = {"help": help, "low": low, "high": high, "metavar": metavar}
    return dataclasses.field(default=default, metadata=about)


@dataclasses.dataclass(frozen=True)
class Preset:
    """Values of several options under one name.

    A dataclass offers presets in a class attribute `presets`, by name. Where one is asked for, its values
    take the place of the defaults; what is given beside it goes before. It leaves no trace but these values.

    Parameters
    ----------
    help : str
        One line: what it is for.
    values : mapping of str to object
        Options by name.
    """

    help: str
    values: Mapping[str, Any]


def from_mapping(cls: type[T], values: Mapping[str, Any], *, where: str = "") -> T:
    """Build an options dataclass from keywords, TOML keys or strings.

    Parameters
    ----------
    cls : type
        A dataclass made of `option` fields.
    values : mapping of str to object
        Values; strings are converted to the field's type. The name of a `Preset` takes true or false.
    where : str
        Context for messages, for instance a file name.

    Raises
    ------
    UnknownNameError
        For a misspelt key, with the nearest name.
    InvalidValueError
        For a value of the wrong type or out of bounds.
    """
    hints = typing.get_type_hints(cls)
    names = option_names(cls)
    for key in values:
        if key not in names:
            raise unknown_name("option" if where else f"option of {cls.__name__}", key, names, where=where)
    values = _with_presets(cls, values, where)
    converted = {
        key: _convert(value, hints[key], f"{where}: {key}" if where else key) for key, value in values.items()
    }
    return check(cls(**converted), where=where)


def check(instance: T, *, where: str = "") -> T:
    """Return `instance` after checking the bounds of its fields."""
    for spec in dataclasses.fields(instance):  # type: ignore[arg-type]
        value, low, high = getattr(instance, spec.name), spec.metadata.get("low"), spec.metadata.get("high")
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            inside = (low is None or value >= low) and (high is None or value <= high)
            if not inside:
                bounds = " and ".join(
                    t
                    for t in (
                        f">= {low}" if low is not None else "",
                        f"<= {high}" if high is not None else "",
                    )
                    if t
                )
                raise InvalidValueError(
                    f"{where}: {spec.name}" if where else spec.name,
                    expected=f"a number {bounds}",
                    found=repr(value),
                )
    return instance


def option_names(cls: type[Any]) -> list[str]:
    """Names of the options of a dataclass and of its presets, in order."""
    return [*(spec.name for spec in dataclasses.fields(cls) if spec.init), *_presets(cls)]


def add_arguments(parser: argparse.ArgumentParser, cls: type[Any], *, skip: Iterable[str] = ()) -> None:
    """Add one flag ``--name`` per field of `cls`; absent flags leave no trace in the namespace."""
    hints = typing.get_type_hints(cls)
    group = parser.add_argument_group((inspect.getdoc(cls) or cls.__name__).partition("\n")[0].rstrip("."))
    for name, preset in _presets(cls).items():
        values = ", ".join(f"{key} {value}" for key, value in preset.values.items())
        group.add_argument(
            f"--{name}", action="store_true", default=argparse.SUPPRESS, help=f"{preset.help}: {values}"
        )
    for spec in dataclasses.fields(cls):
        if spec.init and spec.name not in set(skip):
            _add_argument(group, spec, hints[spec.name])


def from_namespace(cls: type[T], namespace: argparse.Namespace) -> T:
    """Build an options dataclass from parsed flags."""
    given = {name: getattr(namespace, name) for name in option_names(cls) if hasattr(namespace, name)}
    return from_mapping(cls, given)


def add_parameters(parser: argparse.ArgumentParser, what: str) -> None:
    """Add ``-p NAME=VALUE``, for the parameters of `what`; `parse_assignments` reads them."""
    common: dict[str, Any] = {"action": "append", "default": [], "metavar": "NAME=VALUE", "dest": "parameter"}
    parser.add_argument("-p", "--parameter", help=f"parameter of {what}; may be repeated", **common)
    parser.add_argument("--set", help=argparse.SUPPRESS, **common)  # an older name


def parse_assignments(pairs: Iterable[str]) -> dict[str, str]:
    """Split ``["alpha=8"]`` into ``{"alpha": "8"}``.

    Raises
    ------
    InvalidValueError
        When a pair has no ``=``.
    """
    out: dict[str, str] = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals or not key:
            raise InvalidValueError("parameter", expected="name=value", found=repr(pair))
        out[key.strip().replace("-", "_")] = value.strip()
    return out


def describe(cls: type[Any]) -> list[tuple[str, str, str]]:
    """List (name, default, help) of every option, for help texts and docs."""
    return [(s.name, repr(s.default), s.metadata.get("help", "")) for s in dataclasses.fields(cls) if s.init]


def _presets(cls: type[Any]) -> Mapping[str, Preset]:
    return getattr(cls, "presets", {})


def _with_presets(cls: type[Any], values: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Put the values of the presets that are asked for behind those that are given by themselves."""
    presets = _presets(cls)
    out = {key: value for key, value in values.items() if key not in presets}
    for name, preset in presets.items():
        if _boolean(values.get(name, False), f"{where}: {name}" if where else name):
            out = {**preset.values, **out}
    return out


def _add_argument(group: Any, spec: dataclasses.Field[Any], hint: Any) -> None:  # noqa: ANN401
    flag = "--" + spec.name.replace("_", "-")
    text = f"{spec.metadata.get('help', '')}{_shown_default(spec.default)}".replace("%", "%%")
    common: dict[str, Any] = {"dest": spec.name, "default": argparse.SUPPRESS, "help": text}
    if hint is bool:
        group.add_argument(flag, action=argparse.BooleanOptionalAction, **common)
    else:
        choices = typing.get_args(hint) if typing.get_origin(hint) is Literal else None
        named = spec.metadata.get("metavar") or {int: "N", float: "X"}.get(hint, spec.name.upper())
        shown = "{" + ",".join(map(str, choices)) + "}" if choices else named
        group.add_argument(flag, metavar=shown, **common)


def _shown_default(default: Any) -> str:  # noqa: ANN401
    """Say a default in the form in which the flag takes it; nothing where there is none."""
    if default is None or default == "":
        return ""
    return f" (default: {','.join(map(str, default)) if isinstance(default, tuple) else default})"


def _convert(value: Any, hint: Any, where: str) -> Any:  # noqa: ANN401
    origin = typing.get_origin(hint)
    if origin is Literal:
        return _one_of(value, typing.get_args(hint), where)
    if origin in (Union, types.UnionType):
        return _first_fit(value, typing.get_args(hint), where)
    if origin is tuple:
        return _tuple(value, typing.get_args(hint), where)
    if hint is bool:
        return _boolean(value, where)
    if hint in (int, float, str):
        return _scalar(value, hint, where)
    return value


def _one_of(value: Any, choices: tuple[Any, ...], where: str) -> Any:  # noqa: ANN401
    for choice in choices:
        if value == choice or str(value) == str(choice):
            return choice
    raise InvalidValueError(where, expected=f"one of {', '.join(map(str, choices))}", found=repr(value))


def _first_fit(value: Any, hints: tuple[Any, ...], where: str) -> Any:  # noqa: ANN401
    if type(None) in hints and (value is None or value in ("", "none", "None")):
        return None
    failure: InvalidValueError | None = None
    for hint in hints:
        if hint is not type(None):
            try:
                return _convert(value, hint, where)
            except InvalidValueError as error:
                failure = failure or error
    assert failure is not None
    raise failure


def _tuple(value: Any, hints: tuple[Any, ...], where: str) -> tuple[Any, ...]:  # noqa: ANN401
    parts = [p.strip() for p in value.split(",")] if isinstance(value, str) else list(value)
    each = [hints[0]] * len(parts) if len(hints) == 2 and hints[1] is Ellipsis else list(hints)
    if len(each) != len(parts):
        raise InvalidValueError(where, expected=f"{len(each)} values", found=repr(value))
    return tuple(_convert(p, h, where) for p, h in zip(parts, each, strict=True))


def _boolean(value: Any, where: str) -> bool:  # noqa: ANN401
    if isinstance(value, bool):
        return value
    words = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
    word = str(value).lower()
    if word not in words:
        raise InvalidValueError(where, expected="true or false", found=repr(value))
    return words[word]


def _scalar(value: Any, kind: type[Any], where: str) -> Any:  # noqa: ANN401
    allowed = {int: (int, str), float: (int, float, str), str: (str,)}[kind]
    try:
        if isinstance(value, bool) or not (isinstance(value, allowed) or hasattr(value, "item")):
            raise ValueError
        number = kind(value)
        if kind is float and number != number:
            raise ValueError
        if kind is int and not isinstance(value, str) and number != value:
            raise ValueError
    except (ValueError, TypeError, OverflowError):
        noun = {int: "a whole number", float: "a number", str: "text"}[kind]
        raise InvalidValueError(where, expected=noun, found=repr(value)) from None
    return number
