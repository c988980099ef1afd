"""From recordings to a ranked choice of windows: measured part by part, kept, compared, shown."""

import json
import os
import shlex
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, TypeAlias

import cv2

from kt3dmoseg import __version__, catalog, choosing, files, tracking
from kt3dmoseg.choosing import ChooseOptions
from kt3dmoseg.choosing.windows import Window, measure_windows, metres_between
from kt3dmoseg.errors import InputFileError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.files import PathLike
from kt3dmoseg.flow import backend_identity, create
from kt3dmoseg.frames import Cut, FrameFolder, FrameSource, KittiClip, choose_sources, source_names
from kt3dmoseg.io.images import jpeg_address
from kt3dmoseg.options import from_mapping
from kt3dmoseg.parallel import Progress, cache_key, run_tasks

_PARTS = "measured"  # folder of what is kept of every part, in the folder of results
_SAME_RECORDING = 0.85  # what another window of a recording that has one already is worth
_STRIP, _THUMBNAIL, _QUALITY = 5, 260, 70  # pictures, their width, their quality

_Part: TypeAlias = tuple[FrameSource, str]  # and the name of the file that keeps its measures
COLUMNS = ("clip", "score", "translation", "depth", "clutter", "motions", "trajectories", "movers")


def choose(
    recordings: PathLike | Sequence[PathLike | FrameSource],
    output: PathLike | None = None,
    *,
    workers: int = 1,
    dask: str = "",
    progress: Callable[[int, int], None] | None = None,
    **options: Any,  # noqa: ANN401
) -> list[Window]:
    """Choose clips from recordings; see `kt3dmoseg.choosing.windows` for what is measured.

    Parts of the longest window's length, each of which begins in the middle of the one before, are measured
    one by one, in memory that does not depend on the length of the recording. What is measured is kept in
    `output`, so that an interrupted run goes on, and another `count` or `apart` costs nothing.

    Parameters
    ----------
    recordings : path or sequence of paths or FrameSource
        KITTI raw roots (all their drives), folders of numbered frames or of such folders, videos.
    output : path, optional
        Folder for ``index.html`` (the ranked table with pictures), ``candidates.csv`` (every window) and
        ``candidates.toml`` (a catalog of the chosen ones that are of KITTI drives).
    workers : int
        Number of processes.
    dask : str
        Address of a Dask scheduler, instead of processes; its workers must see the same folders.
    progress : callable, optional
        Called with (parts done, parts in all).
    **options
        Fields of `ChooseOptions`.

    Returns
    -------
    list of Window
        The chosen ones, the best first.

    Raises
    ------
    InputFileError, FileFormatError
        For frames that are missing or cannot be read, and an output that cannot be written.
    InvalidValueError, UnknownNameError
        For a bad option, recordings that are all shorter than a window, or two of one name.
    """
    settings = from_mapping(ChooseOptions, options, where="choose")
    if settings.shortest > settings.longest:
        expected, found = f"at most longest, {settings.longest}", f"{settings.shortest}"
        raise InvalidValueError("shortest", expected=expected, found=found)
    sources = _sources(recordings)
    parts = [part for source in sources.values() for part in _parts(source, settings)]
    if not parts:
        expected = f"a drive, frames or a video, of {settings.shortest} frames or more without a gap"
        raise InvalidValueError("recordings", expected=expected, found=", ".join(sources) or "none")
    if output is None:
        return select(_measured(parts, settings, None, workers, dask, progress), settings)
    files.check_writable(Path(output))
    with files.hold_folder(output, alone="choice") as folder:
        windows = _measured(parts, settings, folder / _PARTS, workers, dask, progress)
        chosen = select(windows, settings)
        _write(folder, windows, chosen, sources, settings)
    return chosen


