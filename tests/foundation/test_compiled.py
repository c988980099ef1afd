"""Compiled loops are compiled once, whoever starts at the same time, and work where nothing can be kept."""

import subprocess
import sys

import numpy as np

from kt3dmoseg.compiled import compiled

MODULE = """
from kt3dmoseg.compiled import compiled

@compiled
def inner(x):
    return 2 * x

@compiled
def outer(x):
    return inner(x) + 1
"""
CALL = "import module; print(module.outer(3), sum(module.outer.stats.cache_misses.values()))"


def test_of_processes_that_start_together_one_compiles(tmp_path):
    (tmp_path / "module.py").write_text(MODULE)
    command = [sys.executable, "-c", CALL]
    started = [subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    assert sorted(process.communicate(timeout=100)[0].split() for process in started) == [
        ["7", "0"],
        ["7", "1"],
    ]


def test_without_a_folder_to_keep_it_in_code_is_compiled_all_the_same():
    names = {"compiled": compiled}
    exec("@compiled\ndef inverse(x):\n    return 1 / x", names)  # as if typed: it has no file
    with np.errstate(divide="ignore"):
        assert names["inverse"](0.0) == np.inf
