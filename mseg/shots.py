"""Shots of a video: cut, tracked, segmented, written; see `mseg.videos.video`."""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice, pairwise
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from kt3dmoseg.draw.painting import Painting, by_label, draw_frame
from kt3dmoseg.draw.palette import label_colour
from kt3dmoseg.errors import InputFileError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.files import PathLike, write_bytes
from kt3dmoseg.frames import FrameInfo, FrameSource, frames_of, part_of
from kt3dmoseg.io import load, save
from kt3dmoseg.io.images import davis_palette, encode_indices, gray, write_moving
from kt3dmoseg.matching import match_labels
from kt3dmoseg.text import count
from kt3dmoseg.tracking import find_cuts, track
from kt3dmoseg.types import ByteArray, Clip, IntArray, Labels, Trajectories
from mseg.errors import SegmentationError
from mseg.kernels import parts
from mseg.methods import segment
from mseg.spreading import dense_mask, spread_labels
from mseg.types import Segmentation

# Motions are found in this many frames at once; a longer shot is taken in parts that overlap.
_PART, _OVERLAP = 40, 10
_SHORTEST = 5  # frames of a trajectory
_DRAWN = 3000  # trajectories in the overlay
_TINT = 0.35  # of moving objects in it
# Share of the largest group, and least number of it, that is segmented the second time; the dataset draws a
# tenth of its background too.
_BACKGROUND, _FEWEST = 0.1, 200

_MOST_MOTIONS = 255  # of a mask
_APART = "parts of the shot have no trajectory in common; the largest motions of both are taken for one"

_Found: TypeAlias = tuple[IntArray, float | None, list[str]]  # labels, margin, notes
_Progress: TypeAlias = Callable[[int, int | None, str], None]
_Pictures: TypeAlias = Iterator[ByteArray]


@dataclass(frozen=True, eq=False)
class Shot:
    """A shot of a video; printed, it is one line: frames, trajectories, motions."""

    name: str  # of its files
    frames: int
    clip: Clip | None = None  # every trajectory, with its label: 1 is the largest motion, the background
    margin: float | None = None  # what the next best number of motions costs more, in the least sure part
    reason: str = ""  # why no motions were found; then there is no clip
    notes: tuple[str, ...] = ()  # what one must know to trust the motions, see `mseg.segment`

    def __str__(self) -> str:
        start = f"{self.name}: {count(self.frames, 'frame')}"
        if self.clip is None:
            return f"{start}, not segmented: {self.reason}"
        found = f"{len(self.clip.dense)} trajectories, {count(self.clip.n_motions, 'motion')}"
        more = "" if self.margin is None else f" (the next best number costs {self.margin:.1f} more)"
        return "; ".join((f"{start}, {found}{more}", *self.notes))


def clip_shot(path: Path, frames: PathLike | None) -> Iterator[tuple[Shot, _Pictures | None]]:
    """Give a clip file as a shot, with its frames if there are any."""
    clip = load(path)
    yield Shot(clip.name, clip.n_frames, clip), None if frames is None else iter(frames_of(clip, frames))


def tracked_shots(
    source: FrameSource, info: FrameInfo, flow: str, bar: _Progress
) -> Iterator[tuple[Shot, _Pictures]]:
    """Read frames three times, one by one: for cuts, trajectories, and what is written."""

    def shown(frames: _Pictures, total: int, text: str) -> _Pictures:
        for done, frame in enumerate(frames, start=1):
            bar(done, total, text)
            yield frame

    whole = source.name
    numbers = np.array(source.numbers())
    starts, count = find_cuts(shown(source.frames("luma"), len(numbers), "cuts"))
    to_track, to_show = source.frames("luma"), source.frames("stored")
    for k, (first, end) in enumerate(pairwise([*starts, count]), start=1):
        shot = Shot(f"{whole}_{k}" if len(starts) > 1 else whole, end - first)
        own = islice(to_track, shot.frames)
        try:
            frames = shown(own, shot.frames, f"{shot.name}: trajectories")
            tracks = track(frames, flow, min_length=min(_SHORTEST, shot.frames))
        except InvalidValueError as error:
            shot = replace(shot, reason=f"{error}")
            deque(own, maxlen=0)  # the next shot begins behind its frames
        else:
            labels, times = Labels(np.zeros(len(tracks), dtype=np.int64)), info.timestamps
            when = numbers[first:end], None if times is None else times[first:end]
            origin = {"source": part_of(source, info, *when[0][[0, -1]].tolist())}
            clip = Clip(shot.name, tracks, np.arange(len(tracks)), labels, *when, info.camera, origin)
            shot = replace(shot, clip=clip)
        yield shot, islice(to_show, shot.frames)


