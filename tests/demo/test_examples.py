"""Every example runs as a person would run it."""

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*.py"))
OUTPUT = {
    "segment_and_score.py": ("keradd", "error"),
    "track_a_folder.py": ("trajectories over 6 frames", "median error after one frame: 0."),
    "your_own_method.py": ("velocity: error",),
}


def test_every_example_is_here():
    assert [path.name for path in EXAMPLES] == sorted(OUTPUT)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example(path, tmp_path):
    done = subprocess.run([sys.executable, path], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    assert all(words in done.stdout for words in OUTPUT[path.name])
    assert not list(tmp_path.iterdir())
