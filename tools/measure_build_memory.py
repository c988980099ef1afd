"""Peak memory of building long clips: real frames, played to and fro until there are enough of them.

Usage: python tools/measure_build_memory.py FRAMES [--lengths 100 300 1000] [--flow dis]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import h5py

from kt3dmoseg.io.images import frame_paths
from kt3dmoseg.text import text_table

_MIB = 1 << 20


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("frames", type=Path, help="folder of a clip's frames")
    parser.add_argument("--lengths", type=int, nargs="+", default=[100, 300, 1000], help="numbers of frames")
    parser.add_argument("--flow", default="dis", help="optical flow (default: dis)")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows = [measure(given.frames, length, given.flow, Path(folder)) for length in given.lengths]
    print(text_table(rows, ("frames", "trajectories", "positions", "as (N, F, 2)", "peak memory")))


def measure(source: Path, length: int, flow: str, folder: Path) -> tuple[str, ...]:
    """Build a clip of that length in a process of its own; return a row of the table, sizes in MiB."""
    clip = _to_and_fro(source, length, folder / f"clip{length}")
    paths = ["--frames", str(clip), "-o", str(folder / "out"), "--annotations", "none", "--workers", "1"]
    # The frames repeat, so their flow fields do: with a cache the run takes minutes, not an hour.
    command = [*paths, "--flow", flow, "--cache", str(folder / "cache")]
    process = subprocess.Popen([sys.executable, "-m", "kt3dmoseg", "build", *command])
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise SystemExit("the build failed")
    with h5py.File(folder / "out" / f"clip{length}.h5") as file:
        visible, dense = file["dense/visible"], file["dense/xy"]
        points = sum(int(visible[k : k + 4096].sum()) for k in range(0, len(visible), 4096))
        sizes = (f"{points * 16 / _MIB:.0f} MiB", f"{dense.size * 8 / _MIB:.0f} MiB")
    return (str(length), str(len(visible)), *sizes, f"{usage.ru_maxrss / 1024:.0f} MiB")


def _to_and_fro(source: Path, length: int, folder: Path) -> Path:
    frames = frame_paths(source)
    folder.mkdir()
    period = 2 * (len(frames) - 1)
    for number in range(length):
        at = min(number % period, period - number % period)
        (folder / f"{number + 1:06d}.png").symlink_to(frames[at].resolve())
    return folder


if __name__ == "__main__":
    main()
