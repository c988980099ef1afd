"""Find a browser for the tests of the pages, or install one; fetch axe-core. Needs nothing but Python."""

from __future__ import annotations

import base64
import hashlib
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

VARIABLE = "KT3DMOSEG_BROWSER"
# The first is the part of Chromium that draws without a window, in half the time.
_COMMANDS = (
    "chromium-headless-shell",
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
)
_APPLICATIONS = (
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
    "C:/Program Files/Google/Chrome/Application/chrome.exe",
)
_SECONDS = 600  # one installation
_AXE = "axe-core@4.14.1"
_AXE_SHA512 = "FHfa+lmNjQZfJz1q8wKqIDwC6DExcHt/pkjNQb09a3NPjCKg2rhu5qb2S4r76ASyFNNtuFooJpZe37OgudVGtQ=="


def find() -> str:
    """Return the path of a Chromium or Chrome, the one that KT3DMOSEG_BROWSER names first; '' for none."""
    if named := os.environ.get(VARIABLE):
        return named
    commands = [path for path in map(shutil.which, _COMMANDS) if path]
    applications = [path for path in _APPLICATIONS if Path(path).is_file()]
    return next(iter([*commands, *applications, *_of_playwright()]), "")


def install(python: Path) -> str:
    """Install one, playwright's or else the system's package when we are root; return its path, or ''."""
    for command in ([str(python), "-m", "playwright", "install", "chromium"], *_system_packages()):
        print(f"looking for a browser for the page tests: {' '.join(command)}", flush=True)
        environment = os.environ | {"DEBIAN_FRONTEND": "noninteractive"}
        try:
            subprocess.run(command, env=environment, timeout=_SECONDS, capture_output=True)
        except (OSError, subprocess.TimeoutExpired) as error:
            print(f"  {error}", flush=True)
        if found := find():
            return found
    return ""


def axe() -> str:
    """Return the script of axe-core, which checks pages for accessibility; '' where npm cannot fetch it.

    It comes from its npm package and is kept in the user's cache.
    """
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "kt3dmoseg")
    script = folder / f"{_AXE}.min.js"
    if not script.is_file() and (npm := shutil.which("npm")):
        with tempfile.TemporaryDirectory() as name:
            command = [npm, "pack", _AXE, "--silent", "--pack-destination", name]
            subprocess.run(command, timeout=_SECONDS, capture_output=True)
            for package in Path(name).glob("*.tgz"):
                found = base64.b64encode(hashlib.sha512(package.read_bytes()).digest()).decode()
                if found != _AXE_SHA512:
                    raise RuntimeError(f"{_AXE}: expected sha512 {_AXE_SHA512}, found {found}")
                with tarfile.open(package) as archive:
                    content = archive.extractfile("package/axe.min.js").read()
                folder.mkdir(parents=True, exist_ok=True)
                temporary = folder / f"{_AXE}.{os.getpid()}"
                temporary.write_bytes(content)
                temporary.replace(script)
    return script.read_text(encoding="utf-8") if script.is_file() else ""


def _of_playwright() -> list[str]:
    """List the browsers that playwright has downloaded, the newest first."""
    home = Path.home()
    caches = [
        os.environ.get("PLAYWRIGHT_BROWSERS_PATH", ""),
        home / ".cache/ms-playwright",
        home / "Library/Caches/ms-playwright",
        home / "AppData/Local/ms-playwright",
    ]
    names = ("chrome", "chrome.exe", "Chromium", "Google Chrome for Testing")
    found = [
        path
        for cache in caches
        if cache and Path(cache).is_dir()
        for name in names
        for path in sorted(Path(cache).glob(f"chromium-*/**/{name}"), reverse=True)
        if path.is_file() and os.access(path, os.X_OK)
    ]
    return [str(path) for path in found]


def _system_packages() -> list[list[str]]:
    root = sys.platform.startswith("linux") and os.geteuid() == 0
    if not (root and shutil.which("apt-get")):
        return []
    install = ["apt-get", "install", "-y", "--no-install-recommends"]
    return [["apt-get", "update"], *([*install, name] for name in _COMMANDS[:2])]
