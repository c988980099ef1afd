"""Pictures of trajectories: points with trails, on the frames or on black, coloured by what matters."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from kt3dmoseg.draw import DrawOptions
from kt3dmoseg.draw.palette import WRONG, Colour, label_colour
from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.files import PathLike
from kt3dmoseg.io.predictions import read_prediction
from kt3dmoseg.matching import match_labels
from kt3dmoseg.text import count
from kt3dmoseg.types import BoolArray, ByteArray, Clip, IntArray, Labels, Trajectories

_SHIFT = 4  # OpenCV draws at 1/16 px
_FONT, _FONT_SCALE, _LINE = cv2.FONT_HERSHEY_SIMPLEX, 0.42, 15
_WHITE = (255, 255, 255)
_MAX_PIXELS, _MAX_EXTENT = 1 << 27, 4096

Legend: TypeAlias = Sequence[tuple[str, Colour]]


@dataclass(frozen=True)
class Painting:
    """Which N trajectories are drawn, in which colours (N, 3) uint8 RGB, with which legend."""

    trajectories: Trajectories
    colours: ByteArray
    legend: Legend
    ringed: BoolArray | None = None  # (N,): whose points have a ring


def groups(labels: Labels) -> list[tuple[int, str, int]]:
    """Value, name and size of every label that occurs, ascending."""
    called = {labels.background: "background", 0: "unlabelled"} | dict(labels.names)
    values, sizes = np.unique(labels.label, return_counts=True)
    return [(v, called.get(v, ""), n) for v, n in zip(values.tolist(), sizes.tolist(), strict=True)]


def by_label(clip: Clip, labels: Labels | None = None) -> Painting:
    """Colour the evaluated trajectories by labels, by default the clip's own; a background is gray."""
    labels = labels or clip.labels
    legend = [
        (f"{value} {name}".rstrip() + f": {size}", label_colour(value, labels.background))
        for value, name, size in groups(labels)
    ]
    return Painting(clip.evaluated_trajectories, _label_colours(labels.label, labels.background), legend)


def by_prediction(clip: Clip, predicted: npt.ArrayLike) -> Painting:
    """Colour the evaluated trajectories by predicted labels (n,).

    Of a labelled clip, a predicted label has the colour of the motion that it shares most with, one to
    one, and the trajectories that are then labelled otherwise are ringed.
    """
    values, truth = np.asarray(predicted, dtype=np.int64), clip.labels.label
    if not clip.n_motions:
        return by_label(clip, Labels(values))
    match, background = match_labels(values, truth), clip.labels.background
    # Predicted labels without a motion get numbers after the motions'.
    others = [label for label in np.unique(values[values > 0]).tolist() if label not in match]
    match |= {label: int(truth.max()) + k for k, label in enumerate(others, start=1)}
    shown = np.array([match.get(value, 0) for value in values.tolist()], dtype=np.int64)
    wrong = (shown != truth) & (truth > 0)
    legend = []
    for value in np.unique(values).tolist():
        chosen = values == value
        text = f"predicted {value}: {int(chosen.sum())}, {int(wrong[chosen].sum())} wrong"
        legend.append((text, label_colour(match.get(value, 0), background)))
    share = wrong.sum() / max(1, (truth > 0).sum())
    legend.append((f"ringed: labelled otherwise, {share:.1%}", WRONG))
    return Painting(clip.evaluated_trajectories, _label_colours(shown, background), legend, wrong)