def segmented(shot: Shot, options: dict[str, Any], bar: _Progress) -> Shot:
    """Label every trajectory of a shot; the motions are numbered by size."""
    clip = shot.clip
    if clip is None:
        return shot
    try:
        labels, margin, notes = _motions(clip, options, bar)
    except KT3DMoSegError as error:
        return replace(shot, clip=None, reason=f"{error}")
    values, group = np.unique(labels, return_inverse=True)
    size = np.bincount(group, weights=clip.dense.lengths) * (values > 0)
    rank = 1 + np.argsort(np.argsort(-size, kind="stable"))
    found = Labels(np.where(values > 0, rank, 0)[group], background=1, names={1: "background"})
    origin = {**clip.provenance, "labels": {"found_by": "mseg video", **options}}
    clip = replace(clip, evaluated=np.arange(len(clip.dense)), labels=found, provenance=origin)
    if clip.n_motions > _MOST_MOTIONS:
        return replace(shot, clip=None, reason=f"{clip.n_motions} motions, more than a mask can hold")
    asked = options.get("n_motions")
    notes += (
        [f"groups found: {clip.n_motions}, asked for: {asked}"] if asked not in (None, clip.n_motions) else []
    )
    return replace(shot, clip=clip, margin=None if asked else margin, notes=(*dict.fromkeys(notes),))


def _motions(clip: Clip, options: dict[str, Any], bar: _Progress) -> _Found:
    """Label all trajectories, those of a long shot in parts, joined by the trajectories that they share."""
    if clip.n_frames <= _PART:
        return _segmented_twice(clip.dense, options, lambda half: bar(half, 2, f"{clip.name}: motions"))
    labels, margins, notes, failure = np.zeros(len(clip.dense), dtype=np.int64), [], list[str](), None
    firsts = range(0, clip.n_frames - _OVERLAP, _PART - _OVERLAP)
    for k, first in enumerate(firsts):
        step = partial(lambda k, half: bar(2 * k + half, 2 * len(firsts), f"{clip.name}: motions"), k)
        rows, tracks = _part(clip.dense, first, min(first + _PART, clip.n_frames))
        try:
            here, margin, known = _segmented_twice(tracks, options, step)
        except KT3DMoSegError as error:
            failure = error
            notes.append(f"frames from the {first + 1}th on: {error}")
            continue
        margins.append(margin)
        notes += known
        before = labels[rows]
        same = match_labels(here[before > 0], before[before > 0])
        if labels.any() and not before.any():
            same = {_largest(here): _largest(labels)}
            notes.append(_APART)
        new = [label for label in np.unique(here[here > 0]).tolist() if label not in same]
        same |= {label: int(labels.max()) + j for j, label in enumerate(new, start=1)}
        labels[rows] = np.where(before > 0, before, [same.get(label, 0) for label in here.tolist()])
    if failure and not labels.any():
        raise failure
    rows = np.flatnonzero(labels)
    least = min((margin for margin in margins if margin is not None), default=None)
    return spread_labels(clip.dense, rows, labels[rows]), least, notes


def _largest(labels: IntArray) -> int:
    """Return the label of most trajectories, 0 if none has one."""
    return int(np.bincount(labels[labels > 0], minlength=1).argmax())


