"""The page "make your own dataset" runs, in its order, in an empty folder, with outlines by a program."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "dataset.md"
# What a person outlines on the labelling page: here the boxes of the drive's tracklets.
_OUTLINED = """
from dataclasses import replace
from kt3dmoseg.annotate import Annotation
from kt3dmoseg.annotate.model import save_annotation
from kt3dmoseg.annotate.proposals import Request, propose
from kt3dmoseg.frames import find_clips
from kt3dmoseg import load
from pathlib import Path
catalogs = ["chosen/candidates.toml"]
for name, clip in find_clips("kitti", annotations="annotations", catalogs=catalogs).items():
    tracks = load(f"clips/{name}.h5").dense
    empty = Annotation(name, tracks.image_size, tracks.n_frames, annotator="test")
    found = propose("tracklets", Request(name, empty, tracks, clip.frames, kitti=Path("kitti")))
    save_annotation(Path("annotations", f"{name}.json"), replace(empty, objects=tuple(found)))
"""


def test_the_page_runs(tmp_path):
    pytest.importorskip("pyarrow")
    script = ["set -eu"]
    for kind, block in re.findall(r"```(sh|python)\n(.*?)```", PAGE.read_text(), re.DOTALL):
        if not importlib.util.find_spec("datasets"):
            block = re.sub(r"tracks = datasets.*\n", "", block.replace("import datasets, ", "import "))
        block = re.sub(r"kt3dmoseg label .*\n", f"python - <<'END'{_OUTLINED}END\n", block)
        script.append(block if kind == "sh" else f"python - <<'END'\n{block}\nEND\n")
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(
        ["bash", "-c", "\n".join(script)],
        cwd=tmp_path,
        env={**os.environ, "PATH": path, "HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path / "hf")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "built (labels annotation added)" in done.stdout
    assert re.search(r"evaluated, [34] motions", done.stdout)
    assert "no clip differs" in done.stdout
    assert "My drives 1.0.0, 2 train, cc-by-nc-sa-3.0" in done.stderr