def by_length(trajectories: Trajectories) -> Painting:
    """Colour all trajectories by the number of frames they live, short violet to long yellow (viridis)."""
    longest = trajectories.n_frames
    ends = [1, max(1, longest // 2), longest]
    share = np.rint(255.0 * np.append(trajectories.lengths, ends) / max(1, longest)).clip(0, 255)
    colours = cv2.applyColorMap(share.astype(np.uint8)[:, None], cv2.COLORMAP_VIRIDIS)[:, 0, ::-1]
    names = [count(end, "frame") for end in ends]
    legend = list(zip(names, map(tuple, colours[-len(ends) :].tolist()), strict=True))
    return Painting(trajectories, np.asarray(colours[: -len(ends)], dtype=np.uint8), legend)


def painting_of(clip: Clip, by: str | None, prediction: PathLike | None) -> Painting:
    """Colour by "label", "length" or "prediction"; by default by what there is, the prediction first."""
    if not clip.n_frames:
        raise InvalidValueError(clip.name, expected="a clip with frames", found="none")
    if prediction and by not in (None, "prediction"):
        raise InvalidValueError("pred", expected="by='prediction'", found=f"by={by!r}")
    by = by or ("prediction" if prediction else "label" if clip.n_motions else "length")
    if by == "prediction":
        if prediction is None:
            raise InvalidValueError("by='prediction'", expected="pred=FILE", found="none")
        return by_prediction(clip, read_prediction(prediction, clip))
    return by_label(clip) if by == "label" else by_length(clip.dense)


def _label_colours(label: IntArray, background: int | None) -> ByteArray:
    colours = [label_colour(value, background) for value in label.tolist()]
    return np.array(colours, dtype=np.uint8).reshape(-1, 3)


def draw_frame(
    painting: Painting,
    frame: int,
    picture: ByteArray | None = None,
    title: str = "",
    options: DrawOptions | None = None,
) -> ByteArray:
    """Draw the frame of this index, RGB (H * scale, W * scale, 3) uint8.

    The `picture` (H, W) uint8 is drawn below, black when there is none; the legend starts with the `title`.
    """
    chosen = options or DrawOptions()
    canvas = _canvas(painting.trajectories, picture, chosen)
    _draw_trails(canvas, painting, frame, chosen)
    _draw_points(canvas, painting, frame, chosen)
    _draw_legend(canvas, title, painting.legend, chosen.scale)
    return canvas


def _canvas(trajectories: Trajectories, picture: ByteArray | None, options: DrawOptions) -> ByteArray:
    given = None if picture is None else picture.shape[::-1]
    width, height = given or trajectories.image_size or extent(trajectories)
    if width * height * options.scale**2 > _MAX_PIXELS:
        found = f"{width}x{height}, enlarged {options.scale} times"
        raise InvalidValueError("scale", expected=f"pictures of at most {_MAX_PIXELS} pixels", found=found)
    if picture is None:
        return np.zeros((height * options.scale, width * options.scale, 3), dtype=np.uint8)
    dimmed = np.rint(picture * options.dim).astype(np.uint8)
    large = dimmed.repeat(options.scale, axis=0).repeat(options.scale, axis=1)
    return np.repeat(large[..., None], 3, axis=2)


def extent(trajectories: Trajectories) -> tuple[int, int]:
    """Width and height that hold every point, for clips without an image size."""
    points = trajectories.xy[trajectories.visible]
    width, height = np.clip(np.ceil(points.max(axis=0, initial=0)) + 1, (64, 48), _MAX_EXTENT).tolist()
    return int(width), int(height)


def _draw_trails(canvas: ByteArray, painting: Painting, frame: int, options: DrawOptions) -> None:
    tracks, start = painting.trajectories, max(0, frame - options.trail)
    for row in np.flatnonzero(tracks.visible[:, frame]).tolist():
        # Only the unbroken run that ends here: a trail must not bridge a gap.
        gaps = np.flatnonzero(~tracks.visible[row, start:frame])
        begin = start + int(gaps.max(initial=-1)) + 1
        points = _fixed_point(tracks.xy[row, begin : frame + 1], options.scale)
        if len(points) > 1:
            colour = painting.colours[row].tolist()
            cv2.polylines(canvas, [points], False, colour, options.scale, cv2.LINE_AA, _SHIFT)


def _draw_points(canvas: ByteArray, painting: Painting, frame: int, options: DrawOptions) -> None:
    rows, xy = painting.trajectories.at(frame)
    radius = round(options.radius * options.scale * (1 << _SHIFT))
    for row, point in zip(rows.tolist(), _fixed_point(xy, options.scale).tolist(), strict=True):
        cv2.circle(canvas, point, radius, painting.colours[row].tolist(), cv2.FILLED, cv2.LINE_AA, _SHIFT)
        if painting.ringed is not None and painting.ringed[row]:
            for colour, width in ((_WHITE, 3), (WRONG, 1)):
                cv2.circle(canvas, point, 2 * radius, colour, width * options.scale, cv2.LINE_AA, _SHIFT)


def _fixed_point(xy: npt.NDArray[np.float64], scale: int) -> npt.NDArray[np.int32]:
    """Pixel coordinates in the enlarged picture, in OpenCV's fixed point."""
    enlarged = (np.clip(xy, -1e4, 1e5) + 0.5) * scale - 0.5
    return np.rint(enlarged * (1 << _SHIFT)).astype(np.int32)


def _draw_legend(canvas: ByteArray, title: str, legend: Legend, scale: int) -> None:
    lines = [*([(title, None)] if title else []), *legend]
    size, line = _FONT_SCALE * scale, _LINE * scale
    widest = max((cv2.getTextSize(text, _FONT, size, scale)[0][0] for text, _ in lines), default=0)
    if lines:
        canvas[: line * len(lines) + 8 * scale, : widest + 30 * scale] //= 4
    for number, (text, colour) in enumerate(lines):
        left, top = (6 if colour is None else 22) * scale, line * number + 5 * scale
        cv2.putText(canvas, text, (left, line * (number + 1)), _FONT, size, _WHITE, scale, cv2.LINE_AA)
        if colour is not None:
            cv2.rectangle(canvas, (7 * scale, top), (17 * scale, top + 9 * scale), colour, cv2.FILLED)
