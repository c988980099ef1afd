"""The command line `mseg`: one function per command.

Whatever is heavy is imported inside the functions, so that ``--help`` stays fast.
"""

from __future__ import annotations

import dataclasses
import inspect
import json as json_
import shlex
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter
from cyclopts.validators import MutuallyExclusive

from kt3dmoseg import app
from kt3dmoseg.app import Dask, Either, File, Flag, Folder, Json, Name, Parameters, Positive, group
from kt3dmoseg.errors import InvalidValueError, KT3DMoSegError
from kt3dmoseg.options import describe, parse_assignments
from kt3dmoseg.text import count
from mseg.errors import SegmentationError

if TYPE_CHECKING:
    from mseg.evaluation.leaderboard import Leaderboard

_NAMES = ("methods", "run", "example-submission", "validate", "score", "compare", "report", "leaderboard")
COMMANDS = {name: f"mseg.cli:{name.replace('-', '_')}" for name in (*_NAMES, "benchmark")}
COMMANDS["video"] = "mseg.videos:video"
_PURPOSE = "3D motion segmentation of point trajectories: methods, benchmarks, scores."

program = app.application("mseg", _PURPOSE, COMMANDS)
main = partial(app.main, program)  # (argv=None) -> exit code

_N_MOTIONS = "Number of motions of every clip (default: that of its labels)."
_DATA = "Folders of clips (default: the protocol's folder in $KT3DMOSEG_DATA or ../shared/data)."
_PICTURED = "Folders of clips that are shown with their true motions, where --frames has their pictures."
_JSON = "Everything as JSON: written to FILE in addition to the tables, or printed in their place."
_PUBLISH = "Write the scores there, one file per method and dataset version: BENCHMARK/VERSION/METHOD.json."
_NUMBER = "Give the methods the number of motions of each clip, or let them find it."
_NEXT = "check it: mseg validate {0} {1}\nscore it: mseg score {0} {1}"
_PAPER = ("affine", "homography", "fundamental", "keradd", "coreg", "subset")

Names = Annotated[
    tuple[str, ...],
    Parameter(metavar="NAME", consume_multiple=(1, None), show_default=" ".join, help="Methods."),
]
Settings = Annotated[
    Parameters, Parameter(help="Parameter of a method, see 'mseg methods NAME'; may be repeated.")
]
Workers = Annotated[Positive, Parameter(help="Processes.")]
Quiet = Annotated[Flag, Parameter(help="No progress bar.")]
Submission = Annotated[Path, Parameter(help="Folder or zip.")]
Data = Annotated[Path, Parameter(help="Folder of clips with labels (or one clip file).")]
Benchmark = Annotated[Name, Parameter(help="Protocol (default: the submission's own).")]
_FORM = Group.create_ordered("Form", validator=MutuallyExclusive())  # type: ignore[no-untyped-call]
Force = Annotated[Flag, Parameter(help="Count clips with problems as fully wrong.")]
_LABELS = "Label files: .mat with ClusterIdx, or a folder of <clip>.txt, .csv, .mat or .dat."
_ZERO = "What label 0 of label files is: the first cluster (1 is added to all) or an outlier."


def methods(
    method: Annotated[str, Parameter(help="Describe this one.")] = "", /, *, json: Json = False
) -> None:
    """List the methods, or describe one: source, input, cost and parameters."""
    from mseg.methods import METHODS

    found = [_described(method)] if method else [_listed(name) for name in METHODS.names()]
    if json:
        print(json_.dumps(found, indent=1))
    elif method:
        print(f"{method}: {found[0]['description']}\n\nparameters (-p name=value):")
        for parameter in found[0]["parameters"]:
            print(f"  {parameter['name']} = {parameter['default']}\n      {parameter['help']}")
    else:
        width = max(len(each["name"]) for each in found)
        for each in found:
            purpose = each["description"].partition("\n")[0]
            print(f"{each['name']:<{width}}  {purpose}")


def _listed(name: str) -> dict[str, Any]:
    try:
        return _described(name)
    except KT3DMoSegError as error:
        return {"name": name, "description": f"(not available: {error})", "parameters": []}


def _described(name: str) -> dict[str, Any]:
    from mseg.methods import METHODS

    cls = METHODS.load(name)
    rows = describe(cls, where=f"method {name}")
    parameters = [dict(zip(("name", "default", "help"), row, strict=True)) for row in rows]
    return {"name": name, "description": inspect.cleandoc(cls.__doc__ or ""), "parameters": parameters}


