"""Write the tables of results into the pages, from the files in results/.

    python tools/make_tables.py            # after `mseg benchmark ... --publish results/`
    python tools/make_tables.py --check    # exit code 1 when a page differs from the results

A page says where a table goes, and everything up to the end mark is replaced:

    <!-- table: summary kt3dmoseg 2018 -->
    <!-- end of table -->

Tables are `methods`, `summary`, `per-clip` and `short` (README), each of a benchmark and a data version.
results/SCHEMA.json is written too.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path

from kt3dmoseg.files import write_text
from mseg.benchmark.publishing import SCHEMA, PublishedResult, json_schema, per_clip, read_results, summary
from mseg.evaluation.results import ABSENT, ResultsTable, published_name

ROOT = Path(__file__).resolve().parents[1]
PAGES = ("README.md", "docs/results.md")
MARKED = re.compile(r"(<!-- table: ([\w-]+) (\S+) (\S+) -->\n).*?(<!-- end of table -->)", re.DOTALL)
ABOUT = {
    "one_motion": "everything is one motion",
    "affine": "affine maps between frames",
    "homography": "homographies",
    "fundamental": "fundamental matrices",
    "keradd": "the three together: kernels added",
    "coreg": "the three together: views that agree",
    "subset": "the three together: views that nest",
}


def short(results: list[PublishedResult]) -> ResultsTable:
    """Make the table for newcomers: the methods of the paper, one line each."""
    first = results[0]
    rows = []
    for each in (r for r in results if r.title in ABOUT and r.n_motions == "given"):
        errors = 100 * each.errors
        spread = f" ±{errors.mean(axis=0).std(ddof=1):.2f}" if len(each.seeds) > 1 else ""
        name = published_name(each.protocol, each.method)
        printed = each.protocol.published.get(name, {}).get("all", {}).get("mean")
        cells = [f"{errors.mean():.2f}{spread}", ABSENT if printed is None else f"{printed:.2f}"]
        rows.append([f"`{each.title}`: {ABOUT[each.title]}", *cells])
    have = first.protocol.coverage(first.clips)
    columns = ["method", f"error in %, {have}", f"as printed, all {first.protocol.n_clips}"]
    return ResultsTable("", columns, rows)


def methods(results: list[PublishedResult]) -> ResultsTable:
    """Make the table of all methods: the number of motions given, found, and as printed."""
    first, rows = results[0], []
    for title in dict.fromkeys(each.title for each in results):
        of = {each.n_motions: each for each in results if each.title == title}
        name = next(iter(of.values())).published
        printed = first.protocol.published.get(name, {}).get("all", {}).get("mean")
        cells = [cell for way in ("given", "found") for cell in _error_and_seeds(of.get(way))]
        right = f"{100 * of['found'].right:.0f}" if "found" in of else ABSENT
        rows.append(
            [
                f"`{title}`",
                *cells,
                right,
                ABSENT if printed is None or "given" not in of else f"{printed:.2f}",
            ]
        )
    columns = ["method", "number given, error", "seeds", "number found, error", "seeds", "number right, %"]
    title = f"{first.heading}: classification error in %, lower is better"
    return ResultsTable(title, [*columns, f"as printed, all {first.protocol.n_clips}"], rows)


def _error_and_seeds(result: PublishedResult | None) -> list[str]:
    if result is None:
        return [ABSENT, ABSENT]
    means = 100 * result.errors.mean(axis=0)
    spread = f" ±{means.std(ddof=1):.2f}" if len(means) > 1 else ""
    return [f"{means.mean():.2f}{spread}", str(len(means))]


def clips_of_main(results: list[PublishedResult]) -> ResultsTable:
    """Make the table of every clip, of the methods of the paper and ours."""
    return per_clip([each for each in results if each.title in {*ABOUT, "multibody"}])


TABLES = {"methods": methods, "summary": summary, "per-clip": clips_of_main, "short": short}


def filled(text: str, results: Mapping[tuple[str, str], list[PublishedResult]]) -> str:
    """Return a page with its tables made again; a SystemExit names a table that cannot be made."""

    def table(match: re.Match[str]) -> str:
        start, kind, benchmark, version, end = match.groups()
        if kind not in TABLES or (benchmark, version) not in results:
            raise SystemExit(f"no table {kind!r} of results/{benchmark}/{version}")
        return f"{start}\n{TABLES[kind](results[benchmark, version]).markdown()}\n\n{end}"

    return MARKED.sub(table, text)


def files(root: Path = ROOT) -> dict[Path, str]:
    """Every file that is made of the results, with its content."""
    results = read_results(root / "results")
    made = {root / page: filled((root / page).read_text(encoding="utf-8"), results) for page in PAGES}
    return made | {root / "results" / SCHEMA: json.dumps(json_schema(), indent=1) + "\n"}


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--check", action="store_true", help="write nothing; exit code 1 where a file differs"
    )
    check = parser.parse_args().check
    made = files()
    wrong = [
        path for path, text in made.items() if not path.is_file() or path.read_text(encoding="utf-8") != text
    ]
    for path in wrong:
        if not check:
            write_text(path, made[path])
        print(f"{path.relative_to(ROOT)}: {'differs from results/' if check else 'written'}", file=sys.stderr)
    return int(check and bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
