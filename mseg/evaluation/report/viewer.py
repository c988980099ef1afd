"""The overlay of a clip: positions, labels and frames packed for the page's script."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

from kt3dmoseg.types import ByteArray, Clip, IntArray
from mseg.evaluation.contingency import Contingency
from mseg.evaluation.results import ScoreTable
from mseg.evaluation.validate import Validation

_MISSING = -32768
_MAX_WIDTH = 960
_QUALITY = 72
_TALL = 2.0


def viewer(checked: Validation, scores: ScoreTable, name: str, frames: Path | None) -> str:
    """Make the overlay of a clip: truth above prediction, slider, seeds to choose from."""
    clip = checked.clips[name]
    pictures = _pictures(frames, clip) if frames is not None else []
    width, height = _size(clip, pictures)
    runs = [_run(clip, checked, scores, name, seed) for seed in scores.seeds]
    drawn = [(seed, run) for seed, run in zip(scores.seeds, runs, strict=True) if run is not None]
    scale = min(10.0, 32000 / max(width, height))
    payload = {
        "width": width,
        "height": height,
        "n_frames": clip.n_frames,
        "scale": scale,
        "numbers": clip.frame_numbers.tolist(),
        "xy": _packed_positions(clip, scale),
        "truth": _packed(_ranks(clip.labels.label)),
        "runs": [run for _, run in drawn],
        "frames": [_jpeg(picture) for picture in pictures],
    }
    # "</" would end the script element; JSON may write it as "<\/".
    content = json.dumps(payload, separators=(",", ":")).replace("</", "<\\/")
    canvases = ("truth", "prediction") if drawn else ("truth",)
    shape = " tall" if width < _TALL * height else ""
    return (
        f"<div class='viewer{shape}'><script type='application/json'>{content}</script><div class='views'>"
        f"{''.join(_canvas(clip, what, width, height) for what in canvases)}</div>"
        f"{_controls(clip, [seed for seed, _ in drawn])}</div>"
    )


def shown_groups(table: Contingency) -> list[int]:
    """Order predicted groups for display: assigned ones by motion, then the others by size."""
    assigned = [int(j) for j in table.assignment if j >= 0]
    free = [j for j in range(len(table.groups)) if j not in assigned]
    free.sort(key=lambda j: -int(table.counts[:, j].sum()))
    return assigned + free


def group_colours(table: Contingency) -> dict[int, int]:
    """Give an assigned group the colour number of its motion, the others numbers of their own."""
    colours = {int(j): i + 1 for i, j in enumerate(table.assignment) if j >= 0}
    free = [j for j in shown_groups(table) if j not in colours]
    return colours | {j: len(table.motions) + 1 + k for k, j in enumerate(free)}


def _run(clip: Clip, checked: Validation, scores: ScoreTable, name: str, seed: int) -> dict[str, str] | None:
    labels, table = checked.labels.get((seed, name)), scores.of(name, seed).table
    if labels is None or table is None:
        return None
    colour = np.zeros(int(labels.max(initial=0)) + 1, dtype=np.int64)
    for j, value in group_colours(table).items():
        colour[table.groups[j]] = value
    shown = colour[labels]
    truth = _ranks(clip.labels.label)
    return {"shown": _packed(shown), "wrong": _packed(((truth > 0) & (shown != truth)).astype(np.int64))}


def _ranks(label: IntArray) -> IntArray:
    """Renumber the motions 1..M in ascending order; 0 stays 0."""
    motions = np.unique(label[label > 0])
    return np.where(label > 0, np.searchsorted(motions, label) + 1, 0)


def _packed(values: IntArray) -> str:
    return base64.b64encode(np.minimum(values, 255).astype(np.uint8).tobytes()).decode()


def _packed_positions(clip: Clip, scale: float) -> str:
    tracks = clip.evaluated_trajectories
    steps = np.rint(np.where(tracks.visible[..., None], tracks.xy, 0.0) * scale)
    small = np.clip(steps, -32767, 32767).astype("<i2")
    small[~tracks.visible] = _MISSING
    return base64.b64encode(small.tobytes()).decode()


def _size(clip: Clip, pictures: Sequence[ByteArray]) -> tuple[int, int]:
    if clip.dense.image_size is not None:
        return clip.dense.image_size
    if pictures:
        height, width = pictures[0].shape
        return width, height
    xy = clip.dense.xy[clip.dense.visible]
    far = np.ceil(xy.max(axis=0)) if len(xy) else np.ones(2)
    return int(max(1, far[0] + 1)), int(max(1, far[1] + 1))


def _canvas(clip: Clip, what: str, width: int, height: int) -> str:
    # With its size told, the page is as long before the canvas is drawn as after.
    return (
        f"<figure><figcaption>{what}</figcaption><canvas role='img' width='{width}' height='{height}' "
        f"aria-label='{escape(clip.name)}: {what}'></canvas></figure>"
    )


def _controls(clip: Clip, seeds: list[int]) -> str:
    options = "".join(f"<option>seed {seed}</option>" for seed in seeds)
    middle = clip.n_frames // 2  # where most trajectories are seen
    choice = f"<label>run <select>{options}</select></label>" if len(seeds) > 1 else ""
    return (
        "<div class='controls'><button type='button' aria-pressed='false'>Play</button>"
        f"<input type='range' min='0' max='{clip.n_frames - 1}' value='{middle}' "
        f"aria-label='frame of {escape(clip.name)}'>"
        f"<output>frame {clip.frame_numbers[middle]}</output>"
        f"<label><input type='checkbox'> only errors</label>{choice}</div>"
    )


def _pictures(folder: Path, clip: Clip) -> list[ByteArray]:
    """Read the frames of a clip, (H, W) gray; none when the folder has no such clip."""
    from kt3dmoseg.frames import frame_folder, frames_of

    return frames_of(clip, folder) if frame_folder(clip, folder) else []


def _jpeg(picture: ByteArray) -> str:
    import cv2

    height, width = picture.shape
    size = (_MAX_WIDTH, round(height * _MAX_WIDTH / width))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA) if width > _MAX_WIDTH else picture
    _, content = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return "data:image/jpeg;base64," + base64.b64encode(content.tobytes()).decode()