def run(
    data: Annotated[Either, Parameter(help="Folder of clips, or one clip.")],
    /,
    *,
    output: Annotated[Folder, Parameter(alias="-o", help="Where predictions go.")],
    method: Annotated[Name, Parameter(help="Method.")] = "subset",
    n_motions: Annotated[Positive | None, Parameter(help=_N_MOTIONS)] = None,
    number: Annotated[Literal["given", "found"], Parameter(help=_NUMBER)] = "given",
    seeds: Annotated[Positive, Parameter(help="Number of seeds; several go to seed-0/, seed-1/, ...")] = 1,
    parameter: Settings = (),
    all_: Annotated[
        Flag, Parameter(name="--all", help="Label all trajectories, too: into another folder, OUTPUT-all.")
    ] = False,
    workers: Workers = 1,
    dask: Dask = "",
    quiet: Quiet = False,
) -> int:
    """Segment every clip of a folder with a method and write the predictions.

    The output is a submission: 'mseg validate' and 'mseg score' read it. What is there already is kept,
    so an interrupted run goes on; a folder that holds other predictions is refused. Exit code 1 when the
    method failed on every clip.
    """
    from mseg.benchmark import predict
    from mseg.evaluation.submission import FAILED, META, parse_meta, prediction_files

    code = 0
    with app.progress_bar("task", quiet=quiet) as progress:
        try:
            predict(
                data,
                output,
                method,
                n_motions=n_motions,
                number=number,
                seeds=seeds,
                parameters=parse_assignments(parameter),
                rows="all" if all_ else "evaluated",
                workers=workers,
                dask=dask,
                progress=progress,
            )
        except SegmentationError:
            code = 1
    folder = Path(output)
    failed = [path for path in prediction_files(folder) if path.suffix == FAILED]
    lines = [f"failed: {path.relative_to(folder)}: {app.typed(path.read_text().strip())}" for path in failed]
    meta, _ = parse_meta((folder / META).read_bytes())
    lines += [f"note: {clip}: {note}" for clip, note in meta.notes.items()]
    lines.append(f"wrote {folder}" + (f" ({count(len(failed), 'run')} failed)" if failed else ""))
    print(*lines, _next(folder, data), sep="\n", file=sys.stderr)
    return code


def _next(folder: Path, data: Path) -> str:
    return _NEXT.format(*(shlex.quote(f"{path}") for path in (folder, data)))


def example_submission(
    data: Annotated[Folder | None, Parameter(help="Clips; without them, small ones are made up.")] = None,
    /,
    *,
    output: Annotated[Folder, Parameter(alias="-o", help="Folder to write.")] = Path("example-submission"),
    seeds: Annotated[Positive, Parameter(help="Write N runs, in seed-0, seed-1, ...")] = 1,
    format: Annotated[Literal["csv", "npz", "h5"], Parameter(help="File format.")] = "csv",
    source: Annotated[Path | None, Parameter(name="--from", metavar="FILES", help=_LABELS)] = None,
    zero: Annotated[Literal["first", "outlier"] | None, Parameter(help=_ZERO)] = None,
    method: Annotated[Name, Parameter(help="Name of the method, for meta.toml.")] = "",
    benchmark: Annotated[Name, Parameter(help="Protocol, for meta.toml.")] = "",
) -> None:
    """Write a valid submission to start from, or turn label files you already have into one.

    Without --from the labels are a simple example: each clip is cut at the median horizontal position.
    Without DATA a small made-up dataset is written as well, in OUT-data.
    """
    from mseg.evaluation import example

    wrote = example.example_submission(
        data,
        output,
        seeds=seeds,
        format=format,
        method=method,
        benchmark=benchmark,
        source=source,
        zero=zero or "",
    )
    if wrote.note:
        print(f"note: {wrote.note}", file=sys.stderr)
    print(f"wrote {wrote.folder} ({count(wrote.clips, 'clip')})", file=sys.stderr)
    print(_next(wrote.folder, wrote.data), file=sys.stderr)


def validate(submission: Submission, data: Data, /, *, benchmark: Benchmark = "", json: Json = False) -> int:
    """Report everything that is wrong with a submission, numbered, with how to fix it.

    Exit code 0: valid; 1: invalid; 2: wrong usage (no such file, no data).
    """
    from mseg.evaluation.validation import validate_submission

    found = validate_submission(submission, data, benchmark=benchmark)
    print(json_.dumps(found.as_dict(), indent=2) if json else str(found))
    return 0 if found.ok else 1


