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

import cv2
import numpy as np

from kt3dmoseg.annotate import AnnotatedObject, Annotation, KeyFrame, save_annotation
from kt3dmoseg.annotate.model import Polygon
from kt3dmoseg.build import build_dataset, find_sources
from kt3dmoseg.errors import InputFileError
from kt3dmoseg.io import load_dataset
from kt3dmoseg.options import option
from kt3dmoseg.synthetic import Scene, SceneOptions, make_scene, write_drive
from kt3dmoseg.types import ByteArray, Clip, FloatArray, Trajectories

_DRIVES = 2
_KEY_EVERY = 3  # frames between key frames of the annotation
_LEAST_AREA = 24.0  # pixels; a smaller piece of an object is not outlined
_VERSION = "synthetic"
_AFTER = 5  # frames after which tracks are compared with the truth
_BASELINES = ("one_motion", "prevalence")


@dataclass(frozen=True)
class DemoOptions:
    """Options of the demo."""

    seed: int = option(0, "seed of the drives and of the methods", low=0)
    width: int = option(828, "image width in pixels", low=64, high=4096)
    height: int = option(250, "image height in pixels", low=32, high=4096)
    frames: int = option(12, "frames per drive", low=6, high=200)
    methods: tuple[str, ...] = option(
        ("one_motion", "keradd", "subset"), "names of mseg.methods.list(), separated by commas"
    )
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
        Folder for everything; a former demo in it is replaced.
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
        When the folder cannot be written.
    UnknownNameError
        For an unknown method.
    """
    from mseg import methods

    demo = Demo(Path(output), options or DemoOptions(), tell)
    for name in demo.options.methods:
        methods.create(name)
    scenes = _render(demo)
    _annotate(demo, scenes)
    clips = _build(demo, scenes)
    submissions = _segment(demo, clips)
    _validate(demo, submissions)
    _score(demo, submissions)
    return _report(demo, submissions)


def outline(scene: Scene, body: int, frame: int) -> KeyFrame:
    """Outline a vehicle in one frame, as a person would: the visible pieces, or hidden, or gone.

    Parameters
    ----------
    scene : Scene
        The scene.
    body : int
        Id of the vehicle in ``scene.ids``.
    frame : int
        Frame.
    """
    mask: ByteArray = (scene.ids(frame) == body).astype(np.uint8)
    found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    pieces = [cv2.approxPolyDP(c, 0.7, closed=True)[:, 0] for c in found if cv2.contourArea(c) >= _LEAST_AREA]
    polygons: tuple[Polygon, ...] = tuple(tuple((float(x), float(y)) for x, y in p) for p in pieces)
    if polygons:
        return KeyFrame(frame, "visible", polygons)
    return KeyFrame(frame, "occluded" if mask.any() else "outside")


def annotation_of(scene: Scene, clip: str) -> Annotation:
    """Annotate a scene from its own knowledge of the vehicles' outlines, on every third frame."""
    last = scene.n_frames - 1
    keys = sorted({*range(0, scene.n_frames, _KEY_EVERY), last})
    objects = []
    for number, vehicle in enumerate(scene.vehicles, start=1):
        frames = tuple(outline(scene, number + 1, frame) for frame in keys)
        objects.append(AnnotatedObject(number, vehicle.name, vehicle.kind, number, frames))
    return Annotation(clip, scene.image_size, scene.n_frames, tuple(objects), annotator="demo")


def track_errors(scene: Scene, tracks: Trajectories, after: int) -> FloatArray:
    """Distances in pixels between trajectories and the truth, `after` frames behind their starts.

    Only trajectories that live that long and whose true point is still seen then.
    """
    start = tracks.visible.argmax(axis=1)
    rows = np.flatnonzero(tracks.visible.any(axis=1) & (start + after < tracks.n_frames))
    rows = rows[tracks.visible[rows, start[rows] + after]]
    seeds = np.column_stack([tracks.xy[rows, start[rows]], start[rows]])
    truth = scene.trajectories(seeds)
    end = start[rows] + after
    seen = truth.visible[np.arange(len(rows)), end]
    apart = truth.xy[seen, end[seen]] - tracks.xy[rows[seen], end[seen]]
    return np.asarray(np.linalg.norm(apart, axis=1))


