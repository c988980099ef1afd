"""Mutated submissions: whatever is handed in, the validator answers, quickly, and writes nothing.

``python tests/evaluation/submission_fuzz.py 10000`` runs the full number (a second number is the first
seed) in separate processes, so that a crash or a hang of a C library would be seen; the test suite
runs a small sample.
"""

from __future__ import annotations

import io
import shutil
import stat
import struct
import subprocess
import sys
import tempfile
import time
import warnings
import zipfile
from functools import cache
from pathlib import Path

import numpy as np

from kt3dmoseg.errors import KT3DMoSegError
from mseg.evaluation import SubmissionMeta, score_submission, validate_submission, write_submission
from mseg.evaluation.example import made_up_clips
from mseg.evaluation.scoring import score_validated

CLIPS = made_up_clips()
BATCH = 500
SLOW_SECONDS = 10.0
_NAMES = ["../evil.csv", "/tmp/evil.csv", "C:\\evil.csv", "a/b/c/d/e/f.csv", "example_two.CSV", "\x00.csv"]
_NAMES += ["seed-0/example_two.csv", "seed-x/example_two.csv", "EXAMPLE_two.csv", "meta.toml/x.csv", ".csv"]
_NAMES += [
    "seed-99999999999999999999/example_two.csv",
    "example_two.npy",
    "__MACOSX/._example_two.csv",
    "a" * 300,
]
_CELLS = [
    "nan",
    "inf",
    "1e999",
    "-1",
    "2.0",
    "",
    "x",
    "1_0",
    "0",
    "9" * 30,
    "９",
    "1;2",
    "1,2,3",
    "=cmd()",
    "\x00",
]
_META = [
    "format_version = 9",
    "seconds = nan",
    "seconds = -1",
    "authors = 3",
    'method = ""',
    "x = 1",
    "[a",
    "\xff",
]
_META += [
    "a = " + "[" * 2000,
    'benchmark = "hopkins"',
    'fingerprints = "x"',
    "outliers = 1",
    "seconds = 1" + "0" * 5000,
    "a" + ".a" * 20_000 + " = 1",
    "[" + "a." * 20_000 + "a]",
    "a = " + "{a = " * 5000,
]


@cache
def base_files(kind: str, seeds: int) -> dict[str, bytes]:
    """Make the files of a valid submission."""
    rng = np.random.default_rng(seeds)
    labels = {n: rng.integers(1, 4, len(c.evaluated)) for n, c in CLIPS.items()}
    runs = labels if seeds == 1 else dict.fromkeys(range(seeds), labels)
    with tempfile.TemporaryDirectory() as folder:
        write_submission(folder, CLIPS.values(), runs, SubmissionMeta("fuzz"), format=kind)
        root = Path(folder)
        return {
            p.relative_to(root).as_posix(): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()
        }


def mutate_files(files: dict[str, bytes], rng: np.random.Generator) -> None:
    """Change the content or the name of a file."""
    name = sorted(files)[rng.integers(len(files))] if files else "meta.toml"
    content = files.get(name, b"")
    choice = rng.integers(len(_CONTENTS) + 5)
    if choice < len(_CONTENTS):
        files[name] = _CONTENTS[choice](content, rng)
    elif choice == len(_CONTENTS):
        files.pop(name, None)
    elif choice == len(_CONTENTS) + 1:
        files[_NAMES[rng.integers(len(_NAMES))]] = files.pop(name, b"")
    elif choice == len(_CONTENTS) + 2:
        line = _META[rng.integers(len(_META))].encode("latin-1")
        files["meta.toml"] = line + b"\n" + files.get("meta.toml", b"")
    elif choice == len(_CONTENTS) + 3:
        files[name.rpartition(".")[0] + ".failed"] = b"\xff\x00 reason \n" * int(rng.integers(0, 9))
    else:
        files[f"top/{name}"] = content


def _other_cell(content: bytes, rng: np.random.Generator) -> bytes:
    rows = content.decode("utf-8", "replace").split("\n")
    row = rng.integers(len(rows))
    rows[row] = rows[row].split(",")[0] + "," + _CELLS[rng.integers(len(_CELLS))]
    return "\n".join(rows).encode("utf-8", "replace")


def _transposed(content: bytes, rng: np.random.Generator) -> bytes:
    columns = zip(*(line.split(b",") for line in content.split(b"\n")), strict=False)
    return b"\n".join(b",".join(column) for column in columns)


def _repeated(content: bytes, rng: np.random.Generator) -> bytes:
    return content * int(rng.integers(2, 4))


def _noise(content: bytes, rng: np.random.Generator) -> bytes:
    return bytes(rng.integers(0, 256, rng.integers(0, 300), dtype=np.uint8))


def _other_array(content: bytes, rng: np.random.Generator) -> bytes:
    arrays = (
        {"track": np.arange(5), "label": np.array([None, {}], dtype=object)},
        {"track": np.arange(6).reshape(2, 3), "label": np.arange(6).reshape(2, 3)},
        {"labels": np.arange(5)},
        {"track": np.arange(5.0), "label": np.array([1, 2, np.nan, 1, 1])},
        {"track": np.array(["a", "b"]), "label": np.array([1, 2])},
        {"track": np.zeros((), np.int64), "label": np.zeros(0, np.int64)},
        {"track": np.arange(3), "label": np.array([2**63 - 1, -(2**63), 0])},
        {"track": np.array([2**64 - 1, 1], dtype=np.uint64), "label": np.array([1, 1j])},
    )
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays[rng.integers(len(arrays))])
    return buffer.getvalue()


