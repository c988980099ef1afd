"""Run tests with the lowest versions that `pyproject.toml` allows, in an environment of their own.

    python3.11 tools/check_lowest.py FOLDER [TESTS ...]         FOLDER: of the environment, made or updated

They have wheels for Python 3.11. Golden figures belong to current versions and are not compared.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
EXTRAS = ("label", "plot", "pull", "xarray")
TOOLS = ("pytest", "pytest-timeout", "hypothesis", "httpx", "jsonschema")
TESTS = ("tests/io", "tests/mseg_core/test_estimator.py", "tests/evaluation/test_scoring.py")
TESTS += tuple(f"tests/foundation/test_{name}.py" for name in ("display", "readme", "types"))
# Left out: a bound of memory that fits current versions; a line that libtiff prints in former ones.
LEFT_OUT = (
    "--ignore=tests/io/test_io_fuzz.py",
    "--deselect=tests/io/test_io_images.py::test_pictures_without_checksums_are_refused_when_cut_short",
)


def lowest(requirements: list[str]) -> list[str]:
    """Pin each requirement to the first versions after its ``>=``; this package's own extras are left out."""
    pins = [re.match(r"([\w-]+)>=([\d.]+)", each) for each in requirements]
    return [f"{pin[1]}=={pin[2] if '.' in pin[2] else pin[2] + '.0'}.*" for pin in pins if pin]


def main(folder: str, *tests: str) -> int:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = (each for name in EXTRAS for each in project["optional-dependencies"][name])
    pins = lowest([*project["dependencies"], *extras])
    venv.create(folder, with_pip=True)
    python = str(Path(folder).absolute() / "bin" / "python")
    subprocess.check_call([python, "-m", "pip", "install", "-q", *pins, *TOOLS])
    subprocess.check_call([python, "-m", "pip", "install", "-q", "--no-deps", "-e", str(ROOT)])
    # What these versions warn of on newer machines is not ours.
    command = [python, "-m", "pytest", "-q", "-W", "default", *(tests or (*TESTS, *LEFT_OUT))]
    return subprocess.call(command, cwd=ROOT)


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]) if len(sys.argv) > 1 else print(__doc__))