def score(
    submission: Submission,
    data: Data,
    /,
    *,
    benchmark: Benchmark = "",
    force: Force = False,
    output: Annotated[File | None, Parameter(alias="-o", help="Write there instead of printing.")] = None,
    json: Annotated[Flag, Parameter(group=_FORM, help="All, as JSON ('mseg compare' reads it).")] = False,
    csv: Annotated[Flag, Parameter(group=_FORM, help="One row per clip, as CSV.")] = False,
    markdown: Annotated[Flag, Parameter(group=_FORM, help="The headline table in Markdown.")] = False,
    latex: Annotated[Flag, Parameter(group=_FORM, help="The headline table in LaTeX.")] = False,
) -> int:
    """Score a submission: the headline table, every clip, every metric.

    A missing clip, or one on which the method failed, counts as fully wrong and is listed. A submission
    with other problems is rejected with all of them (exit code 1); --force scores it all the same.
    """
    from kt3dmoseg.files import write_text
    from mseg.evaluation.results import rendered
    from mseg.evaluation.scoring import score_validated
    from mseg.evaluation.validation import validate_submission

    checked = validate_submission(submission, data, benchmark=benchmark)
    if not checked.ok:
        print(checked, file=sys.stderr)
        if not checked.scorable and not (force and checked.clips):
            print("rejected: repair it, or score it as it is with --force", file=sys.stderr)
            return 1
    form = "json" if json else "csv" if csv else "markdown" if markdown else "latex" if latex else "text"
    content = rendered(score_validated(checked, force=force), form)
    if output is None:
        print(content)
    else:
        write_text(output, content + "\n")
    return 0


def compare(
    first: Annotated[Either, Parameter(help="Submission or score file.")],
    /,
    *others: Annotated[Either, Parameter(help="More of them, then the data.")],
    data: Annotated[Folder | None, Parameter(metavar="DATA", help="By default the last argument.")] = None,
    benchmark: Benchmark = "",
    metric: Annotated[str, Parameter(help="What to compare by.")] = "error",
    json: Json = False,
) -> None:
    """Compare submissions: a table and paired statistics, and whether the seed noise explains it.

    Each of FIRST OTHERS... is a submission, or a file written by 'mseg score --json'. For submissions, the
    data come last: mseg compare A B DATA (or --data DATA).
    """
    from mseg.evaluation.comparison import compare, comparison_table, pairs_table
    from mseg.evaluation.scoring import load_scores, score_submission
    from mseg.evaluation.validation import load_clips

    paths = [first, *others]
    if data is None and not all(map(_is_scores, paths)):
        data = paths.pop()
    clips = load_clips(data) if data is not None else {}
    if clips and all(map(_is_scores, paths)):
        fix = "compare the submissions, to score them again"
        raise InvalidValueError("data", expected="none for files of scores", found=f"{data}", fix=fix)
    tables = [
        load_scores(path) if _is_scores(path) else score_submission(path, clips, benchmark=benchmark)
        for path in paths
    ]
    found = compare(tables, metric=metric)
    if json:
        means = {name: table[metric] for name, table in zip(found.names, found.tables, strict=True)}
        pairs = [dataclasses.asdict(pair) for pair in found.pairs]
        print(json_.dumps({"metric": metric, "means": means, "pairs": pairs}, indent=2))
    else:
        sentences = "\n".join(f"- {pair.sentence}" for pair in found.pairs)
        print("\n\n".join([comparison_table(found).text(), pairs_table(found).text(), sentences]))


def _is_scores(path: Path) -> bool:
    return path.name.endswith(".json")


