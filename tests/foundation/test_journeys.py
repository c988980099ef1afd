"""The three journeys through the packages stay as short as docs/architecture.md draws them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

TOOL = Path(__file__).resolve().parents[2] / "tools" / "count_journeys.py"


def test_each_journey_calls_into_few_files():
    finished = subprocess.run([sys.executable, TOOL], capture_output=True, text=True)
    assert finished.returncode == 0, finished.stdout + finished.stderr
