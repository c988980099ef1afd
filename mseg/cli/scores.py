"""Commands that check, score, compare and rank submissions."""

from __future__ import annotations

import dataclasses
import json as json_
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Group, Parameter
from cyclopts.validators import MutuallyExclusive

from kt3dmoseg.app import Either, File, Flag, Folder, Name, Positive, group

if TYPE_CHECKING:
    from mseg.evaluation.scoring import ScoreTable

Submission = Annotated[Path, Parameter(help="Folder or zip.")]
Data = Annotated[Path, Parameter(help="Folder of clips with labels (or one clip file).")]
Benchmark = Annotated[Name, Parameter(help="Protocol (default: the submission's own).")]
_FORM = Group.create_ordered("Form", validator=MutuallyExclusive())  # type: ignore[no-untyped-call]
Form = Annotated[Flag, Parameter(group=_FORM)]
Json = Annotated[Flag, Parameter(help="Print the result as JSON.")]
Force = Annotated[Flag, Parameter(help="Count clips with problems as fully wrong.")]


def example_submission(
    data: Folder | None = None,
    /,
    *,
    output: Annotated[Folder, Parameter(alias="-o")] = Path("example-submission"),
    seeds: Positive = 1,
    format: Literal["csv", "npz", "h5"] = "csv",
    source: Annotated[Path | None, Parameter(name="--from", metavar="FILES")] = None,
    zero: Literal["first", "outlier"] | None = None,
    method: Name = "",
    benchmark: Name = "",
) -> None:
    """Write a valid submission to start from, or turn label files you already have into one.

    Without --from the labels are a simple example: each clip is cut at the median horizontal position.
    Without DATA a small made-up dataset is written as well, in OUT-data.

    Parameters
    ----------
    data : path
        Folder of clips; without it, small ones are made up.
    output : path
        Folder to write.
    seeds : int
        Write N runs, in seed-0, seed-1, ...
    format : {"csv", "npz", "h5"}
        File format.
    source : path
        Label files: .mat with ClusterIdx, or a folder of <clip>.txt, .csv, .mat or .dat.
    zero : {"first", "outlier"}
        What label 0 of label files is: the first cluster (1 is added to all) or an outlier.
    method : str
        Name of the method, for meta.toml.
    benchmark : str
        Protocol, for meta.toml.
    """
    from mseg.evaluation import example
    from mseg.evaluation.protocol import count

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
    print(f"check it: mseg validate {wrote.folder} {wrote.data}", file=sys.stderr)
    print(f"score it: mseg score {wrote.folder} {wrote.data}", file=sys.stderr)


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
    output: Annotated[File | None, Parameter(alias="-o")] = None,
    json: Form = False,
    csv: Form = False,
    markdown: Form = False,
    latex: Form = False,
) -> int:
    """Score a submission: the headline table, every clip, every metric.

    A missing clip, or one on which the method failed, counts as fully wrong and is listed. A submission
    with other problems is rejected with all of them (exit code 1); --force scores it all the same.

    Parameters
    ----------
    output : path
        Write there instead of printing.
    json : bool
        Everything, as JSON ('mseg compare' reads it).
    csv : bool
        One row per clip, as CSV.
    markdown : bool
        The headline table in Markdown.
    latex : bool
        The headline table in LaTeX.
    """
    from kt3dmoseg.files import write_text
    from mseg.evaluation.scoring import score_validated
    from mseg.evaluation.validation import validate_submission

    checked = validate_submission(submission, data, benchmark=benchmark)
    if not checked.ok:
        print(checked, file=sys.stderr)
        if not checked.scorable and not (force and checked.clips):
            print("rejected: repair it, or score it as it is with --force", file=sys.stderr)
            return 1
    form = "json" if json else "csv" if csv else "markdown" if markdown else "latex" if latex else "text"
    content = _rendered(score_validated(checked, force=force), form)
    if output is None:
        print(content)
    else:
        write_text(output, content + "\n")
    return 0


def _rendered(scores: ScoreTable, form: str) -> str:
    from mseg.evaluation import results
    from mseg.evaluation.scoring import to_json

    if form == "json":
        return json_.dumps(to_json(scores), indent=1)
    if form == "csv":
        return results.per_clip(scores, scores.metrics).csv().rstrip()
    if form == "markdown":
        return results.headline(scores).markdown()
    if form == "latex":
        return results.headline(scores).latex()
    parts = [
        results.headline(scores),
        results.by_axis(scores),
        results.per_clip(scores),
        results.all_means(scores),
    ]
    return "\n\n".join(part.text() for part in parts if part)


