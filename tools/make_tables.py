"""Write the tables of results into the pages, from the files in results/.

    python tools/make_tables.py            # after `mseg benchmark ... --publish results/`
    python tools/make_tables.py --check    # exit code 1 when a page differs from the results

A page says where a table goes, and everything up to the end mark is replaced:

    <!-- table: methods kt3dmoseg 2018 -->
    <!-- end of table -->

Tables are `methods`, `per-clip` and `short` (README), each of a benchmark and a data version.
results/SCHEMA.json is written too.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from kt3dmoseg.files import write_text
from kt3dmoseg.text import count
from mseg.benchmark.publishing import SCHEMA, PublishedResult, json_schema, read_results
from mseg.evaluation.protocol import share
from mseg.evaluation.results import ABSENT, ResultsTable, clip_table, published_name
from mseg.methods import METHODS

ROOT = Path(__file__).resolve().parents[1]
METHODS_OF_TABLES = [name for name in METHODS.names() if name != "prevalence"]  # which is one_motion
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
    "multibody": "rigid bodies over all frames (ours)",
    "multibody, number found": "the same, the number of motions not given",
}


def short(results: list[PublishedResult]) -> ResultsTable:
    """Make the table for newcomers: the methods of the paper and ours, one line each."""
    first = results[0]
    rows = []
    for each in (r for r in results if r.row in ABOUT):
        name = published_name(each.protocol, each.method)
        printed = each.protocol.published.get(name, {}).get("all", {}).get("mean")
        cells = [_mean(each.errors), ABSENT if printed is None else f"{printed:.2f}"]
        rows.append([f"`{each.title}`: {ABOUT[each.row]}", *cells])
    have = first.protocol.coverage(first.clips)
    columns = ["method", f"error in %, {have}", f"as printed, all {first.protocol.n_clips}"]
    return ResultsTable("", columns, rows)


def methods(results: list[PublishedResult]) -> ResultsTable:
    """Make the table of all methods, best first; a column that would be empty is left out."""
    first, of = results[0], dict[str, dict[str, PublishedResult]]()
    for each in results:
        of.setdefault(each.title, {})[each.n_motions] = each
    order = sorted(of.items(), key=lambda item: _rank(item[1]))
    rows = {f"`{title}`": _cells(ways.get("given"), ways.get("found")) for title, ways in order}
    columns = [name for name in next(iter(rows.values())) if any(c[name] != ABSENT for c in rows.values())]
    title = f"{first.heading}: mean error in %, lower is better"
    cells = [[name, *(row[column] for column in columns)] for name, row in rows.items()]
    notes = [
        f"{each.row}: {count(each.failed, 'run')} failed, fully wrong" for each in results if each.failed
    ]
    absent = [f"`{name}`" for name in METHODS_OF_TABLES if name not in of]
    notes += [f"Not run yet: {', '.join(absent)}"] * bool(absent)
    return ResultsTable(title, ["method", *columns], cells, notes)


def _rank(ways: Mapping[str, PublishedResult]) -> tuple[bool, float]:
    first = ways.get("given") or ways["found"]
    return "given" not in ways, float(first.errors.mean())


def _cells(given: PublishedResult | None, found: PublishedResult | None) -> dict[str, str]:
    """One row, by column: the number of motions given, found, and as printed."""
    ways = [each for each in (given, found) if each]
    first, protocol, cells = ways[0], ways[0].protocol, {}
    clips, parts = list(first.clips), {g: protocol.clips_of(g, first.motions) for g in protocol.groups}
    for group, names in parts.items():
        if names and len(names) < len(clips):
            part = f"{group.title}, {share(len(names), group.n_clips)}"
            cells[part] = _mean(given.errors[[clips.index(name) for name in names]]) if given else ABSENT
    cells["number given"] = _mean(given.errors) if given else ABSENT
    cells["median"] = f"{100 * np.median(given.errors.mean(axis=1)):.2f}" if given else ABSENT
    known = protocol.of_version(first.dataset_version).published if given else {}
    printed = known.get(first.published, {}).get("all", {}).get("mean")
    cells[f"printed, all {protocol.n_clips}"] = ABSENT if printed is None else f"{printed:.2f}"
    cells["number found"] = _mean(found.errors) if found else ABSENT
    cells["right, %"] = f"{100 * found.right:.0f}" if found else ABSENT
    seeds = " / ".join(str(len(each.seeds)) for each in ways)
    return cells | {"seeds": seeds, "CPU s": f"{first.seconds:.1f}"}


def _mean(errors: np.ndarray) -> str:
    means = 100 * errors.mean(axis=0)
    return f"{means.mean():.2f}" + (f" ±{means.std(ddof=1):.2f}" if len(means) > 1 else "")


def clips_of_main(results: list[PublishedResult]) -> ResultsTable:
    """Make the table of every clip, of the methods of the paper and ours, two also with the number found."""
    wanted = {*ABOUT, "multibody", "subset, number found", "multibody, number found"}
    shown = {each.row: each.errors for each in results if each.row in wanted}
    return clip_table(f"{results[0].heading}: error in %, lower is better", shown, results[0].motions)


TABLES = {"methods": methods, "per-clip": clips_of_main, "short": short}


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
