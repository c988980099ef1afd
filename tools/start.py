"""Set everything up in a virtual environment of its own, then run the demo or the tests.

Usage: python3 tools/start.py demo|test [arguments passed on]. Needs Python 3.11 or newer with venv.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ENVIRONMENT = ROOT / ".venv"
JOBS = {"demo": "all", "test": "test,lint"}


def main(arguments: list[str]) -> int:
    if not arguments or arguments[0] not in JOBS:
        print(__doc__)
        return 2
    if sys.version_info < (3, 11):  # noqa: UP036  # run by whatever python3 the machine has
        print(f"Python 3.11 or newer is needed; this is {sys.version.split()[0]}")
        return 2
    job, rest = arguments[0], arguments[1:]
    try:
        python = _environment(JOBS[job])
    except subprocess.CalledProcessError as error:
        command = " ".join(map(str, error.cmd))
        print(
            f"this failed: {command}\nIs the network there, and Python's venv module (Debian: python3-venv)?"
        )
        return 2
    if job == "demo":
        command = [python, "-m", "kt3dmoseg.cli", "demo", *rest]
    else:
        command = [python, "-m", "pytest", "-n", str(os.cpu_count() or 1), *rest]
    return subprocess.call([str(part) for part in command], cwd=ROOT)


def _environment(extras: str) -> Path:
    """Create or update the virtual environment; return its interpreter."""
    folder = "Scripts" if os.name == "nt" else "bin"
    python = ENVIRONMENT / folder / ("python.exe" if os.name == "nt" else "python")
    if not _has_pip(python):
        print(f"creating {ENVIRONMENT}", flush=True)
        venv.create(ENVIRONMENT, with_pip=True)
    stamp = ENVIRONMENT / f".installed-{extras.replace(',', '-')}"
    wanted = hashlib.sha256((ROOT / "pyproject.toml").read_bytes()).hexdigest()
    if not stamp.exists() or stamp.read_text() != wanted:
        print(f"installing kt3dmoseg[{extras}]", flush=True)
        target = f"{ROOT}[{extras}]"
        subprocess.check_call([str(python), "-m", "pip", "install", "--quiet", "--editable", target])
        stamp.write_text(wanted)
    return python


def _has_pip(python: Path) -> bool:
    """Whether the environment is whole: making it may have been interrupted."""
    command = [str(python), "-m", "pip", "--version"]
    return python.exists() and subprocess.call(command, stdout=subprocess.DEVNULL) == 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
