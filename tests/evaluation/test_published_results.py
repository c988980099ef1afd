"""Results as data: what is in results/ is right and complete, and the pages show it."""

from __future__ import annotations

import importlib.util
import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from benchmark_result import benchmark_result

from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.files import write_bytes
from mseg.benchmark import BenchmarkResult, Configuration
from mseg.benchmark.publishing import (
    SCHEMA,
    PublishedResult,
    json_schema,
    publish,
    read_result,
    read_results,
)
from mseg.benchmark.site import write_site
from mseg.cli import main
from mseg.evaluation import load_protocol
from mseg.evaluation.statistics import bootstrap_mean

ROOT = Path(__file__).resolve().parents[2]
RESULTS = read_results(ROOT / "results")
FILES = sorted((ROOT / "results").glob("*/*/*.json"))
PAPER = {"affine", "homography", "fundamental", "keradd", "coreg", "subset"}
PAPER |= {f"{method}, number found" for method in PAPER}
SUBSET = Configuration("subset", {"alpha": 8})


@pytest.fixture(scope="module")
def tool():
    spec = importlib.util.spec_from_file_location("make_tables", ROOT / "tools" / "make_tables.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def run() -> BenchmarkResult:
    """Two methods on two clips with two seeds; the second failed once."""
    return benchmark_result(
        "kt3dmoseg",
        (Configuration("one_motion"), SUBSET),
        {"Seq005_Clip01": 3, "Seq013_Clip01": 2},
        [[[0.5, 0.5], [0.2, 0.2]], [[1 / 3, 0.0], [1.0, 0.1]]],
        seeds=(0, 4),
        scored=(6, 10),
        found=[[[1, 1], [1, 1]], [[3, 3], [0, 2]]],
        failed={("subset alpha=8", "Seq013_Clip01", 0): "no reason"},
    )


def test_the_schema_is_that_of_the_files():
    schema = json.loads((ROOT / "results" / SCHEMA).read_text())
    assert schema == json_schema()
    check = jsonschema.Draft202012Validator(schema)
    for path in FILES:
        check.validate(json.loads(path.read_text()))


def test_every_file_is_read():
    assert sum(map(len, RESULTS.values())) == len(FILES) > 0
    assert {path.relative_to(ROOT / "results") for path in FILES} == {
        r.path for g in RESULTS.values() for r in g
    }


@pytest.mark.parametrize("key", RESULTS, ids="/".join)
def test_every_dataset_has_every_method_with_enough_seeds(key, tool):
    ours = (each for each in RESULTS[key] if each.method in tool.METHODS_OF_TABLES)  # not submissions
    seeds = {each.row: len(each.seeds) for each in ours}
    finders = {r.method for g in RESULTS.values() for r in g if r.n_motions == "found"}
    found = {f"{each}, number found" for each in finders & {*tool.METHODS_OF_TABLES}}
    due = dict.fromkeys([*seeds, *tool.METHODS_OF_TABLES, *found], 3)
    due |= dict.fromkeys(PAPER | ({"multibody"} if key == ("kt3dmoseg", "2018") else set()), 10)
    due["alc"] = 1  # it draws nothing
    assert not [row for row, least in due.items() if seeds.get(row, 0) < least]


def test_the_release_is_complete_and_agrees_with_the_known_prevalence():
    protocol = load_protocol("kt3dmoseg")
    [baseline] = [each for each in RESULTS["kt3dmoseg", "2018"] if each.method == "one_motion"]
    assert set(baseline.clips) == set(protocol.versions["2018"])
    errors = dict(zip(baseline.clips, 100 * baseline.errors[:, 0], strict=True))
    assert errors == pytest.approx(protocol.prevalence, abs=0.005)


def test_the_clips_as_built_are_version_2_on_which_no_printed_figure_is_shown(tmp_path):
    protocol = load_protocol("kt3dmoseg")
    assert {*protocol.versions["2"]} == {*protocol.clips} == {*RESULTS["kt3dmoseg", "2"][0].clips}
    checksums = protocol.versions["2"]
    assert protocol.version_of(checksums) == "2"
    # Files from before the version had a name call it unnamed.
    contradicting = [v for v in ("2", "unnamed", "2018", "data-0") if protocol.contradicts(v, checksums)]
    assert contradicting == ["2018", "data-0"]
    for version in ("2", "2018"):
        name = Path("kt3dmoseg", version, "one_motion.json")
        write_bytes(tmp_path / name, (ROOT / "results" / name).read_bytes())
    page = write_site(tmp_path, tmp_path / "site").read_text()
    titles = re.findall(r"<h2 id='board-\d'>([^<]+)<", page)
    assert titles[:2] == ["KT3DMoSeg, version 2018", "KT3DMoSeg, version 2"]
    first, second = page.split("<section data-board=")[1:3]
    assert ("class='printed'" in first, "class='printed'" in second) == (True, False)


def test_the_pages_show_the_figures_of_the_files(tool):
    for path, text in tool.files().items():
        assert path.read_text() == text, f"{path.name}: run python tools/make_tables.py"


def test_the_figure_of_the_docs_shows_the_means_of_the_files():
    figure = (ROOT / "docs" / "figures" / "per_clip.svg").read_text()
    shown = re.findall(r">(\w+), mean ([\d.]+)<", figure)
    means = {r.title: r.errors.mean() for r in RESULTS["kt3dmoseg", "2018"] if r.n_motions == "given"}
    assert len(shown) == 4, "run python tools/make_reproduction_figures.py"
    assert all(mean == f"{100 * means[name]:.2f}" for name, mean in shown)


def test_figures_in_sentences_of_the_docs_are_those_of_the_files():
    given = [r.errors.mean(axis=1) for r in RESULTS["synth", "recipe-0000ce94"] if r.n_motions == "given"]
    best, second, *_ = sorted(given, key=np.mean)
    lead = 100 * (second - best)
    low, high = bootstrap_mean(lead)
    page = " ".join((ROOT / "docs" / "synthetic.md").read_text().split())
    assert f"errs by {lead.mean():.1f} points less than the next method" in page
    assert f"(95 % over drives: {low:.1f} to {high:.1f})" in page


def test_the_table_of_all_methods_has_both_numbers_of_motions(tool):
    [row] = [row for row in tool.methods(RESULTS["kt3dmoseg", "2018"]).rows if row[0] == "`multibody`"]
    way = {each.n_motions: each for each in RESULTS["kt3dmoseg", "2018"] if each.title == "multibody"}
    assert row[1].startswith(f"{100 * way['given'].errors.mean():.2f} ±")
    assert row[4].startswith(f"{100 * way['found'].errors.mean():.2f} ±")
    assert (row[3], row[6]) == ("-", "10 / 10")


def test_every_published_dataset_is_on_the_page():
    shown = re.findall(r"<!-- table: ([\w-]+) (\S+) (\S+) -->", (ROOT / "docs" / "results.md").read_text())
    assert {("methods", *key) for key in RESULTS} <= set(shown)


def test_a_changed_figure_changes_the_table(tool):
    text = "<!-- table: methods kt3dmoseg 2018 -->\nold\n<!-- end of table -->\nrest"
    made = tool.filled(text, RESULTS)
    assert "old" not in made
    assert made.endswith("<!-- end of table -->\nrest")
    first = RESULTS["kt3dmoseg", "2018"][0]
    clips = {
        name: clip.model_copy(update={"wrong": [0] * len(clip.wrong)}) for name, clip in first.clips.items()
    }
    changed = {("kt3dmoseg", "2018"): [first.model_copy(update={"clips": clips})]}
    assert "| 0.00 ±0.00 | 0.00 |" in tool.filled(text, changed)
    with pytest.raises(SystemExit, match="no table 'methods' of results/kt3dmoseg/none"):
        tool.filled(text.replace("2018", "none"), RESULTS)


def test_what_is_published_is_what_was_measured(run, tmp_path, tool):
    paths = publish(run, tmp_path)
    assert [path.relative_to(tmp_path).as_posix() for path in paths] == [
        "kt3dmoseg/2018/one_motion.json",
        "kt3dmoseg/2018/subset-alpha=8.json",
    ]
    read = read_result(paths[1])
    assert read.errors.tolist() == run.errors[1].tolist()
    assert read.motions == run.motions
    assert read.seeds == [0, 4]
    assert read.parameters["alpha"] == "8.0"
    assert read.clips["Seq013_Clip01"].failures == {"0": "no reason"}
    assert read.seconds == pytest.approx(0.25)
    table = tool.methods([read])
    assert table.columns == ["method", "number given", "median", "printed, all 22", "seeds", "CPU s"]
    assert table.rows == [["`subset alpha=8`", "35.83 ±43.60", "35.83", "8.08", "2", "0.2"]]
    assert table.notes[0] == "subset alpha=8: 1 run failed, fully wrong"
    assert table.notes[1].startswith("Not run yet: `one_motion`, `affine`")
    clips = tool.clips_of_main([read.model_copy(update={"title": "subset"})])
    assert [row[-1] for row in clips.rows] == ["16.67 ±23.57", "55.00 ±63.64", "35.83 ±43.60", "35.83"]


def test_rows_with_the_number_given_and_found_are_kept_apart(run, tmp_path, tool):
    publish(run, tmp_path)
    publish(replace(run, number="found"), tmp_path)
    [results] = read_results(tmp_path).values()
    assert [r.row for r in results[2:]] == ["one_motion, number found", "subset alpha=8, number found"]
    table = tool.methods(results)
    rows = {row[0]: dict(zip(table.columns, row, strict=True)) for row in table.rows}
    found = rows["`subset alpha=8`"]
    assert (found["number given"], found["number found"], found["right, %"]) == (
        "35.83 ±43.60",
        "35.83 ±43.60",
        "75",
    )


def test_publishing_again_writes_the_same_bytes_and_loses_nothing(run, tmp_path):
    [path, _] = publish(run, tmp_path)
    before = path.read_bytes()
    publish(run, tmp_path)
    assert path.read_bytes() == before
    tables = tuple(replace(t, clips=tuple(c for c in t.clips if c.seed == 0)) for t in run.tables)
    one = replace(run, tables=tables, seconds=run.seconds[..., :1])
    with pytest.raises(InvalidValueError, match="4 there only; run all of them, or remove the file"):
        publish(one, tmp_path)
    assert path.read_bytes() == before


def test_a_run_whose_worker_died_is_not_published(run, tmp_path):
    run.seconds[1, 0, 0] = np.nan
    with pytest.raises(
        InvalidValueError, match=r"subset alpha=8: expected every run, found workers that died"
    ):
        publish(run, tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"scored": 6', '"scored": 1', "clips.Seq005_Clip01.wrong: expected at most 1, found 3"),
        ('"wrong": [3, 3]', '"wrong": [3]', "Seq005_Clip01: expected 2 figures, one per seed"),
        ('"wrong": [3, 3]', '"wrong": [3, -1]', "clips.Seq005_Clip01.wrong.1"),
        ('"wrong": [3, 3]', '"wrong": [3, 2.5]', "clips.Seq005_Clip01.wrong.1"),
        ("Seq005_Clip01", "Seq006_Clip01", "Seq006_Clip01: expected a clip of KT3DMoSeg"),
        ('"benchmark": "kt3dmoseg"', '"benchmark": "kt3d"', "benchmark: expected"),
        ('"dataset_version": "2018"', '"dataset_version": "../2018"', "dataset_version"),
        ('"seeds"', '"seed"', "seed"),
        ("mseg-result", "mseg-scores", "format"),
    ],
)
def test_a_wrong_file_is_refused_with_its_field(run, tmp_path, old, new, message):
    path = publish(run, tmp_path)[0]
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(FileFormatError, match=message) as error:
        read_results(tmp_path)
    assert "\n" not in str(error.value)


