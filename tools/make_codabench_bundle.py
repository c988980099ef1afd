"""Write a Codabench competition bundle whose scoring program is this package.

Usage: python tools/make_codabench_bundle.py DATA -o bundle.zip [--benchmark kt3dmoseg] [--image IMAGE]

DATA is the folder of clips with their labels; it becomes the reference data, which participants do
not see. The image must have Python 3.11 or newer; numpy, scipy, h5py, pandas, pydantic and jinja2
are installed where missing.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

import kt3dmoseg
import mseg
from kt3dmoseg.errors import KT3DMoSegError
from kt3dmoseg.files import write_bytes, zip_bytes
from kt3dmoseg.io import dataset_paths
from kt3dmoseg.io.images import encode_indices
from mseg.evaluation.metrics import all_metrics
from mseg.evaluation.protocol import choose_protocol, load_protocol

# What the scoring program imports; the other sub-packages (methods, trackers, servers) stay out.
_PARTS = {
    kt3dmoseg: ("*.py", "io/**/*", "draw/__init__.py", "draw/palette.py"),
    mseg: ("*.py", "evaluation/**/*", "geometry/*.py", "protocols/*.toml"),
}
_PACKAGES = {
    "numpy": ">=1.26",
    "scipy": ">=1.12",
    "h5py": ">=3.10",
    "pandas": ">=2.1",
    "pydantic": ">=2.8",
    "jinja2": ">=3.1",
}
_COLUMNS = ("error", "error_median", "adjusted_rand", "nmi", "f_measure", "iou", "moving_f", "failed")

SCORE_PY = '''"""python score.py INPUT OUTPUT: score the submission INPUT/res against the data INPUT/ref."""
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

HERE = Path(__file__).resolve().parent

if __name__ == "__main__":
    if not all(map(find_spec, {packages!r})):  # a plain Python image
        subprocess.check_call([sys.executable, "-m", "pip", "install", "-q", "-r", HERE / "requirements.txt"])
    sys.path.insert(0, str(HERE))
    from mseg.evaluation.codabench import main

    sys.exit(main(sys.argv[1:], benchmark={benchmark!r}))
'''

TERMS = """# Terms

The KT3DMoSeg labels derive from KITTI and carry its licence, CC BY-NC-SA 3.0.
"""

OVERVIEW = """# {title}

Segment the point trajectories of each clip by the 3D rigid motion that they follow.

Hand in a zip of `meta.toml` and one `track,label` file per clip. `mseg example-submission` writes one
to start from; `mseg validate SUBMISSION DATA` runs the very checks that are run here.
A missing clip, or one on which a method failed, counts as fully wrong.
"""


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", help="folder of clips with labels")
    parser.add_argument("-o", "--output", required=True, help="bundle to write, a .zip")
    parser.add_argument("--benchmark", default="", help="protocol; default: the one the clips belong to")
    parser.add_argument("--image", default="python:3.12", help="docker image (default: %(default)s)")
    options = parser.parse_args(arguments)
    try:
        write_bytes(options.output, make_bundle(options.data, options.benchmark, options.image))
    except KT3DMoSegError as error:
        print(f"make_codabench_bundle: {error}", file=sys.stderr)
        return error.exit_code
    print(f"wrote {options.output} ({Path(options.output).stat().st_size / 1e6:.2f} MB)")
    return 0


def make_bundle(data: str, benchmark: str, image: str) -> bytes:
    """Return the bundle; the same data give the same bytes."""
    paths = dataset_paths(data)
    name = load_protocol(benchmark).name if benchmark else choose_protocol("", paths).name
    title = load_protocol(name).title if name != "custom" else "Motion segmentation"
    reference = {path.name: path.read_bytes() for path in paths.values()}
    return zip_bytes(
        {
            "competition.yaml": competition_yaml(title, image).encode(),
            "logo.png": logo(),
            "terms.md": TERMS.encode(),
            "overview.md": OVERVIEW.format(title=title).encode(),
            "scoring_program.zip": zip_bytes(scoring_program(name)),
            "reference_data.zip": zip_bytes(reference),
        }
    )


def scoring_program(benchmark: str) -> dict[str, bytes]:
    """Files of the scoring program: a start script and the part of the packages that scores."""
    out = {
        "metadata.yaml": b"command: python /app/program/score.py /app/input /app/output\n",
        "score.py": SCORE_PY.format(benchmark=benchmark, packages=tuple(_PACKAGES)).encode(),
        "requirements.txt": "".join(f"{name}{version}\n" for name, version in _PACKAGES.items()).encode(),
    }
    for package, patterns in _PARTS.items():
        root = Path(package.__file__ or "").parent
        for pattern in patterns:
            for path in sorted(root.glob(pattern)):
                if path.is_file() and "__pycache__" not in path.parts:
                    out[f"{package.__name__}/{path.relative_to(root).as_posix()}"] = path.read_bytes()
    return out


def competition_yaml(title: str, image: str) -> str:
    """Describe the competition, version 2; JSON values are YAML values."""
    fields = {
        "version": 2,
        "title": title,
        "description": "3D rigid motion segmentation of point trajectories",
        "image": "logo.png",
        "terms": "terms.md",
        "docker_image": image,
        "registration_auto_approve": True,
        "enable_detailed_results": True,
        "pages": [{"title": "Overview", "file": "overview.md"}],
        "tasks": [
            {
                "index": 0,
                "name": title,
                "scoring_program": "scoring_program.zip",
                "reference_data": "reference_data.zip",
            }
        ],
        "phases": [
            {
                "index": 0,
                "name": "Evaluation",
                "start": "2026-01-01 00:00:00",
                "accepts_only_result_submissions": True,
                "tasks": [0],
            }
        ],
        "leaderboards": [
            {"title": "Results", "key": "main", "submission_rule": "Force_Last", "columns": columns()}
        ],
    }
    return "".join(f"{key}: {json.dumps(value)}\n" for key, value in fields.items())


def columns() -> list[dict[str, str | int]]:
    """Describe the columns of the competition's leaderboard, sorted by the first."""
    titles = {"error": "mean error %", "error_median": "median error %"}
    metrics = all_metrics()

    def order(key: str) -> str:
        metric = metrics.get(key.removesuffix("_median"))
        return "asc" if metric is None or metric.better == "lower" else "desc"

    return [
        {"title": titles.get(key, key), "key": key, "index": index, "sorting": order(key), "precision": 2}
        for index, key in enumerate(_COLUMNS)
    ]


def logo() -> bytes:
    """Draw two groups of dots in motion: a PNG of 160 x 160."""
    y, x = np.mgrid[:160, :160]
    dots = (x % 40 - 20) ** 2 + (y % 40 - 20) ** 2 < 90
    moving = (x >= 40) & (x < 120) & (y >= 80)
    palette = np.zeros((256, 3), dtype=np.uint8)
    palette[:3] = (27, 30, 35), (86, 180, 233), (230, 159, 0)
    return encode_indices((dots * (1 + moving)).astype(np.uint8), palette)


if __name__ == "__main__":
    raise SystemExit(main())
