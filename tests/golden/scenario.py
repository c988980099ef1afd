"""What is frozen: one small clip is built, segmented by every method and put through every command.

``python tests/golden/scenario.py`` writes the frozen files again. Do that only for a change that is meant,
raise the ALGORITHM_VERSION of the part whose numbers changed, and read the diff.
"""

from __future__ import annotations

import contextlib
import io
import json
import re
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

import kt3dmoseg
import mseg
from kt3dmoseg.types import Clip, Labels, Trajectories

HERE = Path(__file__).parent
FRAMES, ANNOTATIONS, CLIP = HERE / "frames", HERE / "annotations", HERE / "clip.npz"
METHODS, COMMANDS = HERE / "methods.json", HERE / "commands"

# The lines are run in this order in one temporary folder; later ones use what earlier ones wrote.
_BUILD = "kt3dmoseg build --frames {frames} -o new --annotations {annotations} --workers 1"
SESSION = {
    "kt3dmoseg build": _BUILD,
    "kt3dmoseg build again": _BUILD,
    "kt3dmoseg build mistake": "kt3dmoseg build --frames nowhere -o new",
    "kt3dmoseg build misspelt": "kt3dmoseg build --frames {frames} -o new --min-lenght 5",
    "kt3dmoseg build bound": "kt3dmoseg build --frames {frames} -o new --min-length 0",
    "kt3dmoseg track": "kt3dmoseg track {frames}/street -o tracks.npz --flow dis_medium",
    "kt3dmoseg track mistake": "kt3dmoseg track {frames}/street -o tracks.xyz",
    "kt3dmoseg info": "kt3dmoseg info built/street.h5",
    "kt3dmoseg info folder": "kt3dmoseg info built",
    "kt3dmoseg info mistake": "kt3dmoseg info {frames}/street/000001.png",
    "kt3dmoseg show": "kt3dmoseg show built/street.h5 --frames {frames}/street -o pictures",
    "kt3dmoseg show mistake": "kt3dmoseg show built/street.h5 --at 99 -o a.png --frames {frames}/street",
    "kt3dmoseg choose mistake": "kt3dmoseg choose {frames}/street -o chosen --shortest 50 --longest 60",
    "kt3dmoseg publish mistake": "kt3dmoseg publish built -o version --name Street",
    "kt3dmoseg diff": "kt3dmoseg diff built new",
    "kt3dmoseg convert": "kt3dmoseg convert built/street.h5 street_Tracks.mat",
    "kt3dmoseg convert mistake": "kt3dmoseg convert built/street.h5 street.xls",
    "kt3dmoseg label mistake": "kt3dmoseg label nowhere --no-browser",
    "kt3dmoseg catalog list": "kt3dmoseg catalog list",
    "kt3dmoseg catalog check": "kt3dmoseg catalog check",
    "kt3dmoseg catalog mistake": "kt3dmoseg catalog check nowhere.toml",
    "kt3dmoseg pull mistake": "kt3dmoseg pull -o kitti",
    "kt3dmoseg locate mistake": "kt3dmoseg locate NoSuchClip -o kitti",
    "kt3dmoseg fetch-release mistake": "kt3dmoseg fetch-release -o data --timeout 0",
    "kt3dmoseg synth mistake": "kt3dmoseg synth -o synth --first 0",
    "kt3dmoseg demo mistake": "kt3dmoseg demo -o demo --methods nomethod",
    "kt3dmoseg mistake": "kt3dmoseg biuld",
    "mseg methods": "mseg methods",
    "mseg methods one": "mseg methods subset",
    "mseg methods mistake": "mseg methods subst",
    "mseg run": "mseg run built --method affine --seeds 2 -o affine --quiet",
    "mseg run other": "mseg run built --method one_motion -o one --quiet",
    "mseg run all": "mseg run built --method one_motion --all -o whole --quiet",
    "mseg run mistake": "mseg run built --method affine -p gapp=1 -o wrong",
    "mseg example-submission": "mseg example-submission built -o mine",
    "mseg example-submission mistake": "mseg example-submission built -o theirs --from nowhere",
    "mseg validate": "mseg validate mine built",
    "mseg validate mistake": "mseg validate {annotations} built",
    "mseg score": "mseg score mine built",
    "mseg score seeds": "mseg score affine built --json",
    "mseg score csv": "mseg score affine built --csv",
    "mseg score markdown": "mseg score one built --markdown",
    "mseg score latex": "mseg score one built --latex",
    "mseg score mistake": "mseg score nowhere built",
    "mseg compare": "mseg compare mine one built",
    "mseg compare mistake": "mseg compare mine",
    "mseg report": "mseg report mine built --frames {frames} -o report.html --csv",
    "mseg report mistake": "mseg report mine nowhere -o report.html",
    "mseg leaderboard add": "mseg leaderboard add mine built --db board.sqlite",
    "mseg leaderboard rank": "mseg leaderboard rank --db board.sqlite",
    "mseg leaderboard mistake": "mseg leaderboard rank --db nowhere.sqlite",
    "mseg benchmark": "mseg benchmark kt3dmoseg --data bench --methods one_motion --no-cache --quiet",
    "mseg benchmark mistake": "mseg benchmark kitti",
    "mseg video help": "mseg video --help",
    "mseg video": "mseg video {frames}/street -o motions --method one_motion --quiet",
    "mseg video mistake": "mseg video nowhere -o other --quiet",
}