def _render(demo: Demo) -> dict[str, Scene]:
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
    demo.step(
        "Outline the moving vehicles on every third frame (here from the scene's own knowledge)",
        "kt3dmoseg label FRAMES                   (a page in the browser)",
    )
    for name, scene in scenes.items():
        path = demo.folder / "annotations" / f"{name}.json"
        save_annotation(path, annotation_of(scene, name))
        demo.say(f"{path.relative_to(demo.folder)}: {len(scene.vehicles)} objects")


def _build(demo: Demo, scenes: dict[str, Scene]) -> list[Clip]:
    kitti, dataset = demo.folder / "kitti", demo.folder / "dataset"
    demo.step(
        "Track points through the frames, label the trajectories, write the dataset",
        f"kt3dmoseg build --frames {kitti} --annotations {demo.folder / 'annotations'} -o {dataset}",
    )
    for outcome in build_dataset(find_sources(kitti), dataset, annotations=demo.folder / "annotations"):
        if outcome.status == "failed":
            raise InputFileError(f"{outcome.path}: {outcome.reason}")
        counts = ", ".join(f"{count} {what}" for what, count in outcome.counts.items())
        demo.say(f"{outcome.path.relative_to(demo.folder)}: {counts or outcome.status}")
    clips = [clip for name, clip in load_dataset(dataset).items() if name in scenes]
    for clip in clips:
        _check_against_truth(demo, clip, scenes[clip.name])
    return clips


def _check_against_truth(demo: Demo, clip: Clip, scene: Scene) -> None:
    """Say what only a synthetic scene can tell: how wrong the tracks and the labels are."""
    errors = track_errors(scene, clip.dense, _AFTER)
    demo.say(
        f"{clip.name}: after {_AFTER} frames tracks are off by {np.median(errors):.2f} px (median), "
        f"{np.percentile(errors, 95):.2f} px (95th percentile)"
    )
    tracks = clip.evaluated_trajectories
    start = tracks.visible.argmax(axis=1)
    seeds = np.column_stack([tracks.xy[np.arange(len(tracks)), start], start])
    right = scene.labels(seeds).label == clip.labels.label
    demo.say(f"{clip.name}: {100 * right.mean():.1f} % of the labels are those of the object at its start")


def _segment(demo: Demo, clips: list[Clip]) -> dict[str, Path]:
    from mseg import segment
    from mseg.errors import SegmentationError
    from mseg.evaluation import SubmissionMeta, fingerprint, write_failure, write_meta, write_prediction

    demo.step(
        "Segment the trajectories by their motion, and write the predictions as submissions",
        f"mseg run --method {demo.options.methods[-1]} {demo.folder / 'dataset'} -o SUBMISSION",
    )
    submissions = {}
    for method in demo.options.methods:
        folder = _emptied(demo.folder / "submissions" / method)
        begin = time.perf_counter()
        for run in range(demo.options.runs):
            seed = demo.options.seed + run
            for clip in clips:
                try:
                    found = segment(clip, method, n_motions=clip.n_motions, seed=seed)
                    write_prediction(folder, clip, found.labels, seed=seed)
                except SegmentationError as error:
                    write_failure(folder, clip, str(error), seed=seed)
        seconds = (time.perf_counter() - begin) / demo.options.runs
        prints = {clip.name: fingerprint(clip) for clip in clips}
        meta = SubmissionMeta(
            method,
            authors=("the demo",),
            dataset_version=_VERSION,
            seconds=round(seconds, 3),
            baseline=method in _BASELINES,
            fingerprints=prints,
        )
        write_meta(folder, meta)
        demo.say(f"{folder.relative_to(demo.folder)}: {demo.options.runs} runs, {seconds:.1f} s each")
        submissions[method] = folder
    return submissions


def _validate(demo: Demo, submissions: dict[str, Path]) -> None:
    from mseg.evaluation import validate_submission

    dataset = demo.folder / "dataset"
    demo.step("Check the submissions", f"mseg validate SUBMISSION {dataset}")
    for method, folder in submissions.items():
        demo.say(f"{method}: {validate_submission(folder, dataset)}")


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
        reports[method] = write_report(folder, dataset, demo.folder / f"report-{method}.html", frames=frames)[
            0
        ]
        demo.say(str(reports[method]))
    demo.tell(f"\nDone in {time.perf_counter() - demo.started:.0f} s. Open the reports in a browser.")
    return reports


def _emptied(folder: Path) -> Path:
    if folder.exists():
        shutil.rmtree(folder)
    folder.mkdir(parents=True)
    return folder
