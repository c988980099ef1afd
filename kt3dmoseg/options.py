"""Options as dataclass fields: one definition gives keywords, flags, TOML keys, help and bounds."""

import dataclasses
import math
import typing
from collections.abc import Iterable, Mapping
from contextlib import suppress
from numbers import Integral, Real
from typing import Any, Literal, TypeVar

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.registry import unknown_name

T = TypeVar("T")
_BOOLEANS = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
_SCALARS: dict[Any, tuple[str, tuple[type, ...]]] = {
    int: ("a whole number", (Integral, str)),
    float: ("a number", (Real, str)),
    str: ("text", (str,)),
}


def option(
    default: Any,  # noqa: ANN401
    help: str,
    *,
    low: float | None = None,
    high: float | None = None,
    metavar: str = "",
) -> Any:  # noqa: ANN401  # a dataclass field, which must pose as the field's own type
    """Make a dataclass field with its help (one line: meaning, unit, source) and inclusive bounds.

    `metavar` is the name of the value in ``--help``, for instance FOLDER.
    """
    about = {"help": help, "low": low, "high": high, "metavar": metavar}
    return dataclasses.field(default=default, metadata=about)


@dataclasses.dataclass(frozen=True)
class Preset:
    """Values of several options under one name, in the class attribute `presets` of their dataclass.

    Where it is chosen, they replace the defaults; an option that is given by itself wins.
    """

    help: str
    values: Mapping[str, Any]


def from_mapping(cls: type[T], values: Mapping[str, Any], *, where: str = "") -> T:
    """Build an options dataclass from keywords, TOML keys or strings, converted to the fields' types.

    The name of a `Preset` takes true or false. A misspelt key is an UnknownNameError with the nearest name, a
    value of the wrong type or out of bounds an InvalidValueError; they begin with `where`, as a file's name.
    """
    _check_class(cls, where)
    hints, known, prefix = typing.get_type_hints(cls), option_names(cls), f"{where}: " if where else ""
    given: dict[str, Any] = {}
    preset: dict[str, Any] = {}
    for key, value in values.items():
        if key not in known:
            raise unknown_name("option" if where else f"option of {cls.__name__}", key, known, where=where)
        if key not in presets(cls):
            given[key] = _convert(value, hints[key], prefix + key)
        elif _convert(value, bool, prefix + key):
            preset |= presets(cls)[key].values
    return check(cls(**preset | given), where=where)


def check(instance: T, *, where: str = "") -> T:
    """Return `instance` after checking the bounds of its fields; infinity must be one of them."""
    for spec in dataclasses.fields(instance):  # type: ignore[arg-type]
        value, low, high = getattr(instance, spec.name), spec.metadata.get("low"), spec.metadata.get("high")
        if not isinstance(value, (int, float)) or isinstance(value, bool):
            continue
        outside = (low is not None and not value >= low) or (high is not None and not value <= high)
        if outside or (value in (math.inf, -math.inf) and value not in (low, high)):
            bounds = [f"{sign} {bound}" for sign, bound in ((">=", low), ("<=", high)) if bound is not None]
            noun = "a number" if outside else "a finite number"
            expected = f"{noun} {' and '.join(bounds)}".strip()
            name = f"{where}: {spec.name}" if where else spec.name
            raise InvalidValueError(name, expected=expected, found=repr(value))
    return instance


def presets(cls: type[Any]) -> Mapping[str, Preset]:
    """Return the presets of an options dataclass, by name."""
    return getattr(cls, "presets", {})


def option_names(cls: type[Any]) -> list[str]:
    """Names of the options of a dataclass and of its presets, in order."""
    return [*(spec.name for spec in dataclasses.fields(cls)), *presets(cls)]


def parse_assignments(pairs: Iterable[str]) -> dict[str, str]:
    """Split ``["alpha=8"]`` into ``{"alpha": "8"}``; an `InvalidValueError` for a pair without ``=``."""
    out: dict[str, str] = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals or not key:
            raise InvalidValueError("parameter", expected="name=value", found=repr(pair))
        out[key.strip().replace("-", "_")] = value.strip()
    return out


def describe(cls: type[Any], *, where: str = "") -> list[tuple[str, str, str]]:
    """List (name, default, help) of every option, for help texts and docs; of others an InvalidValueError."""
    _check_class(cls, where)
    return [(s.name, repr(s.default), s.metadata.get("help", "")) for s in dataclasses.fields(cls)]


def _check_class(cls: object, where: str) -> None:
    """Refuse what is no class of options: the entry point of a third party may name anything."""
    found = f"{cls!r:.200}"
    if isinstance(cls, type) and dataclasses.is_dataclass(cls):
        given = (spec for spec in dataclasses.fields(cls) if spec.init)
        bare = [s.name for s in given if s.default is dataclasses.MISSING is s.default_factory]
        if not bare:
            return
        found += f" without one of {', '.join(bare)}"
    raise InvalidValueError(where, expected="a dataclass with a default for every field", found=found)


def _convert(value: Any, hint: Any, where: str) -> Any:  # noqa: ANN401
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if type(None) in inner:  # X | None
        return None if str(value) in ("", "none", "None") else _convert(value, inner[0], where)
    if origin is tuple:  # tuple[X, ...]
        parts = [part.strip() for part in value.split(",")] if isinstance(value, str) else value
        if not isinstance(parts, Iterable):
            raise InvalidValueError(where, expected="several values", found=repr(value))
        return tuple(_convert(part, inner[0], where) for part in parts)
    if origin is Literal:
        choices = {str(choice): choice for choice in inner}
        return _choice(value, choices, where, f"one of {', '.join(choices)}")
    if hint is bool:
        return _choice(str(value).lower(), _BOOLEANS, where, "true or false")
    return _scalar(value, hint, where) if hint in _SCALARS else value


def _choice(value: Any, choices: Mapping[str, Any], where: str, expected: str) -> Any:  # noqa: ANN401
    if str(value) not in choices:
        raise InvalidValueError(where, expected=expected, found=repr(value))
    return choices[str(value)]


def _scalar(value: Any, kind: type[Any], where: str) -> Any:  # noqa: ANN401
    noun, accepted = _SCALARS[kind]
    converted = None
    if isinstance(value, accepted) and not isinstance(value, bool):
        with suppress(ValueError, OverflowError):
            converted = kind(value)
    if converted is None or converted != converted:
        raise InvalidValueError(where, expected=noun, found=repr(value))
    return converted
