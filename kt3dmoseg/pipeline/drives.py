"""Synthetic drives as clips: rendered, tracked like real frames, labelled by the exact scene."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from kt3dmoseg import synthetic
from kt3dmoseg.files import PathLike
from kt3dmoseg.frames import FrameInfo
from kt3dmoseg.synthetic import DrivePlan, Scene, make_drive, measure_drive, plan_drives
from kt3dmoseg.synthetic.drives import SAMPLES, Part
from kt3dmoseg.synthetic.scene import BACKGROUND
from kt3dmoseg.types import ByteArray, Labels, Trajectories

if TYPE_CHECKING:
    from kt3dmoseg.io.images import Colour
    from kt3dmoseg.pipeline.dataset import Outcome

SMALLEST = 8  # trajectories; a vehicle with fewer is no motion of the benchmark
_ON_IT = 0.75  # share of a trajectory's frames that must lie on one object


@dataclass(frozen=True)
class SyntheticDrive:
    """A drive of the synthetic benchmark as a source of frames that knows its labels."""

    plan: DrivePlan

    @property
    def name(self) -> str:
        """Name of the clip."""
        return self.plan.name

    @property
    def where(self) -> str:
        """What messages call it."""
        return f"synthetic drive {self.name}"

    @cached_property
    def scene(self) -> Scene:
        """The scene, made on first use."""
        return make_drive(self.plan)

    def inspect(self) -> FrameInfo:
        """Describe the drive: what its bytes depend on."""
        versions = {"samples": SAMPLES, "version": synthetic.ALGORITHM_VERSION}
        return FrameInfo(None, {"kind": "synthetic"} | asdict(self.plan) | versions)

    def numbers(self) -> range:
        """Numbers of the frames."""
        return range(self.scene.n_frames)

    def frames(self, colour: Colour) -> Iterator[ByteArray]:
        """Render the frames."""
        del colour
        return map(self.scene.frame, range(self.scene.n_frames))

    def label(self, tracks: Trajectories) -> Labels:
        """Label trajectories by what is exactly below them.

        That is the object under three quarters of its points, 1 = static scene and sky, 2, 3, ... = the
        vehicles. A trajectory that slides from one object onto another has label 0.
        """
        votes = np.zeros((len(tracks), 2 + len(self.scene.vehicles)))
        last = np.array(self.scene.image_size) - 1
        for frame in range(tracks.n_frames):
            rows, xy = tracks.at(frame)
            x, y = np.rint(xy).astype(np.int64).clip(0, last).T
            votes[rows, np.maximum(self.scene.ids(frame)[y, x], BACKGROUND)] += 1
        label = np.where(votes.max(axis=1) >= _ON_IT * tracks.lengths, votes.argmax(axis=1), 0)
        return Labels(label, BACKGROUND, self.scene.names)

    def measure(self) -> Mapping[str, Any]:
        """Measure what makes it hard: the plan's camera, and what `measure_drive` finds."""
        return {"camera": self.plan.camera} | dict(measure_drive(self.scene))


def build_synthetic(
    output: PathLike,
    *,
    part: Part | None = None,
    seed: int = 0,
    first: int | None = None,
    **options: Any,  # noqa: ANN401
) -> list[Outcome]:
    """Make the synthetic benchmark: render, track and label its drives, one clip file each.

    Drives that are there already are left alone; an interrupted run is finished by the same call. `part` is
    "public" or "test", for only this half; `seed` 0 is the benchmark, others give other drives, under other
    names; `first` takes only so many drives of each half. `options`, result and errors are those of
    `build_dataset`, without annotations and masks.
    """
    from kt3dmoseg.pipeline.dataset import build_dataset

    plans = [p for p in plan_drives(seed) if part in (None, p.part) and (first is None or p.number <= first)]
    return build_dataset([SyntheticDrive(plan) for plan in plans], output, **{"smallest": SMALLEST} | options)
