"""Benchmark protocols as data: which clips count, in which groups, and what was published on them."""

from __future__ import annotations

import re
import tomllib
from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.resources import files
from itertools import pairwise

from kt3dmoseg.registry import unknown_name
from kt3dmoseg.text import count


@dataclass(frozen=True)
class Group:
    """A part of a benchmark over which scores are averaged."""

    name: str
    title: str
    n_clips: int  # of the full benchmark, however many are present
    clips: tuple[str, ...] = ()  # where the benchmark lists them
    pattern: str = ".+"  # else a regular expression for the full name
    n_motions: int | None = None  # that a clip must have, where that is the rule
    unknown: bool = False  # the benchmark does not define which clips belong here: nothing can be scored

    def holds(self, clip: str, n_motions: int | None = None) -> bool:
        """Whether a clip, with that number of motions, belongs to the group."""
        if self.unknown or (self.n_motions is not None and n_motions != self.n_motions):
            return False
        return clip in self.clips if self.clips else re.fullmatch(self.pattern, clip) is not None


@dataclass(frozen=True)
class Axis:
    """A property of clips by which the error is broken down."""

    name: str  # key in the attributes of clips ("motions": their number of motions)
    title: str  # heading, with its unit
    bounds: tuple[float, ...] = ()  # where one bin ends and the next begins; without any, each value is one

    def bins(self, values: Mapping[str, float | str]) -> dict[str, list[str]]:
        """Sort clips, given with their values, into bins by title; bins without clips are left out."""
        if not self.bounds:
            kinds = sorted(set(values.values()))  # all of them numbers, or all texts
            return {str(kind): [clip for clip, v in values.items() if v == kind] for kind in kinds}
        titles = bin_titles(self.bounds)
        bins: dict[str, list[str]] = {title: [] for title in titles}
        for clip, value in values.items():
            bins[titles[bisect_right(self.bounds, float(value))]].append(clip)
        return {title: clips for title, clips in bins.items() if clips}


@dataclass(frozen=True)
class Protocol:
    """A benchmark: its groups of clips, its exclusions and the published results.

    In every protocol only the evaluated trajectories of a clip are scored, those with true label
    0 are left out, and the mean over clips weighs each clip the same.
    """

    name: str
    title: str
    n_clips: int  # of the full benchmark
    groups: tuple[Group, ...]  # the one named "all" comes last
    source: str = ""  # reference
    exclude: tuple[str, ...] = ()  # clips that exist in the data but never count
    notes: tuple[str, ...] = ()  # what is unclear or must be known to read the figures
    # Method -> group name -> {"mean": per cent, "median": per cent}, Table 1 of Xu et al. 2018.
    published: Mapping[str, Mapping[str, Mapping[str, float]]] = field(default_factory=dict)
    published_dataset_version: str = ""  # of the data of the published results; empty = the only one
    prevalence: Mapping[str, float] = field(default_factory=dict)  # % error of one motion per clip, if known
    versions: Mapping[str, Mapping[str, str]] = field(default_factory=dict)  # -> clip -> clip_checksum
    axes: tuple[Axis, ...] = ()  # by which the error is broken down
    attributes: Mapping[str, Mapping[str, float | str]] = field(default_factory=dict)  # clip -> axis -> value
    data: str = ""  # conventional name of the folder that holds the clips

    def holds(self, clip: str) -> bool:
        """Whether a clip of that name counts in this benchmark."""
        return clip not in self.exclude and self.group("all").holds(clip)

    def of_version(self, version: str) -> Protocol:
        """Return it without the published results where those are of another version of the data."""
        same = self.published_dataset_version in ("", version)
        return self if same else replace(self, published={})

    def group(self, name: str) -> Group:
        """Return the group of that name; UnknownNameError when there is none."""
        for group in self.groups:
            if group.name == name:
                return group
        raise unknown_name(f"group of {self.name}", name, [g.name for g in self.groups])

    @property
    def clips(self) -> tuple[str, ...]:
        """Names of all clips; empty where the benchmark is defined by a rule."""
        return self.group("all").clips

    def version_of(self, checksums: Mapping[str, str]) -> str:
        """Recognise the dataset version of the clips at hand; empty when it is none that is known."""
        for version, known in self.versions.items():
            listed = [name for name in checksums if name in known]
            if listed and all(checksums[name] == known[name] for name in listed):
                return version
        return ""

    def contradicts(self, version: str, checksums: Mapping[str, str]) -> bool:
        """Whether the clips at hand are known not to be of a version."""
        here, known = self.version_of(checksums), self.versions.get(version, {})
        other = here != "" and version not in (here, "unnamed")  # as files call what had no name then
        return other or any(known.get(n, c) != c for n, c in checksums.items())

    def clips_of(self, group: Group, motions: Mapping[str, int]) -> list[str]:
        """Names of the clips at hand, given with their true numbers of motions, that belong to a group."""
        return [name for name, n in motions.items() if self.holds(name) and group.holds(name, n)]

    def bins_of(self, axis: Axis, motions: Mapping[str, int]) -> dict[str, list[str]]:
        """Sort the clips at hand, given with their true numbers of motions, into the bins of an axis."""
        known = {
            name: {"motions": n, **self.attributes.get(name, {})}
            for name, n in motions.items()
            if self.holds(name)
        }
        return axis.bins({name: values[axis.name] for name, values in known.items() if axis.name in values})

    def coverage(self, clips: Iterable[str]) -> str:
        """Describe how much of the benchmark is at hand: ``"14 of 22 clips"`` or ``"all 22 clips"``."""
        present = sum(self.holds(name) for name in clips)
        return f"{share(present, self.n_clips)} clips" if self.n_clips > 1 else count(present, "clip")


