"""The page that reproduces the paper's table."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmark_result import benchmark_result

from mseg import methods
from mseg.benchmark import Configuration
from mseg.evaluation import load_protocol
from mseg.evaluation.results import published_name


@pytest.fixture(scope="module")
def tool():
    path = Path(__file__).parents[2] / "tools" / "reproduce_table1.py"
    spec = importlib.util.spec_from_file_location("reproduce_table1", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_our_figures_are_next_to_the_published_ones(tool):
    configurations = (Configuration("lsa"), Configuration("ssc", {"alpha": "20"}), Configuration("lrssc"))
    errors = np.array([[[0.1, 0.3], [0.0, 0.0]], [[0.0, 0.0], [0.5, 0.5]], [[1.0, 1.0], [0.0, 0.0]]])
    failed = {("lrssc", "arm", seed): "no reason" for seed in (0, 1)}
    result = benchmark_result("hopkins155", configurations, {"arm": 2, "2RT3RC": 3}, errors, failed=failed)
    result = replace(result, seconds=np.full((3, 2, 2), 0.5))
    table = tool.comparison(result)
    rows = {row[0]: row for row in table.rows}
    assert table.columns[:5] == [
        "method",
        "2 motions (1 of 120)",
        "published",
        "3 motions (1 of 35)",
        "published",
    ]
    assert rows["lsa"][1:3] == ["20.00 ± 14.14", "4.23"]
    assert rows["ssc alpha=20"][3:5] == ["50.00 ± 0.00", "4.40"]
    assert rows["lsa"][-2:] == ["0.50", "0"]
    assert rows["lrssc"][2] == "-"
    assert rows["lrssc"][-1] == "1"
    assert "153 of 155 sequences are missing." in table.notes
    assert "lrssc failed on arm: no reason." in table.notes
    assert any("0.1 CPU minutes per seed" in note for note in table.notes)


def test_published_names_are_found():
    protocol = load_protocol("hopkins155")
    found = {method: published_name(protocol, method) for method in methods.list()}
    assert {name for name in found.values() if name} == set(protocol.published)
    assert found["tlinkage"] == "T-Linkage"
    assert found["lrssc"] == ""
    assert published_name(load_protocol("kt3dmoseg"), "one_motion") == "prevalence"


def test_published_rows_follow_ours():
    result = benchmark_result("hopkins155", (Configuration("tlinkage"),), {"arm": 2}, np.zeros((1, 1, 2)))
    assert [row[0] for row in result.summary().rows] == ["tlinkage", "printed T-Linkage (all 155)"]


@pytest.mark.data
def test_the_whole_page(tool, data_root, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("KT3DMOSEG_DATA", str(data_root))
    page, cache = tmp_path / "page.md", tmp_path / "cache"
    command = [
        "--benchmarks",
        "hopkins12",
        "--methods",
        "one_motion",
        "ransac:threshold=1e-5",
        "--workers",
        "1",
    ]
    command += ["--seeds", "2", "--cache", str(cache), "--write", str(page)]
    assert tool.main(command) == 0
    text = page.read_text()
    assert "ransac threshold=1e-05" in text or "ransac threshold=1e-5" in text
    assert "4 of 12 sequences are missing" in text
    written = {file: file.stat().st_mtime_ns for file in cache.iterdir()}
    assert tool.main(command) == 0
    assert page.read_text() == text
    assert {file: file.stat().st_mtime_ns for file in cache.iterdir()} == written
    assert tool.main([*command, "--methods", "ramsac"]) == 2
    assert "ransac" in capsys.readouterr().err
