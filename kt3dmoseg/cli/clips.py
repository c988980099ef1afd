"""Commands that make clips from frames, and that look at clips."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from functools import partial
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

from kt3dmoseg import app
from kt3dmoseg.app import (
    Catalogs,
    Dask,
    Either,
    File,
    Flag,
    Folder,
    Json,
    Name,
    Parameters,
    Positive,
    Range,
    Size,
    Whole,
    flags,
    progress_bar,
)
from kt3dmoseg.choosing import ChooseOptions
from kt3dmoseg.demo import DemoOptions
from kt3dmoseg.options import from_mapping, parse_assignments
from kt3dmoseg.pipeline import BuildOptions
from kt3dmoseg.publishing import PublishOptions
from kt3dmoseg.text import text_table
from kt3dmoseg.tracking import TrackOptions

if TYPE_CHECKING:
    from kt3dmoseg.pipeline import Outcome

_ANNOTATIONS = Path("annotations")
_FAILED = 2

FlowParameters = Annotated[Parameters, Parameter(help="Parameter of the flow or tracker; may be repeated.")]
FlowCache = Annotated[Folder | None, Parameter(help="Keep and reuse flow fields here.")]
Workers = Annotated[Whole | None, Parameter(help="Processes (default: one per core).")]
Names = Annotated[list[str], Parameter(metavar="NAME", consume_multiple=(1, None))]
_one_clip = partial(Parameter, group=Group.create_ordered("One drive of a KITTI raw root"))
_part = partial(Parameter, group=Group.create_ordered("A part of the frames"))


@flags(DemoOptions)
def demo(
    *,
    output: Annotated[Folder, Parameter(alias="-o", help="Folder for everything.")] = Path("demo-out"),
    methods: Annotated[
        Names | None, Parameter(help="Names of mseg.methods.list() (default: one_motion keradd subset).")
    ] = None,
    **options: Any,  # noqa: ANN401
) -> None:
    """Run the workflow on synthetic drives: render, annotate, build, segment, validate, score, report.

    Takes about a minute; nothing is downloaded. Every step names the command that does it on
    real data.
    """
    from kt3dmoseg.demo import run_demo

    if methods is not None:  # words, with or without commas
        options["methods"] = " ".join(methods).replace(",", " ").split()
    run_demo(output, from_mapping(DemoOptions, options), report=lambda line: print(line, flush=True))


@flags(BuildOptions, TrackOptions)
def build(
    frames: Annotated[Either, Parameter(help="Clips, one clip, a video or a KITTI raw root.")],
    *,
    output: Annotated[Folder, Parameter(alias="-o", help="Folder of the files CLIP.h5.")],
    annotations: Annotated[
        Folder | None,
        Parameter(
            help="Labels: FOLDER/CLIP.json (default: ./annotations when it exists; 'none' for no labels)."
        ),
    ] = None,
    masks: Annotated[
        Folder | None, Parameter(help="Labels: FOLDER/CLIP/*.png, DAVIS indexed or KITTI MOTS.")
    ] = None,
    shift: Annotated[Whole | None, Parameter(help="Add this to the frame numbers of masks.")] = None,
    propose: Annotated[
        Flag, Parameter(help="Write proposals for unlabelled clips, which 'kt3dmoseg label' shows.")
    ] = False,
    tracks: Annotated[
        Either | None,
        Parameter(help="Trajectories of another tracker, PATH/CLIP.npz and others, instead of tracking."),
    ] = None,
    workers: Workers = None,
    dask: Dask = "",
    force: Annotated[Flag, Parameter(help="Build also what is up to date.")] = False,
    parameter: FlowParameters = (),
    cache: FlowCache = None,
    catalogs: Catalogs = (),
    date: Annotated[str | None, _one_clip(help="Day of the drive, 2011_09_26.")] = None,
    drive: Annotated[str | None, _one_clip(help="Number of the drive, 5 or 0005.")] = None,
    camera: Annotated[Whole, _one_clip(help="0, 1 gray; 2, 3 colour.")] = 0,
    range_: Annotated[Range | None, _part(help="Frame numbers, both included; a video's from 0.")] = None,
    step: Annotated[Positive, _part(help="Take every N-th frame.")] = 1,
    size: Annotated[Size, _part(help="Resize the frames.")] = "",
    name: Annotated[
        Name, _part(help="Name of the clip (default: drive and range; of others their name and range).")
    ] = "",
    **options: Any,  # noqa: ANN401
) -> int:
    """Frames to dataset files: track, label, subsample; one HDF5 file per clip.

    FRAMES is a folder with one folder of frames per clip, the frames of one clip, a video file, or a
    KITTI raw root: the clips that pull or locate noted in its located.toml, else one clip per drive, or one
    of your choice with --date, --drive, --camera and --range. Clips whose file is up to date are skipped; an
    interrupted build is finished by the same command. Exit code 2 when a clip failed, after the others are
    built.
    """
    from kt3dmoseg.frames import FrameFolder, choose_sources
    from kt3dmoseg.io.images import numbered_pictures
    from kt3dmoseg.pipeline import build_dataset

    where: dict[str, Any] = {"date": date, "drive": drive, "camera": camera, "catalogs": catalogs}
    sources = choose_sources(frames, **where, frames=range_, step=step, size=size, name=name)
    # An earlier build may have put its output among the frames.
    inside = [s for s in sources if isinstance(s, FrameFolder) and s.folder.resolve() == output.resolve()]
    built = [source for source in inside if not numbered_pictures(source.folder)]
    sources = [source for source in sources if source not in built]
    names = {source.name.lower() for source in sources}  # one of another case is refused, not passed over
    folder = _ANNOTATIONS if annotations in (None, Path("none")) else annotations
    if annotations is None or propose:  # proposals also go where there is no annotation yet
        there = any(path.stem.lower() in names for path in folder.glob("*.json"))
        annotations = folder if there and annotations != Path("none") else None
    annotations = None if annotations == Path("none") else annotations
    options |= {"masks": masks, "cache": cache, "tracks": tracks, "shift": shift, "workers": workers}
    options |= {"propose": folder if propose else None, "flow_parameters": parse_assignments(parameter)}
    make = partial(build_dataset, sources, output, annotations=annotations, dask=dask, force=force)
    outcomes = _run(partial(make, **options), len(sources), output)
    empty = [o for o in outcomes if o.status == "built" and not o.counts["trajectories"]]
    if empty:
        shown = ", ".join(f"{outcome.name} ({outcome.counts['frames']} frames)" for outcome in empty)
        _warn_of_none(shown, options)
    unlabelled = [o.name for o in outcomes if o.status != "failed" and not o.labels]
    if unlabelled and (given := annotations or masks):
        more = " ..." * (len(unlabelled) > 9)
        app.warn(f"nothing in {given} labels {', '.join(unlabelled[:9])}{more}")
    return _code(outcomes)


def _warn_of_none(clips: str, options: Mapping[str, Any]) -> None:
    least = options.get("min_length", TrackOptions.min_length)
    app.warn(
        f"no trajectories in {clips}; a track must live --min-length {least} frames, and starts only "
        "where the picture has structure"
    )


def _run(make: Callable[..., list[Outcome]], total: int, output: Path) -> list[Outcome]:
    """Build clips, with a bar; print each outcome, and how many there were of each kind."""
    from tqdm import tqdm

    done: list[Outcome] = []

    def report(outcome: Outcome) -> None:
        done.append(outcome)
        if outcome.status == "failed":
            tqdm.write(f"kt3dmoseg: {outcome.name} failed: {app.typed(outcome.reason)}", file=sys.stderr)
            return
        for note in outcome.notes:
            tqdm.write(f"kt3dmoseg: warning: {outcome.name}: {note}", file=sys.stderr)
        line = f"{outcome.name}: {outcome.status}" + (f" ({outcome.reason})" if outcome.reason else "")
        numbers = ", ".join(f"{count} {what}" for what, count in outcome.counts.items())
        tqdm.write(f"{line}: {numbers}" if numbers else line)
        sys.stdout.flush()  # a log file shows how far a long build is

    with progress_bar("clip") as show:
        outcomes = make(
            report=report,
            progress=lambda clip, frame, frames: show(len(done), total, f"{clip} {frame}/{frames or '?'}"),
        )
    failed, built = (sum(o.status == status for o in outcomes) for status in ("failed", "built"))
    print(f"{built} built, {len(outcomes) - built - failed} up to date, {failed} failed: {output}")
    return outcomes


def _code(outcomes: list[Outcome]) -> int:
    return _FAILED if any(outcome.status == "failed" for outcome in outcomes) else 0


@flags(ChooseOptions)
def choose(
    *recordings: Annotated[Path, Parameter(help="KITTI raw roots, folders of frames, videos.")],
    output: Annotated[Folder, Parameter(alias="-o", help="Folder for page, table, catalog and measures.")],
    workers: Annotated[Positive, Parameter(help="Processes.")] = 1,
    dask: Dask = "",
    **options: Any,  # noqa: ANN401
) -> None:
    """Find clips in recordings: windows with a camera that moves far, a deep and cluttered scene, and movers.

    Prints the chosen windows, the best first. FOLDER/index.html shows them with pictures, candidates.csv has
    every window, candidates.toml is a catalog for 'kt3dmoseg pull', 'build' and 'label' (--catalog). What is
    measured is kept there: an interrupted run is finished by the same command.
    """
    from kt3dmoseg.choosing import choose
    from kt3dmoseg.choosing.ranking import COLUMNS, row

    with progress_bar("part") as show:
        chosen = choose(recordings, output, workers=workers, dask=dask, progress=show, **options)
    print(text_table(list(map(row, chosen)), list(COLUMNS)))


def synth(
    *,
    output: Annotated[Folder, Parameter(alias="-o", help="Folder of the files CLIP.h5.")],
    part: Annotated[Literal["public", "test"] | None, Parameter(help="Only this half.")] = None,
    first: Annotated[Positive | None, Parameter(help="Only the first N drives of each half.")] = None,
    seed: Annotated[Whole, Parameter(help="0: the benchmark; other seeds: other drives.")] = 0,
    workers: Workers = None,
    dask: Dask = "",
    force: Annotated[Flag, Parameter(help="Make also what is up to date.")] = False,
) -> int:
    """Make the synthetic benchmark: 200 drives, rendered, tracked, labelled exactly; nothing is downloaded.

    Takes a quarter of an hour on two cores. Drives that are up to date are skipped; an interrupted run is
    finished by the same command. 'mseg benchmark synth --data FOLDER' runs methods on it.
    """
    from kt3dmoseg.pipeline import build_synthetic
    from kt3dmoseg.synthetic.drives import PER_PART

    make = partial(build_synthetic, output, part=part, seed=seed, first=first, workers=workers)
    total = min(first or PER_PART, PER_PART) * (1 if part else 2)
    return _code(_run(partial(make, dask=dask, force=force), total, output))


@flags(TrackOptions)
def track(
    frames: Annotated[Either, Parameter(help="Folder of frames, a video, or a KITTI raw root.")],
    *,
    output: Annotated[File, Parameter(alias="-o", help="File to write.")],
    flow: Annotated[Name, Parameter(help="Optical flow.")] = "dis",
    tracker: Annotated[Name, Parameter(help="Point tracker instead: cotracker, tapir.")] = "",
    parameter: FlowParameters = (),
    cache: FlowCache = None,
    colour: Annotated[
        Literal["refuse", "luma"], Parameter(help="Colour frames: refuse them, or take their luma.")
    ] = "refuse",
    drive: Annotated[str | None, _part(help="Number of the drive of a KITTI raw root.")] = None,
    range_: Annotated[Range | None, _part(help="Frame numbers, both included; a video's from 0.")] = None,
    step: Annotated[Positive, _part(help="Take every N-th frame.")] = 1,
    size: Annotated[Size, _part(help="Resize the frames.")] = "",
    **options: Any,  # noqa: ANN401
) -> None:
    """Frames to dense point trajectories.

    Writes every trajectory, unlabelled, in the format that the suffix of FILE names (.h5, .mat, .npz, .dat).
    """
    from kt3dmoseg.files import check_target, check_writable
    from kt3dmoseg.flow import create
    from kt3dmoseg.frames import one_source
    from kt3dmoseg.io import save
    from kt3dmoseg.io.formats import written_as
    from kt3dmoseg.tracking import create_tracker, track_clip

    given = parse_assignments(parameter)
    options |= {"tracker": create_tracker(tracker, **given)} if tracker else {"flow": create(flow, **given)}
    written_as(output)
    check_target(output)
    check_writable(output.parent)
    source = one_source(frames, drive=drive, frames=range_, step=step, size=size)
    for note in source.inspect().notes:
        app.warn(f"{frames}: {note}")
    with progress_bar("frame") as progress:
        clip = track_clip(source, colour=colour, cache=cache, progress=progress, **options)
    save(clip, output)
    if not len(clip.dense):
        _warn_of_none(f"{frames} ({clip.n_frames} frames)", options)
    print(f"{output}: {len(clip.dense)} trajectories in {clip.n_frames} frames", file=sys.stderr)


@flags(PublishOptions)
def publish(
    dataset: Annotated[Folder, Parameter(help="Folder of clips, as build writes it.")],
    *,
    output: Annotated[Folder, Parameter(alias="-o", help="New folder.")],
    split: Annotated[
        tuple[str, ...],
        Parameter(
            metavar="NAME=PATTERN",
            help="Clips of a split (others: train); may be repeated, the first that fits counts.",
        ),
    ] = (),
    **options: Any,  # noqa: ANN401
) -> None:
    """Publish clips as a version of a dataset: files, parquet tables, Croissant metadata and a card.

    'datasets.load_dataset(FOLDER)' and 'pandas.read_parquet' load it offline. A published version never
    changes: another one needs another version and folder.
    """
    from kt3dmoseg.publishing import publish

    facts = publish(dataset, output, splits=split, **options)
    splits = ", ".join(f"{len(names)} {name}" for name, names in facts["splits"].items())
    print(f"{output}: {facts['name']} {facts['version']}, {splits}, {facts['license']}", file=sys.stderr)


def diff(
    old: Annotated[Folder, Parameter(help="Clips, or a published version.")],
    new: Annotated[Folder, Parameter(help="Clips, or a published version.")],
    /,
    *,
    json: Json = False,
) -> None:
    """Compare two versions of a dataset: clips, trajectories, labels and how they were built."""
    from kt3dmoseg.publishing import diff

    found = diff(old, new)
    if json:
        print(found.to_json(orient="records"))
    else:
        rows = [list(map(str, row)) for row in found.itertuples(index=False)]
        print(text_table(rows, list(found.columns)) if rows else "no clip differs")


def info(path: Annotated[Either, Parameter(help="File or folder.")], /, *, json: Json = False) -> None:
    """Describe a clip, a folder of clips, a folder of frames, a video or a flow field."""
    from kt3dmoseg.io.info import describe, info

    print(dumps(describe(path), indent=1, ensure_ascii=False) if json else info(path))


def convert(
    source: Annotated[File, Parameter(help="File to read.")],
    target: Annotated[File, Parameter(help="File to write.")],
    /,
    *,
    layout: Annotated[
        Name,
        Parameter(help="Write a .npz as a tracker does: cotracker, tapir, tap-vid, kubric, pointodyssey."),
    ] = "",
) -> None:
    """Convert a clip (.h5, .mat, .npz, .dat) or a flow field (.flo, .png, .npy, .npz).

    The suffix of TARGET names the format; SOURCE is recognised by its content. What the format of TARGET
    cannot hold is listed.
    """
    from kt3dmoseg.io.formats import convert

    lost = convert(source, target, layout=layout)
    kept = f"; this format does not keep: {', '.join(lost)}" if lost else ""
    print(f"{target}: written{kept}", file=sys.stderr)