def report(
    first: Annotated[Either, Parameter(help="Submission: folder or zip.")],
    /,
    *others: Annotated[Either, Parameter(help="More of them, then the data, then pictures if at hand.")],
    data: Annotated[
        Folder | None, Parameter(metavar="DATA", help="By default after the submissions.")
    ] = None,
    frames: Annotated[Folder | None, Parameter(help="Pictures, one sub-folder per clip.")] = None,
    benchmark: Benchmark = "",
    output: Annotated[File, Parameter(alias="-o", help="The page.")] = Path("report.html"),
    force: Force = False,
    latex: Annotated[Flag, Parameter(help="Also write the table as .tex.")] = False,
    markdown: Annotated[Flag, Parameter(help="Also write the table as .md.")] = False,
    csv: Annotated[
        Flag, Parameter(help="Also write .csv, global_results-*.csv and per-sequence_results-*.csv.")
    ] = False,
    json: Annotated[Flag, Parameter(help="Also write all scores as .json.")] = False,
) -> None:
    """Write one self-contained HTML page about a submission, or several side by side, which opens offline.

    mseg report A DATA, or mseg report A B C DATA. With --frames the trajectories are drawn on the pictures
    (FRAMES/<clip>/000001.png, ...). The table is also written next to the page on request.
    """
    from mseg.evaluation.report import write_report
    from mseg.evaluation.submission import looks_like_submission

    wanted = {"latex": latex, "markdown": markdown, "csv": csv, "json": json}
    extras = [name for name, asked in wanted.items() if asked]
    paths = [first, *others]
    n = next((i for i, path in enumerate(paths) if i and not looks_like_submission(path)), len(paths))
    submissions, rest = paths[:n], paths[n:]
    if data is None and rest:
        data = rest.pop(0)
    if frames is None and rest:
        frames = rest.pop(0)
    if data is None or rest:
        expected, found = "submissions, then the folder of clips", " ".join(map(str, paths))
        fix = "a submission is a zip or has a meta.toml"
        raise InvalidValueError("report", expected=expected, found=found, fix=fix)
    for path in write_report(
        submissions, data, output, frames=frames, benchmark=benchmark, force=force, extras=extras
    ):
        size = path.stat().st_size / 1000
        shown = f"{size:.1f} kB" if size < 1000 else f"{size / 1000:.1f} MB"
        print(f"wrote {path} ({shown})", file=sys.stderr)


leaderboard = group("leaderboard", "Keep scored submissions in an SQLite file and rank them per benchmark.")
Board = Annotated[File, Parameter(help="The leaderboard.")]
Number = Annotated[Positive, Parameter(help="Number of the entry, see 'mseg leaderboard list'.")]
Page = Annotated[File, Parameter(alias="-o", help="Ends in .html or .md.")]
Only = Annotated[Name, Parameter(help="Only this one.")]
_SCORED = "Folder or zip, or a file written by 'mseg score --json'."
_BOARD = Path("leaderboard.sqlite")


def _open(db: Path, *, create: bool = False) -> Leaderboard:
    from mseg.evaluation.leaderboard import Leaderboard

    return Leaderboard(db, create=create)


@leaderboard.command
def add(
    submission: Annotated[Either, Parameter(help=_SCORED)],
    data: Annotated[Folder | None, Parameter(help="Folder of clips with labels.")] = None,
    /,
    *,
    benchmark: Benchmark = "",
    replace: Annotated[Positive | None, Parameter(help="Number of the entry whose place it takes.")] = None,
    db: Board = _BOARD,
) -> None:
    """Score a submission and keep the scores; those of a score file are marked as claimed."""
    from mseg.evaluation.scoring import load_scores, score_submission

    if data is not None:
        scores = score_submission(submission, data, benchmark=benchmark)
    elif _is_scores(submission):
        scores = load_scores(submission)
    else:
        fix = "give it after the submission"
        raise InvalidValueError("data", expected="a folder of clips", found="nothing", fix=fix)
    number, new = _open(db, create=replace is None).add(scores, claimed=data is None, replace=replace)
    state = "complete" if scores.complete else f"{scores.benchmark.coverage(scores.names)}"
    print(f"{'added' if new else 'already there'}: entry {number}, {scores.meta.method}, {state}")


@leaderboard.command
def remove(number: Number, /, *, db: Board = _BOARD) -> None:
    """Remove an entry."""
    _open(db).remove(number)
    print(f"removed entry {number}", file=sys.stderr)


@leaderboard.command(name="list")
def list_entries(*, db: Board = _BOARD, json: Json = False) -> None:
    """Print everything that is kept, oldest first."""
    board = _open(db)
    entries = [dataclasses.asdict(entry) for entry in board.entries()]
    print(json_.dumps(entries, indent=1) if json else board.listing().text())


@leaderboard.command
def rank(*, benchmark: Only = "", db: Board = _BOARD, json: Json = False) -> None:
    """Print the ranks, per benchmark and data.

    A partial submission, or one with failed clips, is listed below the complete ones, without a rank.
    Scores on different data are never ranked together.
    """
    boards = _open(db).boards(benchmark)
    values = [board.as_dict() for board in boards]
    tables = [board.table().text() for board in boards] or [
        f"no entries{f' of {benchmark}' if benchmark else ''}"
    ]
    print(json_.dumps(values, indent=1) if json else "\n\n".join(tables))


@leaderboard.command
def export(*, output: Page, benchmark: Only = "", db: Board = _BOARD) -> None:
    """Write the ranks as a page or Markdown."""
    from mseg.evaluation.leaderboard import export

    export(_open(db), output, benchmark=benchmark)
    print(f"wrote {output}", file=sys.stderr)


Results = Annotated[Folder, Parameter(help="Published results, such as results/ of the repository.")]


