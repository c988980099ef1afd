"""How much faster two workers build clips than one: wall time, in one run on one machine.

python benchmarks/bench_build.py FRAMES [CLIP ...]
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from kt3dmoseg.pipeline import build_dataset, find_sources


def seconds(sources, workers: int) -> float:
    with tempfile.TemporaryDirectory() as output:
        start = time.perf_counter()
        outcomes = build_dataset(sources, output, workers=workers)
        spent = time.perf_counter() - start
    failed = [outcome.reason for outcome in outcomes if outcome.status != "built"]
    if failed:
        raise SystemExit(failed[0])
    return spent


def main(frames: str, *clips: str) -> None:
    sources = [source for source in find_sources(Path(frames)) if not clips or source.name in clips]
    one, two = seconds(sources, 1), seconds(sources, 2)
    print(f"{len(sources)} clips: 1 worker {one:.1f} s, 2 workers {two:.1f} s, ratio {one / two:.2f}")


if __name__ == "__main__":
    main(*sys.argv[1:])