def compare(
    first: Either,
    /,
    *others: Either,
    data: Annotated[Folder | None, Parameter(metavar="DATA")] = None,
    benchmark: Benchmark = "",
    metric: str = "error",
    json: Json = False,
) -> None:
    """Compare submissions: a table and paired statistics, and whether the seed noise explains it.

    Each of FIRST OTHERS... is a submission, or a file written by 'mseg score --json'. For submissions, the
    data come last: mseg compare A B DATA (or --data DATA).

    Parameters
    ----------
    first : path
        Submission or score file.
    others : path
        More of them, then the data.
    data : path
        Folder of clips with labels; by default the last argument.
    metric : str
        What to compare by.
    """
    from mseg.evaluation.comparison import compare, comparison_table, pairs_table
    from mseg.evaluation.scoring import load_scores, score_submission
    from mseg.evaluation.validation import load_clips

    paths = [first, *others]
    if data is None and not all(map(_is_scores, paths)):
        data = paths.pop()
    clips = load_clips(data) if data is not None else {}
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
    submission: Submission,
    data: Data,
    /,
    frames: Folder | None = None,
    *,
    benchmark: Benchmark = "",
    output: Annotated[File, Parameter(alias="-o")] = Path("report.html"),
    force: Force = False,
    latex: Flag = False,
    markdown: Flag = False,
    csv: Flag = False,
    json: Flag = False,
) -> None:
    """Write one self-contained HTML page about a submission, which opens offline.

    With --frames the trajectories are drawn on the pictures (FRAMES/<clip>/000001.png, ...). The table
    is also written next to the page on request.

    Parameters
    ----------
    frames : path
        Pictures, one sub-folder per clip.
    output : path
        The page.
    latex : bool
        Also write the table as .tex.
    markdown : bool
        Also write the table as .md.
    csv : bool
        Also write .csv, global_results-*.csv and per-sequence_results-*.csv.
    json : bool
        Also write all scores as .json.
    """
    from mseg.evaluation.report import write_report

    wanted = {"latex": latex, "markdown": markdown, "csv": csv, "json": json}
    extras = [name for name, asked in wanted.items() if asked]
    wrote = write_report(
        submission, data, output, frames=frames, benchmark=benchmark, force=force, extras=extras
    )
    for path in wrote:
        size = path.stat().st_size / 1000
        shown = f"{size:.1f} kB" if size < 1000 else f"{size / 1000:.1f} MB"
        print(f"wrote {path} ({shown})", file=sys.stderr)


leaderboard = group("leaderboard", "Keep scored submissions in an SQLite file and rank them per benchmark.")
Board = Annotated[File, Parameter(help="The leaderboard.")]
Only = Annotated[Name, Parameter(help="Only this one.")]
_BOARD = Path("leaderboard.sqlite")


@leaderboard.command
def add(
    submission: Either,
    data: Folder | None = None,
    /,
    *,
    benchmark: Benchmark = "",
    replace: Positive | None = None,
    db: Board = _BOARD,
) -> None:
    """Score a submission and keep the scores; those of a score file are marked as claimed.

    Parameters
    ----------
    submission : path
        Folder or zip, or a file written by 'mseg score --json'.
    data : path
        Folder of clips with labels.
    replace : int
        Number of the entry whose place it takes.
    """
    from kt3dmoseg.errors import InvalidValueError
    from mseg.evaluation.leaderboard import Leaderboard
    from mseg.evaluation.scoring import load_scores, score_submission

    if data is not None:
        scores = score_submission(submission, data, benchmark=benchmark)
    elif _is_scores(submission):
        scores = load_scores(submission)
    else:
        fix = "give it after the submission"
        raise InvalidValueError("data", expected="a folder of clips", found="nothing", fix=fix)
    board = Leaderboard(db, create=replace is None)
    number, new = board.add(scores, claimed=data is None, replace=replace)
    state = "complete" if scores.complete else f"{scores.benchmark.coverage(scores.names)}"
    print(f"{'added' if new else 'already there'}: entry {number}, {scores.meta.method}, {state}")


@leaderboard.command
def remove(number: Positive, /, *, db: Board = _BOARD) -> None:
    """Remove an entry.

    Parameters
    ----------
    number : int
        Number of the entry, see 'mseg leaderboard list'.
    """
    from mseg.evaluation.leaderboard import Leaderboard

    Leaderboard(db, create=False).remove(number)
    print(f"removed entry {number}", file=sys.stderr)


@leaderboard.command(name="list")
def list_entries(*, db: Board = _BOARD, json: Json = False) -> None:
    """Print everything that is kept, oldest first."""
    from mseg.evaluation.leaderboard import Leaderboard

    board = Leaderboard(db, create=False)
    if json:
        print(json_.dumps([dataclasses.asdict(entry) for entry in board.entries()], indent=1))
    else:
        print(board.listing().text())


@leaderboard.command
def rank(*, benchmark: Only = "", db: Board = _BOARD, json: Json = False) -> None:
    """Print the ranks, per benchmark and data.

    A partial submission, or one with failed clips, is listed below the complete ones, without a rank.
    Scores on different data are never ranked together.
    """
    from mseg.evaluation.leaderboard import Leaderboard

    boards = Leaderboard(db, create=False).boards(benchmark)
    if json:
        print(json_.dumps([dataclasses.asdict(board) for board in boards], indent=1))
    else:
        print("\n\n".join(board.table().text() for board in boards))


@leaderboard.command
def export(
    *, output: Annotated[File, Parameter(alias="-o")], benchmark: Only = "", db: Board = _BOARD
) -> None:
    """Write the ranks as a page or Markdown.

    Parameters
    ----------
    output : path
        Ends in .html or .md.
    """
    from mseg.evaluation.leaderboard import Leaderboard, export

    export(Leaderboard(db, create=False), output, benchmark=benchmark)
    print(f"wrote {output}", file=sys.stderr)
