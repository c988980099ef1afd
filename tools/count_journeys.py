"""How many files of the packages three journeys call into: build one clip, score one submission, segment.

Usage: python tools/count_journeys.py [-v]

A file counts when any function in it is called, at import too; module and class bodies do not count.
Each journey runs in a process of its own, on a small synthetic drive made by `kt3dmoseg demo`.
"""

from __future__ import annotations

import argparse
import cProfile
import inspect
import json
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from types import CodeType, FrameType

ROOT = Path(__file__).resolve().parent.parent
MOST = {"build": 24, "score": 20, "segment": 14}
_CALLS = cProfile.Profile(builtins=False)
_DEMO = ("--width", "320", "--height", "128", "--frames", "6", "--runs", "1", "--methods", "one_motion")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("-v", "--verbose", action="store_true", help="list the files")
    parser.add_argument("--journey", choices=list(MOST), help=argparse.SUPPRESS)
    parser.add_argument("--demo", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.journey:
        print(json.dumps(files_of(lambda: JOURNEYS[arguments.journey](arguments.demo))))
        return 0
    with tempfile.TemporaryDirectory() as folder:
        demo = Path(folder) / "demo"
        _run("-m", "kt3dmoseg", "demo", "-o", str(demo), *_DEMO)
        over = [name for name in MOST if _report(name, demo, verbose=arguments.verbose) > MOST[name]]
    return 1 if over else 0


def files_of(journey: Callable[[], None]) -> list[str]:
    """Run a journey; return the files of both packages in which a function was called."""
    seen: set[CodeType] = set()

    def notice(frame: FrameType, *_: object) -> None:
        seen.add(frame.f_code)

    threading.setprofile(notice)
    _CALLS.enable()  # of this thread; it takes less time than a function that notices
    try:
        journey()
    finally:
        _CALLS.disable()
        threading.setprofile(None)
    seen |= {entry.code for entry in _CALLS.getstats() if isinstance(entry.code, CodeType)}
    functions = {Path(code.co_filename) for code in seen if code.co_flags & inspect.CO_OPTIMIZED}
    packages = [ROOT / "kt3dmoseg", ROOT / "mseg"]
    return sorted(str(p.relative_to(ROOT)) for p in functions if any(p.is_relative_to(q) for q in packages))


def build(demo: Path) -> None:
    """Build one clip from the command line, with one worker."""
    from kt3dmoseg.cli import main

    frames = sorted((demo / "frames").iterdir())[0]
    command = ["build", "--frames", str(frames), "-o", str(demo / "built"), "--workers", "1"]
    assert main([*command, "--annotations", str(demo / "annotations")]) == 0


def score(demo: Path) -> None:
    """Score one submission from the command line."""
    from mseg.cli import main

    assert main(["score", str(demo / "submissions" / "one_motion"), str(demo / "dataset")]) == 0


def segment(demo: Path) -> None:
    """Segment one clip with the subset-constrained fusion; loading it is no part of the journey."""
    import kt3dmoseg

    _CALLS.disable()
    clip = kt3dmoseg.load(sorted((demo / "dataset").glob("*.h5"))[0])
    _CALLS.enable()
    import mseg

    mseg.segment(clip, method="subset", n_motions=3)


JOURNEYS = {"build": build, "score": score, "segment": segment}


def _report(name: str, demo: Path, *, verbose: bool) -> int:
    output = _run(__file__, "--journey", name, "--demo", str(demo))
    files: list[str] = json.loads(output.splitlines()[-1])
    print(f"{name}: {len(files)} files (at most {MOST[name]})")
    if verbose:
        print("\n".join(f"  {file}" for file in files))
    return len(files)


def _run(*command: str) -> str:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    finished = subprocess.run(
        [sys.executable, *command], env=environment, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True
    )
    return finished.stdout


if __name__ == "__main__":
    raise SystemExit(main())
