"""Published results as a site, and submissions among them: written for a pull request, scored again in CI.

::

    results/kt3dmoseg/2018/mine.json      scores, as those of `mseg benchmark --publish`
    results/kt3dmoseg/2018/mine.zip       the predictions, as `submit` packs them
"""

import os
import re
import shutil
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from kt3dmoseg.draw.painting import by_label, draw_frame
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.files import PathLike, read_bytes, write_bytes, write_text, zip_bytes
from kt3dmoseg.frames import frame_folder, frames_of
from kt3dmoseg.io import load, load_dataset
from kt3dmoseg.io.images import jpeg_address
from kt3dmoseg.types import Clip
from mseg.benchmark.publishing import PublishedResult, collected, former, read_result, read_results
from mseg.benchmark.runner import BASELINES, find_clips
from mseg.errors import RejectedSubmissionError
from mseg.evaluation.protocol import load_protocol
from mseg.evaluation.scoring import ScoreTable, score_submission
from mseg.evaluation.site import DataRows, Row, Version, site_html
from mseg.evaluation.submission import LIMITS, META, prediction_files
from mseg.methods import METHODS

_WIDTH, _QUALITY = 480, 55
_SECONDS = 60  # for git
_NAMES = re.compile(r"^(?:(?:, | and )?[A-Z][\w-]*[a-z]\b)+")  # the authors before a title or venue


def write_site(
    results: PathLike, output: PathLike, *, data: Sequence[PathLike] = (), frames: PathLike | None = None
) -> Path:
    """Write ``index.html``, which needs nothing else, of published results into a folder; returns its path.

    Clips in the folders `data` with pictures in `frames` are shown with their true motions. Errors as those
    of `mseg.benchmark.publishing.read_results`.
    """
    history, pictures = _history(Path(results)), {} if frames is None else _pictures(data, Path(frames))
    boards = []
    for (benchmark, version), group in read_results(results).items():
        first = group[0]
        about = f"{first.protocol.coverage(first.clips)}, data version {version}"
        rows = [_row(each, history.get(each.path.as_posix(), [])) for each in group]
        shown = {name: picture for name, picture in pictures.items() if name in first.clips}
        key = f"{benchmark}/{version}"
        protocol = load_protocol(benchmark).of_version(version)
        if len(protocol.versions) > 1:
            protocol = replace(protocol, title=f"{protocol.title}, version {version}")
        boards.append(DataRows(key, about, protocol, first.motions, rows, shown))
    boards.sort(key=lambda board: (board.protocol.name != "kt3dmoseg", not board.protocol.published))
    notes = [] if history else ["No history: git does not know these results."]
    page = Path(output) / "index.html"
    write_text(page, site_html(boards, title="Motion segmentation leaderboard", notes=notes))
    return page


def _row(result: PublishedResult, history: Sequence[Version]) -> Row:
    source = ""  # of a method of ours, as its documentation says
    if result.method in METHODS.names():
        about = " ".join((METHODS.load(result.method).__doc__ or "").split())
        source = "".join(re.findall(r"Source: (.*?)\.? Input:", about)[:1])
    names = result.authors or ["this toolkit"] * source.startswith("ours") or _NAMES.findall(source)
    return Row(
        result.title,
        result.errors,
        [clip.scored for clip in result.clips.values()],
        number=result.n_motions,
        kind="baseline" if result.baseline or result.method in BASELINES else "measured",
        supervised=result.supervised,
        authors=", ".join(names),
        link=result.link,
        failed=result.failed,
        right=result.right,
        seconds=result.seconds,
        facts={"source": source, "hardware": result.hardware, **result.versions, **result.parameters},
        history=history,
    )


def _pictures(data: Sequence[PathLike], frames: Path) -> dict[str, str]:
    """Draw the true motions on the middle frame of every clip whose frames are there."""
    made = {}
    for folder in data:
        for name, clip in load_dataset(folder).items():
            if frame_folder(clip, frames) and clip.n_motions:
                middle = clip.n_frames // 2
                drawn = draw_frame(by_label(clip), middle, frames_of(clip, frames)[middle])
                made[name] = jpeg_address(drawn[..., ::-1], _WIDTH, _QUALITY)
    return made


def _history(folder: Path) -> dict[str, list[Version]]:
    """Read the earlier versions that git has of files of results, the latest first; empty without git."""
    log = _git(folder, "log", "--format=%x00%h %cs", "--name-only", "--relative", "--", "*.json")
    found: dict[str, list[Version]] = {}
    former: dict[str, bytes] = {}
    for commit in log.decode().split("\0")[1:]:
        (number, date), *names = (line.split(" ", 1) for line in commit.splitlines() if line)
        for name in (each[0] for each in names if (folder / each[0]).is_file()):
            content = _git(folder, "show", f"{number}:./{name}")
            before = former.setdefault(name, (folder / name).read_bytes())
            if content not in (b"", before):
                found.setdefault(name, []).append(_version(date, content))
            former[name] = content or before
            found.setdefault(name, [])
    return found


