"""The bundle's scoring program, run in the folders that Codabench makes."""

import importlib.util
import io
import json
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from evaluation_helpers import CLIPS, NAMES, perfect

import kt3dmoseg

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def tool():
    spec = importlib.util.spec_from_file_location(
        "make_codabench_bundle", ROOT / "tools" / "make_codabench_bundle.py"
    )
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def app(tool, tmp_path):
    """What a worker finds under /app: the program, the reference data, an unpacked submission."""
    for name, clip in CLIPS.items():
        kt3dmoseg.save(clip, tmp_path / "data" / f"{name}.h5")
    assert tool.main([str(tmp_path / "data"), "-o", str(tmp_path / "bundle.zip")]) == 0
    app = tmp_path / "app"
    with zipfile.ZipFile(tmp_path / "bundle.zip") as bundle:
        for inner, folder in (("scoring_program.zip", "program"), ("reference_data.zip", "input/ref")):
            zipfile.ZipFile(io.BytesIO(bundle.read(inner))).extractall(app / folder)
    perfect(app / "input" / "res")
    (app / "output").mkdir()
    return app


def score(app):
    command = [sys.executable, "score.py", str(app / "input"), str(app / "output")]
    return subprocess.run(command, cwd=app / "program", capture_output=True, text=True, check=False)


def test_scores_and_details(app):
    done = score(app)
    assert done.returncode == 0, done.stderr
    scores = json.loads((app / "output" / "scores.json").read_text())
    assert scores["error"] == scores["failed"] == 0
    assert scores["nmi"] == pytest.approx(100)
    page = (app / "output" / "detailed_results.html").read_text()
    assert "<canvas" not in page  # participants do not get to see the labels
    assert "Confusion" not in page


def test_program_imports_nothing_but_the_copies_in_the_bundle(app):
    """Without the package installed: here, modules that the bundle lacks would come from the checkout."""
    code = """
import pathlib, runpy, sys
sys.argv[1:] = ["../input", "../output"]
try:
    runpy.run_path("score.py", run_name="__main__")
except SystemExit as stopped:
    assert not stopped.code
ours = {n: m.__file__ for n, m in sys.modules.items() if n.partition(".")[0] in ("kt3dmoseg", "mseg")}
print([n for n, file in ours.items() if not pathlib.Path(file).is_relative_to(pathlib.Path.cwd())])
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=app / "program", capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_rejected_with_every_problem_on_the_log(app):
    (app / "input" / "res" / f"{NAMES[0]}.csv").write_text("track,label\n1,1.5\n")
    done = score(app)
    assert done.returncode == 1
    assert "1. [float]" in done.stderr
    assert not (app / "output" / "scores.json").exists()


def test_missing_clip_is_fully_wrong(app):
    (app / "input" / "res" / f"{NAMES[0]}.csv").unlink()
    assert score(app).returncode == 0
    scores = json.loads((app / "output" / "scores.json").read_text())
    assert (scores["error"], scores["failed"]) == (50, 1)


def test_usage(app):
    done = subprocess.run(
        [sys.executable, "score.py"], cwd=app / "program", capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "usage" in done.stderr


def test_competition_file(tool, tmp_path):
    for name, clip in CLIPS.items():
        kt3dmoseg.save(clip, tmp_path / "data" / f"{name}.h5")
    one = tool.make_bundle(str(tmp_path / "data"), "", "python:3.12")
    assert one == tool.make_bundle(str(tmp_path / "data"), "", "python:3.12")
    with zipfile.ZipFile(io.BytesIO(one)) as bundle:
        lines = bundle.read("competition.yaml").decode().splitlines()
        names = bundle.namelist()
    fields = {line.split(":", 1)[0]: json.loads(line.split(":", 1)[1]) for line in lines}
    assert fields["version"] == 2
    assert {fields["image"], fields["terms"]} <= set(names)
    assert fields["tasks"][0]["scoring_program"] in names
    assert fields["tasks"][0]["reference_data"] in names
    columns = fields["leaderboards"][0]["columns"]
    assert [c["index"] for c in columns] == list(range(len(columns)))
    assert (columns[0]["key"], columns[0]["sorting"]) == ("error", "asc")
    assert tool.main([str(tmp_path / "none"), "-o", str(tmp_path / "b.zip")]) == 2
