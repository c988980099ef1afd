"""The complete workflow on synthetic drives: render, annotate, build, segment, validate, score, report.

Every step calls the public function behind a command, on files that a person would have, and names that
command. Nothing is downloaded.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from kt3dmoseg.errors import InputFileError, InvalidValueError
from kt3dmoseg.options import option

if TYPE_CHECKING:
    from kt3dmoseg.annotate import Annotation, KeyFrame
    from kt3dmoseg.synthetic import Scene

_DRIVES = 2
_MARKER = ".kt3dmoseg-demo"
_KEY_EVERY = 3  # frames between key frames
_LEAST_AREA = 24.0  # pixels; a smaller piece of an object is not outlined


@dataclass(frozen=True)
class DemoOptions:
    """What the demo makes."""

    seed: int = option(0, "seed of the drives and of the methods", low=0)
    width: int = option(828, "image width in pixels", low=64, high=4096)
    height: int = option(250, "image height in pixels", low=32, high=4096)
    frames: int = option(12, "frames per drive", low=6, high=200)
    methods: tuple[str, ...] = option(("one_motion", "keradd", "subset"), "names of mseg.methods.list()")
    runs: int = option(2, "runs per method, with different seeds", low=1, high=100)


def run_demo(
    output: str | os.PathLike[str] = "demo-out",
    options: DemoOptions | None = None,
    *,
    report: Callable[[str], None] = print,
) -> dict[str, Path]:
    """Run the complete workflow, from frames to a report; see `DemoOptions`.

    The folder `output` holds everything: absent, empty, or that of a former demo, which is replaced; anything
    else is an InputFileError. `report` is called with every line of progress. Returns the report of every
    method; InvalidValueError or UnknownNameError for no method, or an unknown one.
    """
    from mseg import methods

    demo, started = _Demo(Path(output), options or DemoOptions(), report), time.perf_counter()
    if not demo.options.methods:
        raise InvalidValueError("methods", expected="at least one name", found="none")
    for name in demo.options.methods:
        methods.create(name)
    _claim(demo.folder)
    demo.render()
    demo.build()
    submissions = demo.segment()
    demo.evaluate(submissions)
    reports = demo.write_reports(submissions)
    report(f"\nDone in {time.perf_counter() - started:.0f} s. Open a report in a browser, for instance:")
    report(f"  {reports[demo.options.methods[-1]].resolve()}")
    report(f"What is in a clip:  kt3dmoseg info {demo.dataset}")
    return reports


def _claim(folder: Path) -> None:
    """Make sure that nothing but a former demo is replaced."""
    from kt3dmoseg.files import write_text

    if folder.exists() and not (folder / _MARKER).exists():
        found = "a file" if not folder.is_dir() else "other files" if any(folder.iterdir()) else ""
        if found:
            expected = "an empty folder, or a former demo's"
            raise InputFileError(f"{folder}", expected=expected, found=found, fix="choose another")
    write_text(folder / _MARKER, "kt3dmoseg demo replaces what is in this folder\n")
    for name in ("kitti", "submissions", "frames"):
        shutil.rmtree(folder / name, ignore_errors=True)


class _Demo:
    """The steps, and the folders that they share."""

    def __init__(self, folder: Path, options: DemoOptions, report: Callable[[str], None]) -> None:
        self.folder, self.options, self.report, self.steps = folder, options, report, 0
        self.kitti, self.annotations = folder / "kitti", folder / "annotations"
        self.dataset = folder / "dataset"

    def step(self, title: str, command: str) -> None:
        """Announce a step: what it does, and the command that does it on real data."""
        self.steps += 1
        self.report(f"\n[{self.steps}/7] {title}\n      $ {command}")

    def result(self, line: str) -> None:
        self.report(f"      {line}")

    def render(self) -> None:
        from kt3dmoseg.annotate import save_annotation
        from kt3dmoseg.synthetic import SceneOptions, make_scene, write_drive

        self.step(
            f"Render {_DRIVES} synthetic drives in the layout of KITTI raw",
            "kt3dmoseg pull --accept-license          (real frames, from KITTI)",
        )
        scenes, chosen = {}, self.options
        size = {"width": chosen.width, "height": chosen.height, "frames": chosen.frames}
        for number in range(_DRIVES):
            seed = chosen.seed * _DRIVES + number
            scene = make_scene(SceneOptions(**size, objects=2 + number % 2, seed=seed))
            folder = write_drive(scene, self.kitti, drive=number + 1)
            vehicles = ", ".join(v.name for v in scene.vehicles)
            self.result(f"{folder.relative_to(self.folder)}: {scene.n_frames} frames; moving: {vehicles}")
            scenes[folder.name.removesuffix("_sync")] = scene
        self.step(
            "Outline the moving vehicles on every third frame (here: the scene's exact outlines)",
            "kt3dmoseg label FRAMES                   (a page in the browser)",
        )
        for name, scene in scenes.items():
            path = self.annotations / f"{name}.json"
            save_annotation(path, annotation_of(scene, name))
            self.result(f"{path.relative_to(self.folder)}: {len(scene.vehicles)} objects")

    def build(self) -> None:
        from kt3dmoseg.pipeline import build_dataset

        self.step(
            "Track points through the frames, label the trajectories, write the dataset",
            f"kt3dmoseg build {self.kitti} --annotations {self.annotations} -o {self.dataset}",
        )
        for outcome in build_dataset(self.kitti, self.dataset, annotations=self.annotations, workers=1):
            if outcome.status == "failed":
                raise InputFileError(f"{outcome.path}: {outcome.reason}")
            counts = ", ".join(f"{count} {what}" for what, count in outcome.counts.items())
            self.result(f"{outcome.path.relative_to(self.folder)}: {counts or outcome.status}")

    def segment(self) -> dict[str, Path]:
        from mseg.benchmark import predict

        runs, folder, written = self.options.runs, self.folder / "submissions", {}
        self.step(
            "Segment the trajectories by their motion; the predictions of a method are a submission",
            f"mseg run {self.dataset} --method METHOD --seeds {runs} -o {folder / 'METHOD'}",
        )
        seeds = range(self.options.seed, self.options.seed + runs)
        for method in self.options.methods:
            begin = time.perf_counter()
            written[method] = predict(self.dataset, folder / method, method, seeds=seeds)
            self.result(f"{method}: {runs} runs in {time.perf_counter() - begin:.1f} s")
        return written

    def evaluate(self, submissions: dict[str, Path]) -> None:
        from mseg.evaluation import score_submission, validate_submission
        from mseg.evaluation.comparison import compare, comparison_table

        self.step("Check the submissions", f"mseg validate SUBMISSION {self.dataset}")
        for method, folder in submissions.items():
            self.result(f"{method}: {str(validate_submission(folder, self.dataset)).splitlines()[0]}")
        self.step(
            "Score and compare them",
            f"mseg score SUBMISSION {self.dataset}; mseg compare SUBMISSION SUBMISSION {self.dataset}",
        )
        tables = [score_submission(folder, self.dataset) for folder in submissions.values()]
        if len(tables) == 1:
            self.result(f"mean error {100 * tables[0].per_clip().mean():.2f} %")
            return
        found = compare(tables)
        for line in [*comparison_table(found).text().splitlines(), *(p.sentence for p in found.pairs)]:
            self.result(line)

    def write_reports(self, submissions: dict[str, Path]) -> dict[str, Path]:
        from mseg.evaluation.report import write_report

        frames, reports = self.folder / "frames", {}
        self.step(
            "Write a report per method: tables, bars, trajectories on the frames",
            f"mseg report SUBMISSION {self.dataset} --frames {frames} -o report.html",
        )
        for drive in sorted(self.kitti.glob("*/*_sync")):
            shutil.copytree(drive / "image_00" / "data", frames / drive.name.removesuffix("_sync"))
        for method, folder in submissions.items():
            reports[method] = self.folder / f"report-{method}.html"
            write_report(folder, self.dataset, reports[method], frames=frames)
            self.result(str(reports[method]))
        return reports


def annotation_of(scene: Scene, clip: str) -> Annotation:
    """Annotate a scene with the exact outlines of its vehicles, on every third frame."""
    from kt3dmoseg.annotate import AnnotatedObject, Annotation

    keys = sorted({*range(0, scene.n_frames, _KEY_EVERY), scene.n_frames - 1})
    objects = []
    for number, vehicle in enumerate(scene.vehicles, start=1):
        frames = tuple(outline(scene, number + 1, frame) for frame in keys)
        objects.append(AnnotatedObject(number, vehicle.name, vehicle.kind, number, frames))
    return Annotation(clip, scene.image_size, scene.n_frames, tuple(objects), annotator="demo")


def outline(scene: Scene, body: int, frame: int) -> KeyFrame:
    """Outline a vehicle (its id in ``scene.ids``) as a person would: visible pieces, or hidden, or gone."""
    import cv2
    import numpy as np

    from kt3dmoseg.annotate import KeyFrame

    mask = (scene.ids(frame) == body).astype(np.uint8)
    found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    pieces = [cv2.approxPolyDP(c, 0.7, closed=True)[:, 0] for c in found if cv2.contourArea(c) >= _LEAST_AREA]
    if not pieces:
        return KeyFrame(frame, "occluded" if mask.any() else "outside")
    return KeyFrame(frame, "visible", tuple(tuple((float(x), float(y)) for x, y in p) for p in pieces))