def _version(date: str, content: bytes) -> Version:
    try:
        old = PublishedResult.model_validate_json(content, strict=True)
    except ValueError:
        return Version(date, None, "in a former format")
    names = ", ".join(f"{name} {version}" for name, version in old.versions.items())
    return Version(date, float(old.errors.mean()), names)


def _git(folder: Path, *arguments: str) -> bytes:
    """Return what git prints about a folder; nothing without git, or where the folder is in no checkout."""
    program = shutil.which("git")
    if program is None:
        return b""
    line = [program, "-C", str(folder), "-c", "core.quotepath=off", *arguments]
    done = subprocess.run(line, capture_output=True, timeout=_SECONDS)
    return done.stdout if done.returncode == 0 else b""


# --- submissions --------------------------------------------------------------------------------------------


def submit(
    submission: PathLike, data: PathLike | Mapping[str, Clip], results: PathLike, *, benchmark: str = ""
) -> list[Path]:
    """Score a submission and write ``BENCHMARK/VERSION/METHOD.json`` and ``METHOD.zip``; returns their paths.

    RejectedSubmissionError when it is invalid; InvalidValueError when its clips are of no benchmark, results
    there are of other data, or the row of that file name is another's: it has no predictions, or another
    title.
    """
    source = Path(submission)
    result = _scored(score_submission(source, data, benchmark=benchmark))
    path = Path(results) / result.path
    old = former(result, results)
    if old and (old.title != result.title or not path.with_suffix(".zip").is_file()):
        found, fix = f"that of {old.title}, a method of others", "choose another name in meta.toml"
        raise InvalidValueError("method", expected="a name of its own", found=found, fix=fix)
    if source.is_dir():
        files = sorted([source / META, *prediction_files(source)])
        packed = zip_bytes({file.relative_to(source).as_posix(): file.read_bytes() for file in files})
    else:
        packed = read_bytes(source, LIMITS.total_bytes)
    write_bytes(path.with_suffix(".zip"), packed)
    write_text(path, result.text())
    return [path, path.with_suffix(".zip")]


def _scored(scores: ScoreTable) -> PublishedResult:
    """Put the scores of a submission into the form of published results."""
    meta = scores.meta
    if scores.benchmark.name == "custom":
        raise InvalidValueError("submission", expected="clips of a benchmark", found="clips of none")
    return collected(
        scores,
        [meta.seconds / len(scores.names)] * len(scores.names),
        title=meta.method,
        method=meta.method,
        parameters=dict(meta.parameters),
        n_motions="given" if meta.n_motions_given else "found",
        hardware=meta.hardware,
        authors=list(meta.authors),
        link=meta.link,
        supervised=meta.supervised,
        baseline=meta.baseline,
    )


def check_submissions(results: PathLike, data: Sequence[PathLike] = ()) -> tuple[int, list[str]]:
    """Score every submission in a folder of results, those with a zip of predictions, again.

    Returns their number, and file and field of every figure that is not what the predictions give, and every
    file that is rejected. `data` are folders of clips, see `mseg.benchmark.find_clips`. InputFileError when
    there is no result.
    """
    packed = sorted(Path(results).glob("*/*/*.zip"))
    files = sorted({*Path(results).glob("*/*/*.json"), *(each.with_suffix(".json") for each in packed)})
    if not files:
        expected = "results as BENCHMARK/VERSION/METHOD.json"
        raise InputFileError(os.fspath(results), expected=expected, found="none")
    wrong: list[str] = []
    for path in files:
        try:
            wrong += _differences(path, data)
        except (RejectedSubmissionError, FileFormatError, InvalidValueError) as error:
            wrong.append(str(error) if str(error).startswith(f"{path.parent}") else f"{path}: {error}")
    return len(packed), wrong


def _differences(stated: Path, data: Sequence[PathLike]) -> Iterator[str]:
    packed = stated.with_suffix(".zip")
    if not stated.is_file():
        yield f"{stated}: expected the scores of {packed.name}, found none; run mseg leaderboard submit"
        return
    old = read_result(stated)
    if not packed.is_file():
        lacking = "expected its predictions in the same folder, found none; run mseg leaderboard submit"
        yield from [f"{stated}: {lacking}"] * (old.method not in METHODS.names())
        return
    paths, _ = find_clips(load_protocol(old.benchmark), [Path(folder) for folder in data])
    new = _scored(score_submission(packed, [load(file) for file in paths.values()], benchmark=old.benchmark))
    was, now = _figures(old), _figures(new)
    for name in sorted(was.keys() | now.keys()):
        if was.get(name) != now.get(name):
            yield f"{stated}: {name}: stated {was.get(name)!r:.80}, scored again {now.get(name)!r:.80}"


def _figures(result: PublishedResult) -> dict[str, object]:
    """Every field by name, those of clips too; not what depends on the version of the toolkit."""
    clips = {f"clips.{name}.{key}": value for name, clip in result.clips.items() for key, value in clip}
    return result.model_dump(exclude={"clips", "versions", "dataset_version"}) | clips
