"""Reading ``meta.toml``: every field checked, every problem told."""

from __future__ import annotations

import dataclasses
import math
import tomllib
from collections.abc import Mapping
from typing import Any

from kt3dmoseg.registry import nearest
from mseg.evaluation.problems import Problem
from mseg.evaluation.protocol import list_protocols
from mseg.evaluation.submission import FORMAT_VERSION, META, SubmissionMeta

_TEXT_LIMIT = 2000
_TEXTS = ("method", "dataset_version", "benchmark", "link", "hardware")
_FLAGS = ("n_motions_given", "outliers", "baseline")
_MAPS = ("fingerprints", "parameters")
_EXAMPLE = "see docs/submit.md, or let 'mseg example-submission' write one"


def parse_meta(content: bytes) -> tuple[SubmissionMeta, list[Problem]]:
    """Read ``meta.toml``.

    Returns
    -------
    meta : SubmissionMeta
        With defaults where a field is missing or wrong.
    problems : list of Problem
    """
    try:
        raw = tomllib.loads(content.decode("utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError, ValueError) as error:
        found = f"a syntax error: {' '.join(str(error).split())[:160]}"
        return SubmissionMeta("unnamed"), [
            Problem("meta-syntax", META, expected="TOML", found=found, fix=_EXAMPLE)
        ]
    reader = _Reader(raw)
    return reader.meta(), reader.problems


class _Reader:
    def __init__(self, raw: dict[str, Any]) -> None:
        self.raw, self.problems = raw, list[Problem]()

    def meta(self) -> SubmissionMeta:
        version = self.raw.pop("format_version", None)
        if version != FORMAT_VERSION or isinstance(version, bool):
            self.bad("format_version", str(FORMAT_VERSION), repr(version))
        self._unknown_keys()
        values: dict[str, Any] = {"method": "unnamed"}
        for name in _TEXTS:
            self._take(values, name, self._is_text, "a text")
        for name in _FLAGS:
            self._take(values, name, lambda v: isinstance(v, bool), "true or false")
        self._take(values, "seconds", _is_time, "seconds >= 0")
        self._take(values, "authors", self._are_texts, 'a list of names, ["A. Author"]')
        for name in _MAPS:
            self._take(values, name, self._is_table, "a table of texts")
        self._required()
        values["authors"] = tuple(values.get("authors", ("unnamed",)))
        return SubmissionMeta(**values)

    def bad(self, field: str, expected: str, found: str, fix: str = _EXAMPLE) -> None:
        self.problems.append(
            Problem("meta-field", META, expected=f"{field} = {expected}", found=found[:80], fix=fix)
        )

    def _unknown_keys(self) -> None:
        known = [field.name for field in dataclasses.fields(SubmissionMeta)]
        for key in self.raw:
            if key not in known:
                meant = nearest(key, known)
                fix = f"did you mean {meant!r}?" if meant else f"put it under [parameters]; {_EXAMPLE}"
                self.problems.append(
                    Problem("meta-field", META, expected="a known field", found=repr(key)[:80], fix=fix)
                )

    def _take(self, values: dict[str, Any], name: str, fits: Any, expected: str) -> None:  # noqa: ANN401
        if name not in self.raw:
            return
        if fits(self.raw[name]):
            values[name] = self.raw[name]
        else:
            self.bad(name, expected, repr(self.raw[name]))

    def _required(self) -> None:
        for name, example in (("method", '"My method"'), ("authors", '["A. Author"]')):
            if not self.raw.get(name):
                self.bad(name, example, "nothing")
        if "n_motions_given" not in self.raw:
            self.bad("n_motions_given", "true or false", "nothing", "say whether the method was told it")
        benchmark = self.raw.get("benchmark")
        if isinstance(benchmark, str) and benchmark not in ("", "custom", *list_protocols()):
            meant = nearest(benchmark, list_protocols())
            fix = f"did you mean {meant!r}?" if meant else ""
            self.bad("benchmark", "one of " + ", ".join(list_protocols()), repr(benchmark), fix)
        if not self.raw.get("dataset_version") and not self.raw.get("fingerprints"):
            self.bad("dataset_version", '"2018", the version of the data that was segmented', "nothing")

    @staticmethod
    def _is_text(value: object) -> bool:
        return isinstance(value, str) and len(value) <= _TEXT_LIMIT

    def _are_texts(self, value: object) -> bool:
        return isinstance(value, list) and len(value) <= _TEXT_LIMIT and all(map(self._is_text, value))

    def _is_table(self, value: object) -> bool:
        return isinstance(value, Mapping) and all(map(self._is_text, value.values()))


def _is_time(value: object) -> bool:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return number and math.isfinite(value) and value >= 0  # type: ignore[arg-type, operator]  # a number
