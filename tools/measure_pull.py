"""Measure kt3dmoseg pull: the 22 clips from a local server, clean, with faults, and a second time.

Usage: python tools/measure_pull.py DATA, where DATA holds kt3dmoseg/frames. Assembles the 15 drives with
the clips at random numbers and with directories as large as KITTI's, serves them on the loopback address
with the tests' server, runs `kt3dmoseg pull` as a process of its own and prints traffic and memory.
"""

from __future__ import annotations

import random
import re
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests" / "kitti"))

import kitti_drives as drives  # noqa: E402
from kitti_server import FaultyServer, serving  # noqa: E402

from kt3dmoseg import catalog  # noqa: E402
from kt3dmoseg.catalog import Drive, Entry  # noqa: E402
from kt3dmoseg.kitti.archives import frames_of  # noqa: E402

# Bytes of KITTI's _sync.zip files; a frame with its laser scan and four pictures takes 4.19 MB.
SIZES = {
    5: 645_940_900, 9: 1_791_264_044, 11: 939_815_328, 13: 630_044_598, 20: 367_093_728,
    28: 1_907_576_425, 59: 1_517_489_971, 70: 1_759_098_358, 84: 1_574_584_300, 95: 1_097_371_915,
    113: 372_444_404, 37: 369_717_988, 38: 451_849_097, 45: 173_725_652, 71: 4_337_332_333,
}  # fmt: skip
BYTES_PER_FRAME = 4.19e6
EXTRA = bytes.fromhex("555405000300000000") + bytes.fromhex("75780b000104e803000004e8030000")


def assemble(drive: Drive, clips: list[Entry], data: Path, rng: random.Random, path: Path) -> None:
    """Write a drive's zip: the clips at random numbers, everything else empty but named as KITTI does."""
    n = round(SIZES[drive.number] / BYTES_PER_FRAME)
    frames: dict[int, bytes] = {}
    for clip, first in zip(clips, random_firsts([clip.length for clip in clips], n, rng), strict=True):
        files = sorted((data / "kt3dmoseg/frames" / clip.name).glob("*.png"))
        frames |= {first + k: file.read_bytes() for k, file in enumerate(files)}
    contents = drives.drive_files(
        {k: frames.get(k, b"") for k in range(n)}, n, drive=drive.number, date=drive.date
    )
    folder = drive.folder
    for sensor in ("image_01", "image_02", "image_03", "velodyne_points"):
        contents |= {f"{folder}/{sensor}/data/{k:010d}.bin": b"" for k in range(n)}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in sorted(contents.items()):
            info = zipfile.ZipInfo(name)
            info.extra = EXTRA
            archive.writestr(info, content)


def random_firsts(lengths: list[int], n: int, rng: random.Random) -> list[int]:
    """Random first frames of clips in a drive, which do not overlap."""
    while True:
        firsts = [rng.randrange(n - length) for length in lengths]
        used = [
            k for first, length in zip(firsts, lengths, strict=True) for k in range(first, first + length)
        ]
        if len(set(used)) == len(used):
            return firsts


def serve_all(server: FaultyServer, data: Path, folder: Path) -> None:
    rng, by_drive = random.Random(0), dict[Drive, list[Entry]]()
    for clip in catalog.load().values():
        by_drive.setdefault(clip.drive, []).append(clip)
    for drive, clips in by_drive.items():
        path = folder / "drive.zip"
        assemble(drive, clips, data, rng, path)
        server.files[frames_of(drive).zip] = path.read_bytes()
        calibration = drives.write_zip(folder / "calib.zip", drives.calibration_files(drive.date))
        server.files[f"{drive.date}_calib.zip"] = calibration.read_bytes()


def faults(rate: float, seed: int) -> Callable[[int, str], str]:
    rng = random.Random(seed)
    kinds = ["drop", "500", "503", "cut", "flip", "short"]
    return lambda count, path: rng.choice(kinds) if rng.random() < rate else ""


def run(server: FaultyServer, root: Path, title: str) -> None:
    server.reset()
    arguments = ["pull", "-o", str(root), "--accept-license", "--mirror", server.url, "--wait", "0"]
    code = "import atexit; atexit.register(lambda: print(open('/proc/self/status').read()));"
    code += f"import sys; from kt3dmoseg import cli; sys.exit(cli.main({arguments!r}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    peak = re.search(r"VmHWM:\s+(\d+) kB", done.stdout)
    frames = sum(path.stat().st_size for path in root.rglob("*.png"))
    last = done.stderr.strip() or next(line for line in done.stdout.splitlines() if "complete" in line)
    sent = f"sent {server.sent / 1e6:.2f} MB ({server.sent / frames:.3f}), {len(server.requests)} requests"
    memory = f"peak {int(peak[1]) / 1e3 if peak else 0:.0f} MB"
    print(f"{title}: frames {frames / 1e6:.2f} MB, {sent}, {memory}\n  {last}")


def main() -> int:
    if len(sys.argv) != 2:
        print(__doc__)
        return 2
    with serving() as server, tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        serve_all(server, Path(sys.argv[1]), folder)
        run(server, folder / "clean", "clean")
        run(server, folder / "clean", "again")
        for seed in range(3):
            server.fault = faults(0.3, seed)
            run(server, folder / f"faulty{seed}", f"30 % of requests failing, seed {seed}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
