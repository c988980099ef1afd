"""What the README promises to a newcomer works."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import matplotlib as mpl
import numpy as np
import stopwatch
from matplotlib import pyplot

import kt3dmoseg
from kt3dmoseg.cli import COMMANDS as DATA_COMMANDS
from mseg.cli import COMMANDS as METHOD_COMMANDS
from mseg.cli import main as mseg_main

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text()

mpl.use("agg")


def two_motions() -> kt3dmoseg.Clip:
    """Eighty points at random depths in six frames, half of which move to the other side."""
    rng, label = np.random.default_rng(0), np.repeat([1, 2], 40)
    steps = np.where(label == 1, 1.0, -2.0) * rng.uniform(1, 2, 80)
    start, direction = rng.uniform(50, 200, (80, 1, 2)), np.array([1.0, 0.2])
    xy = start + np.arange(6)[:, None] * steps[:, None, None] * direction + rng.normal(0, 0.05, (80, 6, 2))
    tracks = kt3dmoseg.Trajectories(xy, np.ones((80, 6), dtype=bool))
    return kt3dmoseg.Clip("Seq005_Clip01", tracks, np.arange(80), kt3dmoseg.Labels(label, background=1))


def test_the_lines_of_python_run(tmp_path, monkeypatch, capsys):
    [block] = re.findall(r"^```python\n(.*?)^```", README, re.MULTILINE | re.DOTALL)
    assert len(block.splitlines()) == 5
    [file] = re.findall(r'load\("(.*?)"\)', block)
    monkeypatch.chdir(tmp_path)
    Path(file).parent.mkdir(parents=True)
    kt3dmoseg.save(two_motions(), file)
    exec(block, {})
    pyplot.close("all")
    assert re.search(r"^error +0\.\d+$", capsys.readouterr().out, re.MULTILINE)


def test_a_newcomer_gets_a_scored_submission_and_a_report_in_ten_commands(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    kt3dmoseg.save(two_motions(), "data/kt3dmoseg/release/Seq005_Clip01.h5")  # what fetch-release downloads
    commands = re.findall(r"`mseg ([^`]*data/kt3dmoseg/release[^`]*)`", README)
    names = [command.split()[0] for command in commands]
    assert names[:5] == ["run", "example-submission", "validate", "score", "compare"]
    walked = stopwatch.commands(README)  # tools/stopwatch.py walks and times them in a new clone
    assert 1 + len(walked) <= 10
    assert walked[-1].split()[:2] == ["mseg", names[names.index("report")]] == ["mseg", "report"]
    for command in commands:
        assert mseg_main(command.split()) == 0, command
    printed = capsys.readouterr().out
    assert "classification error in %" in printed
    assert "<html" in Path("report.html").read_text()


def test_the_extra_that_is_installed_exists():
    [extra] = re.findall(r"pip install '\.\[(\w+)\]'", README)
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert extra in extras


def test_every_command_is_found_from_the_readme():
    shown = set(re.findall(r"`(kt3dmoseg|mseg) ([a-z-]+)", README))
    every = {("kt3dmoseg", name) for name in DATA_COMMANDS} | {("mseg", name) for name in METHOD_COMMANDS}
    assert every - shown <= {
        ("kt3dmoseg", "catalog"),
        ("kt3dmoseg", "locate"),
    }  # what maintainers of clips run