@leaderboard.command
def site(
    results: Results,
    /,
    *,
    output: Annotated[Folder, Parameter(alias="-o", help="Folder to write.")] = Path("site"),
    data: Annotated[tuple[Folder, ...], Parameter(consume_multiple=(1, None), help=_PICTURED)] = (),
    frames: Annotated[Folder | None, Parameter(help="Pictures, one sub-folder per clip.")] = None,
) -> None:
    """Write a page of published results: filters, ranks with intervals, every clip, earlier versions.

    Earlier versions of a row are those that git has of its file.
    """
    from mseg.benchmark.site import write_site

    print(f"wrote {write_site(results, output, data=data, frames=frames)}", file=sys.stderr)


@leaderboard.command
def submit(
    submission: Submission,
    data: Data,
    /,
    *,
    output: Annotated[Folder, Parameter(alias="-o", help="Folder of published results.")] = Path("results"),
    benchmark: Benchmark = "",
) -> None:
    """Score a submission and put its scores and predictions with published results, for a pull request."""
    from mseg.benchmark.site import submit

    for path in submit(submission, data, output, benchmark=benchmark):
        print(f"wrote {path}", file=sys.stderr)


@leaderboard.command
def check(
    results: Results,
    /,
    *,
    data: Annotated[tuple[Folder, ...], Parameter(consume_multiple=(1, None), help=_DATA)] = (),
) -> int:
    """Score the predictions among published results again and compare; exit code 1 where a figure differs."""
    from mseg.benchmark.site import check_submissions

    n, wrong = check_submissions(results, data)
    for difference in wrong:
        print(difference)
    print(f"{count(n, 'submission')} checked, {count(len(wrong), 'fault')}", file=sys.stderr)
    return int(bool(wrong))


def benchmark(
    benchmark: Annotated[str, Parameter(help="Protocol: kt3dmoseg, hopkins155, hopkins12, mtpv62 or synth.")],
    /,
    *,
    methods: Names = _PAPER,
    data: Annotated[tuple[Folder, ...], Parameter(consume_multiple=(1, None), help=_DATA)] = (),
    cache: Annotated[Folder, Parameter(help="Outcomes.")] = Path("out/benchmark"),
    no_cache: Annotated[Flag, Parameter(help="Run everything, keep nothing.")] = False,
    kernels: Annotated[Folder | None, Parameter(help="Keep kernels there, for sweeps of parameters.")] = None,
    json: Annotated[list[str] | None, Parameter(metavar="FILE", consume_multiple=(0, 1), help=_JSON)] = None,
    markdown: Annotated[Flag, Parameter(help="Print Markdown tables.")] = False,
    publish: Annotated[Folder | None, Parameter(help=_PUBLISH)] = None,
    number: Annotated[Literal["given", "found"], Parameter(help=_NUMBER)] = "given",
    seeds: Annotated[Positive, Parameter(help="Number of seeds, counted from 0.")] = 1,
    parameter: Settings = (),
    workers: Workers = 1,
    dask: Dask = "",
    quiet: Quiet = False,
) -> None:
    """Run methods on every clip of a benchmark that is found, over several seeds, and print the tables.

    Outcomes are kept in a folder (--cache), so that a re-run, or one with more methods or seeds, runs
    only what is new. What is missing of the benchmark is listed; the printed rows are for all of it.
    Exit code 1 when every run failed.
    """
    from kt3dmoseg.files import check_target, check_writable, write_text
    from mseg.benchmark import run

    for file in set(json or ()) - {"-"}:
        check_target(file)
        check_writable(Path(file).parent)
    for folder in filter(None, (publish, None if no_cache else cache, kernels)):
        check_writable(folder)
    with app.progress_bar("task", quiet=quiet) as progress:
        result = run(
            benchmark,
            list(methods),
            data=data,
            seeds=seeds,
            parameters=parse_assignments(parameter),
            number=number,
            workers=workers,
            dask=dask,
            cache=None if no_cache else cache,
            kernels=kernels,
            progress=progress,
        )
    if json and json != ["-"]:
        write_text(json[0], json_.dumps(result.as_dict(), indent=1) + "\n")
    if publish:
        from mseg.benchmark.publishing import publish as write

        for path in write(result, publish):
            print(f"wrote {path}", file=sys.stderr)
    if json in ([], ["-"]):
        print(json_.dumps(result.as_dict(), indent=1))
    else:
        tables = [table for table in (result.per_clip(), result.by_axis(), result.summary()) if table]
        print("\n\n".join(t.markdown() if markdown else t.text() for t in tables))
