"""Set everything up in a virtual environment of its own, then run the demo or the tests.

Usage: python3 tools/start.py demo|test [arguments passed on]. Needs Python 3.11 or newer with venv.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import threading
import time
import venv
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import browser

ROOT = Path(__file__).resolve().parent.parent
ENVIRONMENT = ROOT / ".venv"
JOBS = {"demo": "all", "test": "test,lint"}
_EVERY = 0.5 if sys.stderr.isatty() else 5.0  # seconds between two signs of life


def main(arguments: list[str]) -> int:
    if not arguments or arguments[0] not in JOBS:
        print(__doc__)
        return 2
    if sys.version_info < (3, 11):  # noqa: UP036  # run by whatever python3 the machine has
        print(f"Python 3.11 or newer is needed; this is {sys.version.split()[0]}")
        return 2
    job, rest = arguments[0], arguments[1:]
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # every process would compile all packages again
    try:
        python = environment(JOBS[job])
    except subprocess.CalledProcessError as error:
        command = " ".join(map(str, error.cmd))
        print(
            f"this failed: {command}\nIs the network there, and Python's venv module (Debian: python3-venv)?"
        )
        return 2
    if job == "demo":
        return subprocess.call([str(python), "-m", "kt3dmoseg", "demo", *rest], cwd=ROOT)
    return _test(python, rest)


def _test(python: Path, rest: list[str]) -> int:
    """Run the tests. Those of the pages need a browser; without one they are skipped, but never in CI."""
    found = browser.find() or browser.install(python)
    browser.axe()
    environment = os.environ | ({browser.VARIABLE: found} if found else {})
    workers = (os.cpu_count() or 1) + 1  # tests of pages and servers wait for others
    # A file's fixtures are made once; files in their order, as the longest are not those of most tests.
    spread = ["-n", str(workers), "--dist", "loadfile", "--no-loadscope-reorder"]
    command = [str(python), "-m", "pytest", *spread, *rest]
    code = subprocess.call(command, cwd=ROOT, env=environment)
    if not found:
        print("The tests in a browser did not run: no Chromium or Chrome was found, none could be installed.")
    return code


def environment(extras: str) -> Path:
    """Create or update the virtual environment; return its interpreter."""
    folder = "Scripts" if os.name == "nt" else "bin"
    python = ENVIRONMENT / folder / ("python.exe" if os.name == "nt" else "python")
    if not _has_pip(python):
        with _busy(f"creating {ENVIRONMENT}"):
            venv.create(ENVIRONMENT, with_pip=True)
    stamp = ENVIRONMENT / f".installed-{extras.replace(',', '-')}"
    wanted = hashlib.sha256((ROOT / "pyproject.toml").read_bytes()).hexdigest()
    if not stamp.exists() or stamp.read_text() != wanted:
        target = f"{ROOT}[{extras}]"
        with _busy(f"installing kt3dmoseg[{extras}]"):
            _install(python, target)
        stamp.write_text(wanted)
    return python


def _install(python: Path, target: str) -> None:
    """Install by uv, in a fraction of pip's time; by pip where uv cannot, as it reads no pip.conf."""
    os.environ["UV_SYSTEM_CERTS"] = "true"  # a company's network may have its own, which pip knows
    pip = [str(python), "-m", "pip", "install", "--quiet"]
    uv = [str(python), "-m", "uv", "pip", "install", "--quiet", "--python", str(python)]
    if subprocess.call([*pip, "uv"]) or subprocess.call([*uv, "--editable", target]):
        print("uv could not install it: pip does, which takes longer", flush=True)
        subprocess.check_call([*pip, "--editable", target])


def _has_pip(python: Path) -> bool:
    """Whether the environment is complete: making it may have been interrupted."""
    command = [str(python), "-m", "pip", "--version"]
    return python.exists() and subprocess.call(command, stdout=subprocess.DEVNULL) == 0


@contextmanager
def _busy(title: str) -> Iterator[None]:
    """Show what is done, for how long, and how many packages are there, until the block ends."""
    done, started = threading.Event(), time.monotonic()

    def show() -> None:
        while not done.wait(_EVERY):
            packages = len(list(ENVIRONMENT.glob("[Ll]ib/**/site-packages/*.dist-info")))
            line = f"{title}: {time.monotonic() - started:.0f} s, {packages} packages installed"
            end = "\r" if sys.stderr.isatty() else "\n"
            print(line[: shutil.get_terminal_size().columns - 1], end=end, file=sys.stderr, flush=True)

    print(title, flush=True)
    thread = threading.Thread(target=show, daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()
        if sys.stderr.isatty():
            print("\x1b[K", end="", file=sys.stderr, flush=True)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