def built_clip(folder: Path) -> Clip:
    """Build the frozen frames."""
    outcome = kt3dmoseg.pipeline.build_dataset(
        FRAMES, folder, annotations=ANNOTATIONS, workers=1, flow="dis", min_length=5
    )
    assert [each.status for each in outcome] == ["built"]
    return kt3dmoseg.load(outcome[0].path)


def frozen_clip() -> Clip:
    """Return the clip as it was built when the numbers were frozen."""
    with np.load(CLIP, allow_pickle=False) as stored:
        visible = stored["visible"]
        xy = np.where(visible[..., None], stored["xy"].astype(np.float64), np.nan)
        size = tuple(int(side) for side in stored["image_size"])
        tracks = Trajectories(xy, visible, image_size=size)
        return Clip("street", tracks, stored["evaluated"], Labels(stored["label"]))


def store_clip(clip: Clip) -> None:
    np.savez_compressed(
        CLIP,
        xy=np.nan_to_num(clip.dense.xy).astype(np.float32),
        visible=clip.dense.visible,
        evaluated=clip.evaluated,
        label=clip.labels.label,
        image_size=np.array(clip.dense.image_size),
        version=np.array(build_versions()),
        opencv=np.array(cv2.__version__),
    )


def build_versions() -> list[int]:
    """ALGORITHM_VERSION of the parts that a built clip passes through; 1 where there is none yet."""
    parts = kt3dmoseg.flow, kt3dmoseg.tracking, kt3dmoseg.pipeline
    return [getattr(part, "ALGORITHM_VERSION", 1) for part in parts]


def method_versions() -> list[int]:
    """ALGORITHM_VERSION of kernels and methods."""
    from mseg import kernels, methods

    return [getattr(part, "ALGORITHM_VERSION", 1) for part in (kernels, methods)]


def boxes(motions: int, missing: float) -> Clip:
    """Boxes of points that turn and move on their own, seen by a pinhole camera."""
    rng = np.random.default_rng(7)
    frames, points = 6, 24
    steps = ((0.01, (0.10, 0.0, 0.05)), (-0.05, (-0.3, 0.05, 0.0)), (0.06, (0.2, -0.2, 0.1)))
    tracks = []
    for motion in range(motions):
        angle, step = steps[motion]
        body = rng.uniform(-1, 1, size=(points, 3)) + np.array([2.0 * motion - 1.5, 0.5 * motion, 8.0])
        centre, out = body.mean(axis=0), np.empty((points, frames, 2))
        for f in range(frames):
            c, s = np.cos(angle * f), np.sin(angle * f)
            turned = (
                (body - centre) @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]) + centre + f * np.array(step)
            )
            out[:, f] = 500 * turned[:, :2] / turned[:, 2:] + (320, 240)
        tracks.append(out)
    xy = np.concatenate(tracks) + rng.normal(scale=0.05, size=(points * motions, frames, 2))
    visible = rng.random(xy.shape[:2]) >= missing
    xy[~visible] = np.nan
    labels = Labels(np.repeat(np.arange(1, motions + 1), points))
    return Clip("boxes", Trajectories(xy, visible, image_size=(640, 480)), np.arange(len(xy)), labels)


