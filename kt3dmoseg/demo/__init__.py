"""The whole way on synthetic drives: render, annotate, build, segment, validate, score, report.

Every step calls the public function that a person's command calls, on files that a person would have,
and says which command that is. Nothing is downloaded.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from kt3dmoseg.errors import InputFileError, InvalidValueError
from kt3dmoseg.options import option

if TYPE_CHECKING:
    from kt3dmoseg.synthetic import Scene
    from kt3dmoseg.types import Clip

_DRIVES = 2
_MARKER = ".kt3dmoseg-demo"
_AFTER = 5  # frames after which tracks are compared with the truth
_TRUE = 2.0  # pixels; a track that ends nearer to the truth has stayed on its point


@dataclass(frozen=True)
class DemoOptions:
    """What the demo makes."""

    seed: int = option(0, "seed of the drives and of the methods", low=0)
    width: int = option(828, "image width in pixels", low=64, high=4096)
    height: int = option(250, "image height in pixels", low=32, high=4096)
    frames: int = option(12, "frames per drive", low=6, high=200)
    methods: tuple[str, ...] = option(("one_motion", "keradd", "subset"), "names of mseg.methods.list()")
    runs: int = option(2, "runs per method, with different seeds", low=1, high=100)


@dataclass
class Demo:
    """Folders of one demo, and the story it tells while it runs.

    Parameters
    ----------
    folder : Path
        Where everything is written.
    options : DemoOptions
        What was chosen.
    tell : callable
        Called with every line of the story.
    """

    folder: Path
    options: DemoOptions
    tell: Callable[[str], None]
    steps: int = 0
    started: float = field(default_factory=time.perf_counter)

    def step(self, title: str, command: str) -> None:
        """Begin a step: what it does, and the command that does it on real data."""
        self.steps += 1
        self.tell(f"\n[{self.steps}/7] {title}")
        self.tell(f"      $ {command}")

    def say(self, line: str) -> None:
        """Report a result."""
        self.tell(f"      {line}")


def run_demo(
    output: str | os.PathLike[str] = "demo-out",
    options: DemoOptions | None = None,
    *,
    tell: Callable[[str], None] = print,
) -> dict[str, Path]:
    """Go the whole way from frames to a report.

    Parameters
    ----------
    output : path
        Folder for everything: absent, empty, or that of a former demo, which is replaced.
    options : DemoOptions, optional
        Seed, size, methods.
    tell : callable
        Takes the story, line by line.

    Returns
    -------
    dict of str to Path
        Method -> its report.

    Raises
    ------
    InputFileError
        When the folder cannot be written or holds something else.
    InvalidValueError, UnknownNameError
        For no method, or an unknown one.
    """
    from mseg import methods

    demo = Demo(Path(output), options or DemoOptions(), tell)
    if not demo.options.methods:
        raise InvalidValueError("methods", expected="at least one name", found="none")
    for name in demo.options.methods:
        methods.create(name)
    _claim(demo.folder)
    scenes = _render(demo)
    _annotate(demo, scenes)
    _build(demo, scenes)
    submissions = _segment(demo)
    _validate(demo, submissions)
    _score(demo, submissions)
    return _report(demo, submissions)


def _render(demo: Demo) -> dict[str, Scene]:
    from kt3dmoseg.synthetic import SceneOptions, make_scene, write_drive

    chosen = demo.options
    demo.step(
        f"Render {_DRIVES} synthetic drives in the layout of KITTI raw",
        "kt3dmoseg pull --accept-license          (real frames, from KITTI)",
    )
    root, scenes = _emptied(demo.folder / "kitti"), {}
    for number in range(_DRIVES):
        scene = make_scene(
            SceneOptions(
                width=chosen.width,
                height=chosen.height,
                frames=chosen.frames,
                objects=2 + number % 2,
                seed=chosen.seed * _DRIVES + number,
            )
        )
        folder = write_drive(scene, root, drive=number + 1)
        vehicles = ", ".join(v.name for v in scene.vehicles)
        demo.say(f"{folder.relative_to(demo.folder)}: {scene.n_frames} frames; moving: {vehicles}")
        scenes[folder.name.removesuffix("_sync")] = scene
    return scenes


def _annotate(demo: Demo, scenes: dict[str, Scene]) -> None:
    from kt3dmoseg.annotate import save_annotation
    from kt3dmoseg.demo.outlines import annotation_of

    demo.step(
        "Outline the moving vehicles on every third frame (here from the scene's own knowledge)",
        "kt3dmoseg label FRAMES                   (a page in the browser)",
    )
    for name, scene in scenes.items():
        path = demo.folder / "annotations" / f"{name}.json"
        save_annotation(path, annotation_of(scene, name))
        demo.say(f"{path.relative_to(demo.folder)}: {len(scene.vehicles)} objects")


def _build(demo: Demo, scenes: dict[str, Scene]) -> None:
    from kt3dmoseg.io import load
    from kt3dmoseg.pipeline import build_dataset, find_sources

    kitti, dataset = demo.folder / "kitti", demo.folder / "dataset"
    demo.step(
        "Track points through the frames, label the trajectories, write the dataset",
        f"kt3dmoseg build --frames {kitti} --annotations {demo.folder / 'annotations'} -o {dataset}",
    )
    sources, annotations = find_sources(kitti), demo.folder / "annotations"
    for outcome in build_dataset(sources, dataset, annotations=annotations, workers=1):
        if outcome.status == "failed":
            raise InputFileError(f"{outcome.path}: {outcome.reason}")
        counts = ", ".join(f"{count} {what}" for what, count in outcome.counts.items())
        demo.say(f"{outcome.path.relative_to(demo.folder)}: {counts or outcome.status}")
    for name, scene in scenes.items():
        _check_against_truth(demo, load(dataset / f"{name}.h5"), scene)


def _check_against_truth(demo: Demo, clip: Clip, scene: Scene) -> None:
    """Say what only a synthetic scene can tell: how wrong the tracks and the labels are."""
    import numpy as np

    from kt3dmoseg.synthetic import track_errors

    errors = track_errors(scene, clip.dense, _AFTER)
    middle, most = np.nanpercentile(errors, [50, 90])
    demo.say(
        f"{clip.name}: {_AFTER} frames after their start tracks are off by {middle:.2f} px (median), "
        f"{most:.1f} px (90th percentile)"
    )
    tracks = clip.evaluated_trajectories
    true = track_errors(scene, tracks) < _TRUE
    start = tracks.visible.argmax(axis=1)
    seeds = np.column_stack([tracks.xy[np.arange(len(tracks)), start], start])
    right = scene.labels(seeds).label == clip.labels.label
    demo.say(
        f"{clip.name}: {100 * right[true].mean():.1f} % of the labels are right "
        f"({true.sum()} tracks that stay on their point)"
    )


def _segment(demo: Demo) -> dict[str, Path]:
    from mseg.benchmark import predict

    dataset, runs = demo.folder / "dataset", demo.options.runs
    demo.step(
        "Segment the trajectories by their motion; the predictions of a method are a submission",
        f"mseg run {dataset} --method METHOD --seeds {runs} -o {demo.folder / 'submissions' / 'METHOD'}",
    )
    submissions = {}
    seeds = range(demo.options.seed, demo.options.seed + runs)
    for method in demo.options.methods:
        begin = time.perf_counter()
        folder = predict(dataset, _emptied(demo.folder / "submissions" / method), method, seeds=seeds)
        demo.say(f"{method}: {runs} runs in {time.perf_counter() - begin:.1f} s")
        submissions[method] = folder
    return submissions


def _validate(demo: Demo, submissions: dict[str, Path]) -> None:
    from mseg.evaluation import validate_submission

    demo.step("Check the submissions", f"mseg validate SUBMISSION {demo.folder / 'dataset'}")
    for method, folder in submissions.items():
        checked = validate_submission(folder, demo.folder / "dataset")
        demo.say(f"{method}: {str(checked).splitlines()[0]}")


def _score(demo: Demo, submissions: dict[str, Path]) -> None:
    from mseg.evaluation import score_submission
    from mseg.evaluation.comparison import compare, comparison_table

    dataset = demo.folder / "dataset"
    demo.step(
        "Score and compare them",
        f"mseg score SUBMISSION {dataset}; mseg compare SUBMISSION SUBMISSION {dataset}",
    )
    tables = [score_submission(folder, dataset) for folder in submissions.values()]
    if len(tables) > 1:
        found = compare(tables)
        for line in [*comparison_table(found).text().splitlines(), *(p.sentence for p in found.pairs)]:
            demo.say(line)
    else:
        demo.say(f"mean error {100 * tables[0].per_clip().mean():.2f} %")


def _report(demo: Demo, submissions: dict[str, Path]) -> dict[str, Path]:
    from mseg.evaluation.report import write_report

    dataset, frames = demo.folder / "dataset", _emptied(demo.folder / "frames")
    demo.step(
        "Write a report per method: tables, bars, trajectories on the frames",
        f"mseg report SUBMISSION {dataset} --frames {frames} -o report.html",
    )
    for drive in sorted((demo.folder / "kitti").glob("*/*_sync")):
        shutil.copytree(drive / "image_00" / "data", frames / drive.name.removesuffix("_sync"))
    reports = {}
    for method, folder in submissions.items():
        reports[method] = demo.folder / f"report-{method}.html"
        write_report(folder, dataset, reports[method], frames=frames)
        demo.say(str(reports[method]))
    demo.tell(
        f"\nDone in {time.perf_counter() - demo.started:.0f} s. Open a report in a browser, for instance:"
    )
    demo.tell(f"  {reports[demo.options.methods[-1]].resolve()}")
    demo.tell(f"What is in a clip:  kt3dmoseg info {dataset}")
    return reports


def _claim(folder: Path) -> None:
    """Make sure that nothing but a former demo is replaced."""
    from kt3dmoseg.files import write_text

    if folder.exists() and not folder.is_dir():
        raise InputFileError(f"{folder}", expected="a folder", found="a file", fix="choose another")
    if folder.exists() and not (folder / _MARKER).exists() and any(folder.iterdir()):
        raise InputFileError(
            f"{folder}",
            expected="an empty folder, or a former demo's",
            found="other files",
            fix="choose another",
        )
    write_text(folder / _MARKER, "kt3dmoseg demo replaces what is in this folder\n")


def _emptied(folder: Path) -> Path:
    if folder.exists():
        shutil.rmtree(folder)
    folder.mkdir(parents=True)
    return folder
