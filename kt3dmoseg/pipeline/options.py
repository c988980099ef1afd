"""Options of a build, in addition to the tracker's."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from kt3dmoseg.options import from_mapping, option, option_names
from kt3dmoseg.registry import unknown_name
from kt3dmoseg.tracking import TrackOptions


@dataclass(frozen=True)
class BuildOptions:
    """From frames to a dataset file."""

    flow: str = option("dis", "optical flow backend, a name of kt3dmoseg.flow.list()", metavar="NAME")
    fraction: float = option(0.1, "share of the background that is drawn for evaluation", low=0, high=1)
    seed: int = option(0, "seed of that draw; each clip draws by its own name", low=0)
    smallest: int = option(
        1, "moving objects with fewer trajectories are not evaluated (the 2018 release: 16)", low=1
    )
    colour: Literal["refuse", "luma"] = option("refuse", "colour frames: refuse them, or take their luma")


@dataclass(frozen=True)
class Settings:
    """Everything that a clip depends on apart from its sources."""

    build: BuildOptions = field(default_factory=BuildOptions)
    tracks: TrackOptions = field(default_factory=TrackOptions)
    flow_parameters: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, options: dict[str, Any], flow_parameters: dict[str, Any] | None = None) -> Settings:
        """Sort keywords into the two groups of options; a misspelt one is an `UnknownNameError`."""
        own, tracker = option_names(BuildOptions), option_names(TrackOptions)
        for name in options:
            if name not in (*own, *tracker):
                raise unknown_name("option", name, [*own, *tracker])
        return cls(
            from_mapping(BuildOptions, {k: v for k, v in options.items() if k in own}),
            from_mapping(TrackOptions, {k: v for k, v in options.items() if k in tracker}),
            dict(flow_parameters or {}),
        )

    def as_dict(self) -> dict[str, Any]:
        """All options by name, for the provenance."""
        return asdict(self.build) | asdict(self.tracks)