def method_clips() -> dict[str, Clip]:
    return {"two boxes": boxes(2, 0.0), "three boxes": boxes(3, 0.1), "street": frozen_clip()}


def labels_of(method: str, clip: Clip) -> str:
    """Labels as text, numbered in the order of appearance; or the reason why there are none."""
    try:
        found = mseg.segment(clip, method=method, n_motions=clip.n_motions, seed=1).labels
    except kt3dmoseg.errors.KT3DMoSegError as error:
        return type(error).__name__
    names: dict[int, int] = {0: 0}
    return "".join(str(names.setdefault(int(label), len(names))) for label in found)


def run_session(folder: Path) -> dict[str, str]:
    """Run every command of the session in a folder; return what each printed."""
    from kt3dmoseg.cli import main as kt3dmoseg_main
    from mseg.cli import main as mseg_main

    programs = {"kt3dmoseg": kt3dmoseg_main, "mseg": mseg_main}
    seen = {}
    kt3dmoseg.save(frozen_clip(), folder / "built" / "street.h5")
    kt3dmoseg.save(replace(frozen_clip(), name="Seq005_Clip01"), folder / "bench" / "Seq005_Clip01.h5")
    with contextlib.chdir(folder):
        for name, line in SESSION.items():
            words = line.format(frames=FRAMES, annotations=ANNOTATIONS).split()
            out, err = io.StringIO(), io.StringIO()
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                try:
                    code = programs[words[0]](words[1:])
                except SystemExit as stop:
                    code = stop.code
            seen[name] = (
                f"$ {line}\n{plain(out.getvalue())}--- errors\n{plain(err.getvalue())}--- exit {code or 0}\n"
            )
    return seen


def plain(text: str) -> str:
    """Replace what differs from run to run: paths, times, checksums, versions of libraries."""
    text = (
        text.replace(str(HERE), "HERE").replace(str(HERE.parents[1]), "ROOT").replace(str(Path.cwd()), "CWD")
    )
    text = re.sub(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d)?(\.\d+)?(Z|\+00:00)?", "TIME", text)
    text = re.sub(r"\d{4}-\d\d-\d\d", "DATE", text)
    text = re.sub(r"\b0\.0\d\b", "0.0", text)  # seconds of CPU
    text = re.sub(r"\b[0-9a-f]{8,64}\b", "CHECKSUM", text)
    text = re.sub(r'("?seconds"?[^\d\n]{0,12})\d+(\.\d+)?(e-?\d+)?', r"\1SECONDS", text)
    text = re.sub(r"\b\d+(\.\d+)? (s|ms)\b", "SECONDS", text)
    text = re.sub(r"\b\d+\.\d+\.\d+(\.\d+)?\b", "VERSION", text)
    # What the tracker finds is compared with the frozen clip, with the tolerance that OpenCV's versions need.
    text = re.sub(r"\b\d+ (trajectories in|trajectories, \d+ (evaluated|motion))", r"N \1", text)
    text = re.sub(r"N trajectories, \d+ evaluated", "N trajectories, N evaluated", text)
    return "\n".join(line.rstrip() for line in text.splitlines()) + "\n" * bool(text)


def file_of(name: str) -> Path:
    return COMMANDS / f"{name.replace(' ', '_')}.txt"


def main() -> None:
    """Write everything again."""
    with tempfile.TemporaryDirectory() as folder:
        store_clip(built_clip(Path(folder)))
    frozen = {
        method: {name: labels_of(method, clip) for name, clip in method_clips().items()}
        for method in mseg.methods.list()
    }
    METHODS.write_text(json.dumps({"versions": method_versions(), "labels": frozen}, indent=1) + "\n")
    COMMANDS.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        for name, text in run_session(Path(folder)).items():
            file_of(name).write_text(text)


if __name__ == "__main__":
    sys.exit(main())
