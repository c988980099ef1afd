"""Compiled loops."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
from numba.core import caching

from kt3dmoseg.compiled import compiled


def test_of_processes_that_start_together_one_compiles_and_the_others_load(tmp_path):
    source = "from kt3dmoseg.compiled import compiled\n\n@compiled\ndef halve(x):\n    return x / 2\n"
    source += "\n@compiled\ndef quarter(x):\n    return halve(halve(x))\n"
    (tmp_path / "loops.py").write_text(source)
    code = "import loops; print(loops.quarter(6.0), len(loops.quarter.stats.cache_misses))"
    command = [sys.executable, "-c", code]
    started = [subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    answers = sorted(process.communicate(timeout=100)[0].split() for process in started)
    assert answers == [["1.5", "0"], ["1.5", "1"]]


def test_where_no_folder_can_be_written_the_process_compiles_for_itself(monkeypatch):
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])

    @compiled
    def invert(x):
        return 1 / x

    assert invert(0.0) == np.inf
