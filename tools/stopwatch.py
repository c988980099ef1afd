"""Walk a newcomer's path by the README's own commands, from clone to an opened report, and time each.

    python tools/stopwatch.py REPOSITORY FOLDER [--release DATA]       FOLDER: new; the clone goes there

`--release`: a copy of what `kt3dmoseg fetch-release` downloads, where the machine has no network.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import browser

ROOT = Path(__file__).resolve().parent.parent


def commands(readme: str) -> list[str]:
    """Return the README's commands, in order, from installation to `mseg report`."""
    install = re.search(r"## Install.*?```sh\n(.*?)```", readme, re.DOTALL)
    fetch = re.search(r"^kt3dmoseg fetch-release [^#\n]*", readme, re.MULTILINE)
    assert install, "README: no installation"
    assert fetch, "README: no fetch-release"
    table = re.findall(r"`(mseg [^`]*data/kt3dmoseg/release[^`]*)`", readme)
    last = next(k for k, command in enumerate(table) if command.startswith("mseg report"))
    return [*install[1].splitlines(), fetch[0].strip(), *table[: last + 1]]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("repository")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--release", type=Path)
    given = parser.parse_args()
    clone = f"git clone -q {given.repository} {given.folder}"
    begin, enter = time.monotonic(), f"cd {given.folder}"
    for number, command in enumerate([clone, *commands((ROOT / "README.md").read_text())], start=1):
        started = time.monotonic()
        if given.release and "fetch-release" in command:
            shutil.copytree(given.release, given.folder / "data/kt3dmoseg/release", dirs_exist_ok=True)
        elif (code := subprocess.call(["bash", "-c", f"{enter}; {command}" if number > 1 else command])) != 0:
            print(f"{number}. {command}: exit code {code}")
            return 1
        print(f"{number:2}. {time.monotonic() - started:6.1f} s  {command}", flush=True)
        if number > 1 and "activate" in command:
            enter += " && . .venv/bin/activate"
    _open(given.folder / "report.html")
    minutes = (time.monotonic() - begin) / 60
    print(f"{number} commands, {minutes:.1f} minutes (at most 10 and 10)")
    return int(number > 10 or minutes > 10)


def _open(report: Path) -> None:
    """Open the report in Chromium as a person would; its title must be there."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=browser.find(), args=["--no-sandbox"])
        page = chromium.new_page()
        page.goto(report.resolve().as_uri())
        print(f"opened: {page.title()!r}, {page.locator('h1').first.inner_text()!r}")


if __name__ == "__main__":
    sys.exit(main())