def bin_titles(bounds: Sequence[float]) -> tuple[str, ...]:
    """Name the bins between some bounds, and those below and above."""
    between = (f"{low:g} to {high:g}" for low, high in pairwise(bounds))
    return f"under {bounds[0]:g}", *between, f"{bounds[-1]:g} and over"


def share(present: int, total: int) -> str:
    """Describe how many of all: "all 22", "14 of 22"."""
    return f"all {total}" if present == total else f"{present} of {total}"


def list_protocols() -> list[str]:
    """Names of the built-in benchmark protocols."""
    found = files("mseg").joinpath("protocols").iterdir()
    return sorted(each.name.removesuffix(".toml") for each in found if each.name.endswith(".toml"))


@cache
def load_protocol(name: str) -> Protocol:
    """Return a benchmark protocol by name; an UnknownNameError proposes the nearest.

    Examples
    --------
    >>> load_protocol("hopkins155").group("three").n_clips
    35
    >>> load_protocol("hopkins155").holds("dancing")
    False
    """
    if name not in list_protocols():
        raise unknown_name("benchmark", name, list_protocols())
    raw = tomllib.loads(files("mseg").joinpath("protocols", f"{name}.toml").read_text(encoding="utf-8"))
    groups = tuple(Group(**{**g, "clips": tuple(g.get("clips", ()))}) for g in raw.pop("groups"))
    raw["axes"] = tuple(Axis(**{**a, "bounds": tuple(a.get("bounds", ()))}) for a in raw.get("axes", ()))
    lists = {key: tuple(raw.get(key, ())) for key in ("exclude", "notes")}
    return Protocol(name=name, groups=groups, **(raw | lists))


def protocol_of_clips(clips: Iterable[str]) -> Protocol:
    """Make the protocol of clips that belong to no benchmark: all of them, one group."""
    names = tuple(clips)
    group = Group("all", "all clips", len(names), names)
    return Protocol("custom", "clips of no benchmark", len(names), (group,))


def choose_protocol(name: str, clips: Iterable[str]) -> Protocol:
    """Return the protocol of that name; without one, the benchmark to which most of the clips belong by name.

    Clips of no benchmark, or for the name "custom", have a protocol of their own.
    """
    if name not in ("", "custom"):
        return load_protocol(name)
    names, known = list(clips), list(map(load_protocol, list_protocols()))
    counts = [sum(map(protocol.holds, names)) for protocol in known]
    most = max(counts)
    return protocol_of_clips(names) if name or 2 * most <= len(names) else known[counts.index(most)]