def _sources(given: PathLike | Sequence[PathLike | FrameSource]) -> dict[str, FrameSource]:
    found: list[FrameSource] = []
    for item in [given] if isinstance(given, (str, os.PathLike)) else given:
        found += choose_sources(item, drives=True) if isinstance(item, (str, os.PathLike)) else [item]
    return dict(zip(source_names(found), found, strict=True))


def _parts(source: FrameSource, settings: ChooseOptions) -> Iterator[_Part]:
    """Give the parts of a recording, and the name of the file in which the measures of each are kept."""
    given: Any = source  # a dataclass with a cut
    whole, cut = None, given.cut
    if cut.step != 1:
        raise InvalidValueError(f"{source.where}: step", expected="1", found=f"{cut.step}")
    if isinstance(source, KittiClip):  # which may be on disk in parts
        numbers = source.drive.numbers.tolist()
        numbers = [n for n in numbers if (cut.first or 0) <= n and (cut.last is None or n <= cut.last)]
    else:
        whole, numbers = source.inspect().description, source.numbers()
    measured = {**asdict(settings), "count": 0, "apart": 0}
    versions = [__version__, choosing.ALGORITHM_VERSION, tracking.ALGORITHM_VERSION, cv2.__version__]
    about: dict[str, Any] = {
        "options": measured,
        "versions": versions,
        "flow": backend_identity(create(settings.flow)),
    }
    labelled = isinstance(source, KittiClip) and source.drive.has_tracklets
    boxes = files.sha256_file(given.drive.tracklet_file) if labelled else ""
    for run in catalog.runs(numbers):
        last = max(0, len(run) - settings.longest)
        starts = [*range(0, last, max(1, settings.longest // 2)), last]
        for start in starts if len(run) >= settings.shortest else []:
            ends = run[start], run[min(start + settings.longest, len(run)) - 1]
            part = replace(given, cut=replace(cut, first=ends[0], last=ends[1], name=source.name))
            frames = whole or part.inspect().description
            if isinstance(source, KittiClip):  # both may come later, or change
                about["known"] = [boxes, metres_between(part, *ends)]
            yield part, f"{cache_key({**about, 'recording': frames, 'part': ends})}.json"


def _measured(
    parts: Sequence[_Part],
    settings: ChooseOptions,
    folder: Path | None,
    workers: int,
    dask: str,
    progress: Callable[[int, int], None] | None,
) -> list[Window]:
    """Measure every part that is not measured yet; a window that two parts hold is taken from the first."""
    measured: dict[tuple[str, str], list[Window]] = {}  # by recording too: copies have equal measures
    work = partial(_measure_part, settings, folder)

    def lost(part: _Part, reason: str) -> list[Window]:
        raise InputFileError(part[0].where, found=reason, fix="run again with fewer workers")

    done = run_tasks(work, parts, lost=lost, workers=workers, dask=dask)
    for count, ((source, kept), windows) in enumerate(done, start=1):
        measured[source.name, kept] = windows
        if progress is not None:
            progress(count, len(parts))
    # Not in the order in which they came.
    ordered = [window for part, kept in reversed(parts) for window in measured[part.name, kept]]
    found = {(window.recording, window.first, window.last): window for window in ordered}
    return [found[key] for key in sorted(found)]


def _measure_part(
    settings: ChooseOptions, folder: Path | None, part: _Part, progress: Progress
) -> list[Window]:
    del progress
    source, kept = part
    if folder is not None and (folder / kept).is_file():
        named = {"recording": source.name}  # which may have been renamed since
        with suppress(KT3DMoSegError, TypeError, KeyError):  # a damaged file is written again
            rows = files.parse_json(files.read_bytes(folder / kept, files.JSON_BYTES), f"{folder / kept}")
            if found := [Window(**row | {"sizes": tuple(row["sizes"])} | named) for row in rows]:
                return found
    cv2.setNumThreads(1)  # also with one worker, which is the calling process
    windows = measure_windows(source, settings)
    if folder is not None:
        files.write_text(folder / kept, json.dumps(list(map(asdict, windows))))
    return windows


def select(windows: Sequence[Window], options: ChooseOptions | None = None) -> list[Window]:
    """Choose diverse windows: the best first, then always the best that is apart from those of its recording.

    A window counts 0.85 times its score for every one that is chosen of its recording already. Windows with a
    cut are never chosen.
    """
    settings = options or ChooseOptions()
    left = [window for window in windows if not window.cut]
    chosen: list[Window] = []
    taken: Counter[str] = Counter()
    while left and len(chosen) < settings.count:
        best = max(left, key=lambda w: (w.score * _SAME_RECORDING ** taken[w.recording], -w.first, w.last))
        chosen.append(best)
        taken[best.recording] += 1
        left = [window for window in left if _apart(window, best, settings.apart)]
    return chosen


def _apart(one: Window, other: Window, frames: int) -> bool:
    gap = max(one.first - other.last, other.first - one.last)
    return one.recording != other.recording or gap > frames


def row(window: Window) -> list[str]:
    """Return what the table shows of a window; see `COLUMNS`."""
    score, far = "cut" if window.cut else f"{window.score:.3f}", f"{window.translation:.1f} {window.unit}"
    scene, sizes = [f"{window.depth:.1f}", f"{window.clutter:.2f}"], " ".join(map(str, window.sizes)) or "-"
    return [window.name, score, far, *scene, f"{window.motions}", sizes, window.movers]


def _write(
    folder: Path,
    found: Sequence[Window],
    chosen: Sequence[Window],
    sources: Mapping[str, FrameSource],
    settings: ChooseOptions,
) -> None:
    import pandas as pd

    ranked = sorted(found, key=lambda window: -window.score)
    table = pd.DataFrame(map(row, ranked), columns=list(COLUMNS))
    files.write_text(folder / "candidates.csv", table.to_csv(index=False))
    entries = [entry for window in chosen if (entry := _entry(window, sources[window.recording]))]
    comment = f"Chosen by kt3dmoseg choose {__version__}, the best first; index.html shows them."
    catalog.save(folder / "candidates.toml", entries, comment=comment)
    files.write_text(folder / "index.html", _page(chosen, len(found), sources, settings))


def _entry(window: Window, source: FrameSource) -> catalog.Entry | None:
    """Return the catalog's entry of a window; None when it is not of a KITTI drive."""
    if not isinstance(source, KittiClip):
        return None
    numbers, drive = tuple(range(window.first, window.last + 1)), source.drive
    about = f"kt3dmoseg choose: score {window.score:.3f}, {window.motions} motions by {window.movers}"
    where = drive.drive, drive.camera, len(numbers), drive.image_size
    return catalog.Entry(window.name, *where, numbers, source=about)


def _page(
    chosen: Sequence[Window], count: int, sources: Mapping[str, FrameSource], settings: ChooseOptions
) -> str:
    from jinja2 import Template

    text = Path(__file__).with_name("static").joinpath("candidates.html").read_text("utf-8")
    items = []
    for window in chosen:
        source = sources[window.recording]
        part = ["--range", f"{window.first}-{window.last}", "--name", window.name, "-o", "FOLDER"]
        part += ["--colour", settings.colour] if isinstance(source, FrameFolder) else []
        build = shlex.join(["kt3dmoseg", "build", source.where, *part])
        command = "" if isinstance(source, KittiClip) else build
        items.append((window, row(window), command, _strip(window, source, settings)))
    template = Template(text, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    return str(template.render(items=items, columns=COLUMNS, count=count, recordings=sources))


def _strip(window: Window, source: Any, settings: ChooseOptions) -> list[str]:  # noqa: ANN401  # with a cut
    cut = Cut(window.first, window.last, max(1, (window.last - window.first) // (_STRIP - 1)))
    frames = replace(source, cut=cut).frames(settings.colour)
    return [jpeg_address(frame, _THUMBNAIL, _QUALITY) for frame in islice(frames, _STRIP)]