def flip(content: bytes, rng: np.random.Generator) -> bytes:
    """Flip, drop, insert or repeat bytes."""
    if not content:
        return b"\x00"
    data = bytearray(content)
    for _ in range(int(rng.integers(1, 8))):
        at = int(rng.integers(len(data))) if data else 0
        choice = rng.integers(5)
        if choice <= 1 and data:
            data[at] = int(rng.integers(256))
        elif choice == 2:
            del data[at : at + int(rng.integers(1, 40))]
        elif choice == 3:
            data[at:at] = bytes(rng.integers(0, 256, 3, dtype=np.uint8))
        else:
            data[at:at] = data[at : at + 50]
    return bytes(data)


_CONTENTS = (_other_array, _other_cell, _transposed, _repeated, _noise, flip, flip)


def pack(files: dict[str, bytes], rng: np.random.Generator) -> bytes:
    """Zip the files, sometimes with links, duplicates, bombs or lies about sizes."""
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # zipfile warns of duplicate names, which are the point
        with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in files.items():
                info = zipfile.ZipInfo(name)
                info.compress_type = zipfile.ZIP_DEFLATED
                if rng.random() < 0.02:
                    info.external_attr = (stat.S_IFLNK | 0o777) << 16
                    content = b"/etc/passwd"
                archive.writestr(info, content)
                if rng.random() < 0.02:
                    archive.writestr(info, content)
            if rng.random() < 0.02:
                archive.writestr("example_two.npz", bytes(3 << 20))
    packed = buffer.getvalue()
    if rng.random() < 0.05:
        at = packed.rfind(b"PK\x01\x02")
        packed = packed[: at + 24] + struct.pack("<I", int(rng.integers(1 << 31))) + packed[at + 28 :]
    return flip(packed, rng) if rng.random() < 0.25 else packed


def run_case(seed: int, parent: Path) -> str:
    """Make one mutated submission in a folder of its own and hand it in; return what came of it."""
    folder = parent / f"case-{seed}"
    folder.mkdir()
    try:
        return _hand_in(seed, folder)
    finally:
        shutil.rmtree(folder)


def _hand_in(seed: int, folder: Path) -> str:
    rng = np.random.default_rng(seed)
    files = dict(base_files(("csv", "npz", "h5")[rng.integers(3)], int(rng.integers(1, 3))))
    for _ in range(int(rng.integers(0, 4))):
        mutate_files(files, rng)
    if rng.random() < 0.7:
        target = folder / "submission.zip"
        target.write_bytes(pack(files, rng))
    else:
        target = folder / "submission"
        _unpack(files, target)
    before = {p: p.lstat().st_mtime_ns for p in folder.parent.rglob("*")}
    try:
        checked = validate_submission(target, CLIPS)
        str(checked), checked.as_dict()
        if checked.ok:
            score_submission(target, CLIPS)
        elif rng.random() < 0.3:
            score_validated(checked, force=True)
        outcome = "valid" if checked.ok else "invalid"
    except KT3DMoSegError:
        outcome = "refused"
    assert {p: p.lstat().st_mtime_ns for p in folder.parent.rglob("*")} == before, (
        "a file appeared or changed"
    )
    return outcome


def _unpack(files: dict[str, bytes], target: Path) -> None:
    target.mkdir()
    for name, content in files.items():
        target = target / name
        if "\0" in name or len(name) > 200 or not target.resolve().is_relative_to(target.resolve()):
            continue
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(content)
        except OSError:
            continue


def run_batch(first: int, count: int) -> dict[str, int]:
    """Run `count` cases from seed `first`; nothing may be opened for writing outside their folder."""
    found: dict[str, int] = {}
    with tempfile.TemporaryDirectory() as folder:
        _forbid_writes(Path(tempfile.gettempdir()))
        for seed in range(first, first + count):
            start = time.process_time()
            try:
                outcome = run_case(seed, Path(folder))
            except BaseException:
                print(f"case {seed} failed", file=sys.stderr)
                raise
            spent = time.process_time() - start
            assert spent < SLOW_SECONDS, f"case {seed} took {spent:.1f} s of CPU time"
            found[outcome] = found.get(outcome, 0) + 1
    return found


def _forbid_writes(allowed: Path) -> None:
    """Stop the process at the first file that is opened for writing outside `allowed`."""

    def watch(event: str, arguments: tuple[object, ...]) -> None:
        if event == "open" and isinstance(arguments[0], str) and isinstance(arguments[1], str):
            writes = any(letter in arguments[1] for letter in "wax+")
            inside = Path(arguments[0]).resolve().is_relative_to(allowed.resolve())
            if writes and not inside and not arguments[0].startswith("/dev/"):
                raise PermissionError(f"{arguments[0]} opened for writing")

    sys.addaudithook(watch)


def main(total: int, start_seed: int = 0) -> None:
    counts: dict[str, int] = {}
    start = time.monotonic()
    for first in range(start_seed, start_seed + total, BATCH):
        count = min(BATCH, start_seed + total - first)
        code = f"import submission_fuzz as f; print(f.run_batch({first}, {count}))"
        here = Path(__file__).parent
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=here, capture_output=True, text=True, timeout=3600, check=False
        )
        if done.returncode or done.stderr:
            print(f"batch from {first}: exit code {done.returncode}\n{done.stderr}")
            raise SystemExit(1)
        for name, count in eval(done.stdout, {"__builtins__": {}}).items():  # noqa: S307  # our own output
            counts[name] = counts.get(name, 0) + count
    print(f"{total} submissions in {time.monotonic() - start:.0f} s: {counts}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:] or ["10000"]))