def _segmented_twice(tracks: Trajectories, options: dict[str, Any], step: Callable[[int], None]) -> _Found:
    """Label all trajectories; the second time with a part of the largest group, in which small ones drown."""
    step(0)
    first = segment(tracks, rows="all", **options)
    if not first.labels.any():
        raise SegmentationError("video", expected="a motion", found="outliers only")
    of_largest = first.labels == _largest(first.labels)
    largest, others = np.flatnonzero(of_largest), np.flatnonzero(~of_largest)
    part = max(_FEWEST, round(_BACKGROUND * len(largest)))
    if not len(others) or part >= len(largest):
        return _found(tracks, first)
    drawn = np.random.default_rng(options.get("seed", 0)).choice(largest, part, replace=False)
    rows = np.union1d(drawn, others)
    thinned = Clip("shot", tracks, rows, Labels(np.zeros(len(rows), dtype=np.int64)))
    step(1)
    return _found(tracks, segment(thinned, rows="all", **options))


def _found(tracks: Trajectories, found: Segmentation) -> _Found:
    """Give the labels; of parts that no trajectory joins, the largest motions are one: the background."""
    labels, part, notes = np.array(found.labels), parts(tracks.visible, 1), [*found.report.get("notes", ())]
    background = _largest(labels[part <= 0])
    for k in range(1, part.max(initial=0) + 1):
        inside, own = part == k, _largest(labels[part == k])
        if not (own and background):
            continue
        labels[inside & (found.labels == background)] = labels.max() + 1
        labels[inside & (found.labels == own)] = background
    return labels, found.report.get("margin"), notes


def _part(tracks: Trajectories, first: int, last: int) -> tuple[IntArray, Trajectories]:
    """Cut some frames out of the trajectories that live long enough there; their rows."""
    seen = [tracks.at(frame) for frame in range(first, last)]
    rows, length = np.unique(np.concatenate([row for row, _ in seen]), return_counts=True)
    rows = rows[length >= _SHORTEST]
    xy = np.full((len(rows), last - first, 2), np.nan)
    for frame, (row, place) in enumerate(seen):
        _, at, of = np.intersect1d(rows, row, assume_unique=True, return_indices=True)
        xy[at, frame] = place[of]
    return rows, Trajectories(xy, np.isfinite(xy[..., 0]), image_size=tracks.image_size)


def write_shot(clip: Clip, pictures: _Pictures | None, folder: Path, rate: float, bar: _Progress) -> str:
    """Write a shot, the clip's file when the masks are there; return a note when there can be no overlay."""
    masks, note = folder / "masks" / clip.name, ""
    painted = _painted(clip, pictures, masks, bar)
    try:
        write_moving(folder / f"{clip.name}.mp4", painted, rate)
    except InputFileError as error:
        deque(painted, maxlen=0)
        if pictures is not None and not _mask(masks, clip.frame_numbers[-1]).is_file():
            raise
        note = f"; no overlay: {error}"
    save(clip, folder / f"{clip.name}.h5")
    return note


def _mask(folder: Path, number: int) -> Path:
    return folder / f"{number:05d}.png"


def _painted(clip: Clip, pictures: _Pictures | None, masks: Path, bar: _Progress) -> _Pictures:
    """Write the mask of every frame, and yield the frame with mask and trajectories drawn on it."""
    every, drawn = by_label(clip), np.unique(np.linspace(0, len(clip.dense) - 1, _DRAWN).astype(np.int64))
    painting = Painting(every.trajectories.select(drawn), every.colours[drawn], every.legend)
    palette = davis_palette()
    colours = np.array([label_colour(k, 1) for k in range(256)])
    for frame, number in enumerate(clip.frame_numbers.tolist()):
        bar(frame + 1, clip.n_frames, f"{clip.name}: masks and overlay")
        title = f"{clip.name}  frame {frame + 1}/{clip.n_frames}"
        if pictures is None:
            yield draw_frame(painting, frame, None, title)
            continue
        picture = next(pictures)
        rows, xy = clip.dense.at(frame)
        label = clip.labels.label[rows]
        mask = dense_mask(picture, xy[label > 0], label[label > 0])
        write_bytes(_mask(masks, number), encode_indices(np.maximum(mask, 1) - 1, palette))
        canvas, moves = draw_frame(painting, frame, gray(picture, clip.name, "luma"), title), mask > 1
        canvas[moves] = (1 - _TINT) * canvas[moves] + _TINT * colours[mask[moves]]
        yield canvas