def test_results_of_other_data_are_not_mixed(run, tmp_path):
    publish(run, tmp_path)
    path = tmp_path / "kt3dmoseg" / "2018" / "subset-alpha=8.json"
    text = path.read_text()
    path.write_text(text.replace("a" * 64, "b" * 64))
    with pytest.raises(FileFormatError, match=r"expected the clips of kt3dmoseg/2018/one_motion\.json"):
        read_results(tmp_path)
    path.write_text(text)
    path.rename(path.with_name("coreg.json"))
    with pytest.raises(FileFormatError, match=r"expected the name kt3dmoseg/2018/subset-alpha=8\.json"):
        read_results(tmp_path)
    with pytest.raises(InputFileError, match="expected results"):
        read_results(tmp_path / "nothing")


def test_results_of_other_data_are_not_published_next_to_them(run, tmp_path):
    publish(run, tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*.json")}
    other = tuple(replace(t, provenance=replace(t.provenance, dataset_sha256="b" * 64)) for t in run.tables)
    with pytest.raises(
        InvalidValueError, match=r"one_motion\.json: .*found other clips or labels, called 2018"
    ):
        publish(replace(run, tables=other), tmp_path)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*.json")} == before


def test_results_of_one_recipe_may_differ_in_rounding_but_not_in_clips(run, tmp_path):
    tables = tuple(
        replace(t, provenance=replace(t.provenance, dataset_version="recipe-12345678")) for t in run.tables
    )
    first, path = publish(replace(run, tables=tables), tmp_path)
    text = path.read_text()
    path.write_text(text.replace("a" * 64, "b" * 64))
    [results] = read_results(tmp_path).values()
    assert len({result.dataset_sha256 for result in results}) == 2
    path.write_text(text.replace('"motions": 3', '"motions": 2'))
    with pytest.raises(FileFormatError, match=f"expected the clips of .*{first.name}"):
        read_results(tmp_path)


def test_the_command_publishes(data_of_two_clips, tmp_path, capsys):
    line = [
        "benchmark",
        "kt3dmoseg",
        "--data",
        str(data_of_two_clips),
        "--methods",
        "one_motion",
        "--no-cache",
    ]
    assert main([*line, "--quiet", "--publish", str(tmp_path)]) == 0
    assert "wrote " in capsys.readouterr().err
    [(key, [result])] = read_results(tmp_path).items()
    assert key[0] == "kt3dmoseg"
    assert re.fullmatch("data-[0-9a-f]{8}", key[1])  # of no known version
    assert isinstance(result, PublishedResult)
    assert {name: (clip.scored, clip.wrong, clip.found) for name, clip in result.clips.items()} == {
        "Seq005_Clip01": (4, [1], [1]),
        "Seq013_Clip01": (4, [1], [1]),
    }


def test_what_cannot_be_printed_is_published_all_the_same(data_of_two_clips, tmp_path):
    line = ["benchmark", "kt3dmoseg", "--methods", "one_motion", "--no-cache", "--publish", str(tmp_path)]
    command = [sys.executable, "-m", "mseg", *line, "--data", str(data_of_two_clips)]
    with open("/dev/full", "w") as full:
        assert subprocess.run(command, stdout=full, check=False).returncode == 2
    assert len(read_results(tmp_path)) == 1


@pytest.fixture
def data_of_two_clips(tmp_path_factory):
    """Each with five evaluated trajectories, one of them unlabelled."""
    from kt3dmoseg.io import save
    from kt3dmoseg.types import Clip, Labels, Trajectories

    folder = tmp_path_factory.mktemp("data")
    for name in ("Seq005_Clip01", "Seq013_Clip01"):
        xy = np.random.default_rng(0).uniform(0, 50, size=(5, 3, 2))
        tracks = Trajectories(xy, np.ones((5, 3), dtype=bool))
        save(Clip(name, tracks, np.arange(5), Labels(np.array([1, 1, 1, 2, 0]))), folder / f"{name}.h5")
    return folder
