"""A box around a moving thing, or clicks on it, become its outline.

1. **Trajectories.** In a box, those that follow the affine motion of its middle rather than the scene around
   it. For a click, those nearest to it that move alike are seeds. Where motions were found before (`groups`),
   those of the seeds' group that chains of neighbours join to them belong to it, too; else the seeds grow by
   what follows their common affine motion, over up to four frames back and forth. Their bounds are the box.
2. **Pixels.** What speaks for the object: the middle of the box, a shape known from other frames, the hull of
   the trajectories, and that the frames before and after, moved by the object's motion, fit better than moved
   by that of the scene around it; weights are those of a logistic regression. A random walker (Grady,
   "Multilabel random walks using prior models", CVPR 2005) spreads this up to edges of the image; once more
   with the gray levels of what it found, and of what lies around.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import diags_array
from scipy.sparse.linalg import cg
from scipy.spatial import cKDTree

from kt3dmoseg.annotate.formats.masks import mask_of, polygons_of
from kt3dmoseg.annotate.geometry import arrays, bounds, median, signed_distance, without_specks
from kt3dmoseg.annotate.model import LEAST_BOX, Box, Click, Polygon, Stroke
from kt3dmoseg.neighbours import connected
from kt3dmoseg.types import BoolArray, ByteArray, Float32Array, FloatArray, IntArray, Trajectories

Frames: TypeAlias = Callable[[int], ByteArray]
"""The gray frame (H, W) of an index."""

_GAPS = (-4, -3, -2, -1, 1, 2, 3, 4)
# Neighbours on one object, and seeds around a click, are at most this far apart, in pixels; in one round
# what grew takes in what is at most so far from its bounds.
_REACH, _ROUND_REACH = 28.0, 84.0
_SEEDS = 6
_ROUNDS = 8
# A trajectory follows a motion when it is off it by less than this: pixels, more for each frame of the gap,
# a share of the difference to the scene's motion, a share of the motion where the scene's is not known.
_OFF, _OFF_A_FRAME, _OF_CONTRAST, _OF_MOTION = 0.5, 0.15, 0.4, 0.06
_MOSTLY = 0.6
# What grew to a larger share of all than this, without a group that bounds it, took the scene for the object.
_MOST_GROWN = 0.12
_AROUND, _NEIGHBOURS = 9, 5
_STIFF = 200.0
# In a box: its middle, in half its sides; how much that is trusted where motions hardly differ; the fewest
# trajectories; what convinces: pixels, and a share of the difference of the motions.
_INNER, _TRUST, _ENOUGH, _OFF_BOXED, _OF_BOXED = 0.7, 0.35, 3, 0.4, 0.25
# Pixels around a click's trajectories, and the view around a box: pixels and a share; at most so many pixels.
_MARGIN, _BORDER, _BORDER_SHARE, _MOST_PIXELS = 7.0, 8.0, 0.2, 15_000
# Evidence: frames back and forth, gray levels that convince, and those that count at most, of squares.
_PAIRS, _CONVINCING, _MOST_GRAY, _SQUARE = (1, 2, 3), 4.0, 60.0, 7
# Logarithm of the odds of the object: in the middle, less towards the sides and the upper corners; evidence;
# inside the trajectories' hull, up to a share of the box's size from its edge.
_MIDDLE, _SIDES, _TAPER, _EVIDENCE, _HULL, _HULL_SHARE, _NEAR = 2.1, 3.2, 1.0, 1.0, 0.5, 0.12, 4.0
# A box this near to the picture's edge goes on beyond it, by a share of its side.
_AT_EDGE, _BEYOND = 4.0, 0.4
# A known shape, fitted to the box: its odds, the share of the box's size over which they change, and what
# part of the odds of a box is kept beside them.
_SHAPE, _SHAPE_SHARE, _BESIDE_SHAPE = 2.0, 0.15, 0.5
# A shape without a box: its odds, which change over this many pixels at least.
_CARRIED, _BLURRED = 4.0, 3.0
# Gray levels of the outline found first: their weight, how many count as one, their largest odds.
_GRAYS, _LEVEL, _MOST_GRAY_ODDS = 1.0, 8, 2.0
# Strength of the odds next to the picture's edges; a click: its strength and reach, in shares of the box.
_STRENGTH, _MOST_ODDS, _CERTAIN, _PULL, _PULL_SHARE = 0.05, 6.0, 3.0, 0.13, 0.1
_SMOOTH, _LEAK, _ITERATIONS = 0.5, 0.01, 80
_TOLERANCE = 0.7
_FINE = 3  # of the brush: cells per pixel


class Steps:
    """Where the n trajectories seen in a frame are in the G frames around it; `groups` (N,), 1 = scene."""

    def __init__(self, tracks: Trajectories, frame: int, groups: IntArray | None) -> None:
        self.rows, self.xy = tracks.at(frame)
        self.gaps = np.array([gap for gap in _GAPS if 0 <= frame + gap < tracks.n_frames], dtype=np.int64)
        self.step = np.swapaxes(tracks.xy[self.rows][:, frame + self.gaps], 0, 1) - self.xy
        self.tree = cKDTree(self.xy)
        known = np.ones(len(tracks), dtype=np.int64) if groups is None else groups
        self.groups = known[self.rows]

    def affine(self, member: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Centre (2,) and matrices (G, 3, 2) of the members' robust affine steps; few members only shift."""
        centre = self.xy[member].mean(axis=0)
        h = np.column_stack([self.xy[member] - centre, np.ones(member.sum())])
        step = self.step[:, member]
        known = np.isfinite(step[..., 0])
        step, weight = np.nan_to_num(step), known.astype(np.float64)
        for _ in range(4):
            weighted = h.T[None] * weight[:, None]
            model = np.linalg.solve(weighted @ h + np.diag([_STIFF, _STIFF, 1e-6]), weighted @ step)
            off = np.where(known, np.linalg.norm(step - h @ model, axis=2), np.nan)
            with np.errstate(invalid="ignore"):
                scale = np.fmax(0.5, 1.5 * median(off, 1))[:, None]
            weight = known / (1 + (np.nan_to_num(off) / scale) ** 2) ** 2
        model[known.sum(axis=1) < 3] = np.nan
        return centre, model

    def followed(self, member: BoolArray, rows: IntArray) -> FloatArray:
        """Return the steps (G, R, 2) of rows if they moved as the members do, and as their neighbours."""
        centre, model = self.affine(member)
        steps = np.column_stack([self.xy - centre, np.ones(len(self.xy))]) @ model
        own = self.around(member, self.step - steps, _NEIGHBOURS, rows)
        return np.asarray(steps[:, rows] + np.nan_to_num(own))

    def around(self, chosen: BoolArray, values: FloatArray, count: int, rows: IntArray) -> FloatArray:
        """Median (G, R, 2), for each row, of values (G, n, 2) at the nearest chosen ones, without itself."""
        at = np.flatnonzero(chosen)
        if len(at) < count:
            return np.full((len(values), len(rows), 2), np.nan)
        near = at[cKDTree(self.xy[at]).query(self.xy[rows], k=count)[1]]
        own = near == rows[:, None]
        return median(np.where(own[None, ..., None], np.nan, values[:, near]), 2)

    def near(self, member: BoolArray) -> IntArray:
        """Return the rows that may join the members in one round."""
        low, high = self.xy[member].min(axis=0), self.xy[member].max(axis=0)
        off = np.maximum(low - self.xy, self.xy - high).max(axis=1)
        return np.flatnonzero(off <= _ROUND_REACH)

    def joined(self, rows: IntArray, seeds: BoolArray) -> BoolArray:
        """Those that chains of the rows join to the seeds, (n,)."""
        at, out = np.union1d(rows, np.flatnonzero(seeds)), seeds.copy()
        pairs = at[cKDTree(self.xy[at]).query_pairs(_REACH, output_type="ndarray")]
        for part in connected(pairs, at, smallest=2):
            out[part] |= seeds[part].any()
        return out

    def own_group(self, chosen: BoolArray) -> int:
        """Return the group that most of the chosen have."""
        return int(np.bincount(self.groups[chosen], minlength=2).argmax())


def seeds_at(steps: Steps, x: float, y: float) -> BoolArray:
    """Find the trajectories nearest to a point, (n,)."""
    distance, near = map(np.asarray, steps.tree.query((x, y), k=range(1, min(_SEEDS, len(steps.rows)) + 1)))
    out = np.zeros(len(steps.rows), dtype=np.bool_)
    out[near[distance <= max(_REACH, 1.5 * distance[0])]] = True
    return out


def grown(steps: Steps, seeds: BoolArray) -> BoolArray:
    """Return the trajectories that move with the seeds, (n,)."""
    own = steps.own_group(seeds)
    if own > 1:
        seeds = seeds | steps.joined(np.flatnonzero(steps.groups == own), seeds)
    allowed = _OFF + _OFF_A_FRAME * np.abs(steps.gaps)[:, None]
    member = seeds
    for k in range(_ROUNDS):
        rows = steps.near(member)
        step, fit = steps.step[:, rows], steps.followed(member, rows)
        off = np.linalg.norm(step - fit, axis=2)
        with np.errstate(invalid="ignore"):
            if own <= 1 and k < _ROUNDS - 2:  # what is scene is not known: it may hold the object, too
                ok = off < allowed + _OF_MOTION * np.linalg.norm(fit, axis=2)
            else:
                scene = steps.around(~member & (steps.groups == 1), steps.step, _AROUND, rows)
                ok = off < np.fmax(allowed, _OF_CONTRAST * np.linalg.norm(fit - scene, axis=2))
                ok &= ~(np.linalg.norm(step - scene, axis=2) < off)
        most = np.maximum(_MOSTLY * np.isfinite(off).sum(axis=0), 1)
        new = steps.joined(rows[ok.sum(axis=0) >= most], seeds)
        if (new == member).all() and (own > 1 or k > _ROUNDS - 2):
            break
        member = new
    return seeds if own <= 1 and member.mean() > _MOST_GROWN else member


def boxed(steps: Steps, box: Box) -> BoolArray:
    """Return the trajectories in a box that move as its middle does rather than as the scene around, (n,)."""
    centre, half = np.add(box[:2], box[2:]) / 2, np.subtract(box[2:], box[:2]) / 2
    off_centre = np.abs(steps.xy - centre) / half
    radius, inside = np.linalg.norm(off_centre, axis=1), off_centre.max(axis=1) < 1
    member = radius < _INNER
    member = member if member.sum() >= _ENOUGH else inside
    rows = np.flatnonzero(inside)
    step, scene = steps.step[:, rows], steps.around(~inside, steps.step, _AROUND, rows)
    scene_off = np.linalg.norm(step - scene, axis=2)
    for _ in range(_ROUNDS // 2):
        if member.sum() < _ENOUGH or inside.all():
            break
        fit = steps.followed(member, rows)
        off = np.linalg.norm(step - fit, axis=2)
        apart = _OFF_BOXED + _OF_BOXED * np.linalg.norm(fit - scene, axis=2)
        votes = np.clip((scene_off - off) / apart, -1, 1)
        known = np.maximum(np.isfinite(votes).sum(axis=0), 1)
        member = np.zeros_like(inside)
        member[rows] = np.nansum(votes, axis=0) / known + _TRUST * np.clip(1 - radius[rows] ** 2, -1, 1) > 0
    return np.asarray(member if member.sum() >= _ENOUGH else inside)


def box_around(steps: Steps, added: FloatArray) -> FloatArray:
    """Return the corners (2, 2) of what moves with clicked places (C, 2)."""
    chosen = np.zeros(len(steps.rows), dtype=np.bool_)
    for x, y in added:
        seeds = seeds_at(steps, x, y)
        # In the scene's group a second click cannot know how far it goes.
        chosen = chosen | (grown(steps, seeds) if not chosen.any() or steps.own_group(seeds) > 1 else seeds)
    points = np.concatenate([steps.xy[chosen], added])
    return np.array([points.min(axis=0) - _MARGIN, points.max(axis=0) + _MARGIN])


def outline_clicks(
    frames: Frames,
    tracks: Trajectories,
    frame: int,
    clicks: Sequence[Click],
    box: Box | None = None,
    groups: Sequence[IntArray] = (),
    like: Sequence[Polygon] = (),
) -> list[Polygon]:
    """Outline what moves in a box, or with the clicked places (x, y, adds) of a frame, all in pixels.

    Without a box the first click adds, and of `groups` (N,), motions of trajectories with 1 = scene, the
    first counts by which that place moves by itself. `like` is the shape to expect in a box, such as what is
    carried there; without a box, clicks in and near it correct it. No polygon: nothing is left or, without
    both, fewer than six trajectories are seen.
    """
    added = np.array([click[:2] for click in clicks if click[2]]).reshape(-1, 2)
    if box is None and like and _is_near(clicks[0], like):
        return sharpened(frames, tracks, frame, arrays(like), clicks)
    steps, corners = Steps(tracks, frame, None), added
    if box is not None:
        corners = np.array([box[:2], box[2:], *added])
    elif len(steps.rows) < _SEEDS or not len(steps.gaps) or not clicks[0][2]:
        return []
    else:
        for known in groups:
            grouped = Steps(tracks, frame, known)
            if grouped.own_group(seeds_at(grouped, *added[0])) > 1:
                steps = grouped
                break
        corners = box_around(steps, added)
    last = np.array(frames(frame).shape[::-1]) - 1
    low, high = np.clip([corners.min(axis=0), corners.max(axis=0)], 0, last).tolist()
    shape = [] if box is None else _fitted(like, last, np.array([low, high]))
    return _outlined(_cut(frames, steps, boxed(steps, (*low, *high)), frame, (*low, *high), clicks, shape))


def sharpened(
    frames: Frames,
    tracks: Trajectories,
    frame: int,
    shape: Sequence[FloatArray],
    clicks: Sequence[Click] = (),
) -> list[Polygon]:
    """Outline again polygons (P, 2) that were carried to a frame, by its edges and motion, and by clicks.

    Empty where less than 3 pixels of it are in the picture.
    """
    last = np.array(frames(frame).shape[::-1]) - 1
    left, top, right, bottom = bounds(shape)
    corners = np.array([(left, top), (right, bottom), *(click[:2] for click in clicks if click[2])])
    low, high = np.clip([corners.min(axis=0), corners.max(axis=0)], 0, last).tolist()
    if min(np.subtract(high, low)) < LEAST_BOX:
        return []
    steps = Steps(tracks, frame, None)
    member = signed_distance(steps.xy, shape, 0.0) >= 0
    member &= member.sum() >= _ENOUGH
    return _outlined(_cut(frames, steps, member, frame, (*low, *high), clicks, shape, carried=True))


def _is_near(click: Click, shape: Sequence[Polygon]) -> bool:
    """Whether a place is in the box around a shape, made twice as wide and high."""
    left, top, right, bottom = bounds(arrays(shape))
    x, y = click[0] - (left + right) / 2, click[1] - (top + bottom) / 2
    return abs(x) <= right - left and abs(y) <= bottom - top


def painted(stroke: Stroke, image_size: tuple[int, int]) -> list[Polygon]:
    """Return the outline after a stroke of the brush; accurate to a third of a pixel."""
    fine = [(polygon + 0.5) * _FINE - 0.5 for polygon in arrays(stroke.polygons)]
    mask = mask_of(fine, (image_size[0] * _FINE, image_size[1] * _FINE))
    line = np.rint((np.array(stroke.stroke) + 0.5) * _FINE - 0.5).astype(np.int32)
    free = cv2.polylines(np.ones(mask.shape, dtype=np.uint8), [np.concatenate([line, line[-1:]])], False, 0)
    disc = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) < stroke.radius * _FINE
    mask = mask | disc if stroke.adds else mask & ~disc
    found = polygons_of(mask, tolerance=0.4 * _FINE)
    return [tuple(((x + 0.5) / _FINE - 0.5, (y + 0.5) / _FINE - 0.5) for x, y in p) for p in found]


def _fitted(shape: Sequence[Polygon], last: IntArray, box: FloatArray) -> list[FloatArray]:
    """Fit what the picture shows of a shape to the corners (2, 2) of a box."""
    shown = [np.clip(polygon, 0, last) for polygon in arrays(shape)]
    if not shown:
        return []
    left, top, right, bottom = bounds(shown)
    scale = (box[1] - box[0]) / np.maximum((right - left, bottom - top), 1.0)
    return [(polygon - (left, top)) * scale + box[0] for polygon in shown]


def _outlined(mask: BoolArray) -> list[Polygon]:
    """Outline a mask (H, W): without specks, smooth, with few corners."""
    return without_specks(polygons_of(cv2.medianBlur(mask.astype(np.uint8), 5) > 0, tolerance=_TOLERANCE))


def _cut(
    frames: Frames,
    steps: Steps,
    member: BoolArray,
    frame: int,
    box: Box,
    clicks: Sequence[Click],
    shape: Sequence[FloatArray],
    carried: bool = False,
) -> BoolArray:
    """Mask (H, W) of what is in the box, moves with the members and is like a shape, if there is one."""
    height, width = frames(frame).shape
    out, view = np.zeros((height, width), dtype=np.bool_), _View(box, (width, height))
    here = cv2.remap(frames(frame), view.x, view.y, cv2.INTER_LINEAR).astype(np.float32)
    size = np.sqrt((box[2] - box[0]) * (box[3] - box[1]))
    odds = _expected(view, box, shape, carried)
    if member.any():
        if not carried:
            hull = cv2.convexHull(steps.xy[member].astype(np.float32))[:, 0]
            odds += _HULL * np.clip(view.depth([hull]) / max(_NEAR, _HULL_SHARE * size), -1, 1)
        odds += _EVIDENCE * _evidence(frames, steps, member, frame, view, here)
    inside = _walk(here, _field(odds, view, clicks, size)) > 0
    odds += _GRAYS * _gray_odds(here, inside)
    found = _walk(here, _field(odds, view, clicks, size))
    left, top, right, bottom = view.box
    soft = cv2.resize(found, (right - left, bottom - top), interpolation=cv2.INTER_LINEAR)
    out[top:bottom, left:right] = soft > 0
    return out


def _expected(view: _View, box: Box, shape: Sequence[FloatArray], carried: bool) -> FloatArray:
    """Logarithm of the odds of the object by its box and shape; by the shape alone where that was carried."""
    low, high, last = np.array(box[:2]), np.array(box[2:]), np.array(view.image_size) - 1
    odds: Any = 0.0
    if shape:
        share = max(_BLURRED, _SHAPE_SHARE * np.sqrt((high - low).prod()))
        odds = (_CARRIED if carried else _SHAPE) * np.clip(view.depth(shape) / share, -1, 1)
    if carried:
        return np.asarray(odds)
    beyond = _BEYOND * (high - low)  # what the picture's edge cuts goes on there
    low, high = (
        np.where(low < _AT_EDGE, low - beyond, low),
        np.where(high > last - _AT_EDGE, high + beyond, high),
    )
    centre, half = (low + high) / 2, (high - low + 1) / 2
    u, v = (view.x - centre[0]) / half[0], (view.y - centre[1]) / half[1]
    middle = _MIDDLE - _SIDES * (u**4 + v**4) + _TAPER * u**2 * v
    return np.asarray(odds + (_BESIDE_SHAPE if shape else 1.0) * middle)


def _field(odds: FloatArray, view: _View, clicks: Sequence[Click], size: float) -> FloatArray:
    """Strength of the odds next to the picture's edges, and of clicks."""
    field = _STRENGTH * np.clip(odds, -_MOST_ODDS, _MOST_ODDS)
    reach = _PULL_SHARE * size + 2
    for x, y, adds in clicks:
        sign = 1.0 if adds else -1.0
        field += sign * _PULL * np.exp(-((view.x - x) ** 2 + (view.y - y) ** 2) / (2 * reach**2))
    for x, y, adds in clicks:
        field = np.where(view.disc(x, y), _CERTAIN if adds else -_CERTAIN, field)
    return np.asarray(field)


def _gray_odds(here: Float32Array, inside: BoolArray) -> Float32Array:
    """Logarithm of how much more often a pixel's gray level occurs inside than outside."""
    level = np.minimum(here / _LEVEL, 255 // _LEVEL).astype(np.int64)
    counts = [np.bincount(level[part], minlength=256 // _LEVEL) + 1.0 for part in (inside, ~inside)]
    share = [gaussian_filter1d(count, 1.0) / count.sum() for count in counts]
    odds = np.log(share[0] / share[1])[level].astype(np.float32)
    return np.asarray(np.clip(cv2.blur(odds, (3, 3)), -_MOST_GRAY_ODDS, _MOST_GRAY_ODDS))


class _View:
    """What is in and around a box of the image, at a scale at which it has few enough pixels."""

    def __init__(self, box: Box, image_size: tuple[int, int]) -> None:
        self.image_size = image_size
        low, high = np.array(box[:2]), np.array(box[2:])
        border = _BORDER + _BORDER_SHARE * (high - low)
        left, top = np.maximum(low - border, 0).astype(int).tolist()
        right, bottom = np.minimum(high + border + 1, image_size).astype(int).tolist()
        self.box = left, top, right, bottom
        self.scale = min(1.0, float(np.sqrt(_MOST_PIXELS / ((right - left) * (bottom - top)))))
        self.width = max(2, round((right - left) * self.scale))
        self.height = max(2, round((bottom - top) * self.scale))
        xs = (np.arange(self.width) + 0.5) / self.scale - 0.5 + left
        ys = (np.arange(self.height) + 0.5) / self.scale - 0.5 + top
        self.x, self.y = (grid.astype(np.float32) for grid in np.meshgrid(xs, ys))

    def disc(self, x: float, y: float) -> BoolArray:
        """Whether a pixel is the clicked one, or near it."""
        return np.asarray(np.hypot(self.x - x, self.y - y) <= max(3.0, 0.8 / self.scale))

    def depth(self, polygons: Sequence[Any]) -> Float32Array:
        """How deep a pixel is in polygons, in pixels of the image; negative outside."""
        inside = np.zeros((self.height + 2, self.width + 2), dtype=np.uint8)
        corners = [np.rint((p - self.box[:2] + 0.5) * self.scale + 0.5).astype(int) for p in polygons]
        cv2.fillPoly(inside, corners, 1)
        deep, off = (cv2.distanceTransform(part, cv2.DIST_L2, 5) for part in (inside, 1 - inside))
        return np.asarray((deep - off)[1:-1, 1:-1] / self.scale, dtype=np.float32)


def _evidence(
    frames: Frames, steps: Steps, member: BoolArray, frame: int, view: _View, here: Float32Array
) -> Float32Array:
    """Show per pixel of the view, -1 to 1, how much better the members' motion explains it."""
    centre, model = steps.affine(member)
    flat = np.stack([view.x - centre[0], view.y - centre[1], np.ones_like(view.x)], axis=-1)
    background = _background(steps, ~member & (steps.groups == 1), view)
    total = np.zeros_like(here)
    for pair in _PAIRS:
        errors: list[tuple[Float32Array, Float32Array]] = []
        for k in np.flatnonzero(np.abs(steps.gaps) == pair):
            if np.isfinite(model[k]).all():
                other = frames(frame + int(steps.gaps[k]))
                moves = (flat @ model[k]).astype(np.float32), background[k]
                errors.append((_misfit(here, other, view, moves[0]), _misfit(here, other, view, moves[1])))
        if errors:  # what is hidden before or after is seen on the other side
            own, scene = (np.min(side, axis=0) for side in zip(*errors, strict=True))
            total += np.clip((scene - own) / _CONVINCING, -1, 1)
    return np.asarray(total / len(_PAIRS), dtype=np.float32)


def _background(steps: Steps, scene: BoolArray, view: _View) -> Float32Array:
    """Carry the scene's motion (G, h, w, 2) from the trajectories nearest to nodes 8 pixels apart."""
    left, top, right, bottom = view.box
    xs, ys = np.arange(left, right + 8, 8.0), np.arange(top, bottom + 8, 8.0)
    nodes = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)
    at = np.flatnonzero(scene)
    if len(at) < _AROUND:
        return np.zeros((len(steps.gaps), *view.x.shape, 2), dtype=np.float32)
    near = at[cKDTree(steps.xy[at]).query(nodes, k=_AROUND)[1]]
    field = np.nan_to_num(median(steps.step[:, near], 2)).astype(np.float32)
    grid = (view.x - left) / 8, (view.y - top) / 8
    return np.stack([cv2.remap(f.reshape(len(ys), len(xs), 2), *grid, cv2.INTER_LINEAR) for f in field])


def _misfit(here: Float32Array, other: ByteArray, view: _View, move: Float32Array) -> Float32Array:
    x, y = view.x + move[..., 0], view.y + move[..., 1]
    moved = cv2.remap(other, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float32)
    seen = (x > 0) & (x < other.shape[1]) & (y > 0) & (y < other.shape[0])
    error = np.where(seen, np.minimum(np.abs(moved - here), _MOST_GRAY), _MOST_GRAY).astype(np.float32)
    return np.asarray(cv2.boxFilter(error, -1, (_SQUARE, _SQUARE)), dtype=np.float32)


def _walk(here: Float32Array, field: FloatArray) -> Float32Array:
    """Spread a field to where the picture has no edge: the random walker's system, by conjugate gradients."""
    smooth = cv2.GaussianBlur(here, (0, 0), _SMOOTH)
    dx, dy = np.diff(smooth, axis=1) ** 2, np.diff(smooth, axis=0) ** 2
    soft = max(float(dx.mean() + dy.mean()) / 2, 1.0)
    right = np.pad(np.exp(-dx / soft) + _LEAK, ((0, 0), (0, 1))).ravel()[:-1]
    below = (np.exp(-dy / soft) + _LEAK).ravel()
    width, own = here.shape[1], np.abs(field).ravel() + 1e-4
    wish = np.sign(field).ravel()
    bands: Any = [right, right, below, below]
    links = diags_array(bands, offsets=[1, -1, width, -width], format="csr")
    diagonal = own + links.sum(axis=1)
    system = diags_array(diagonal, format="csr") - links
    preconditioner = diags_array(1 / diagonal)
    spread, _ = cg(system, own * wish, wish, rtol=1e-2, maxiter=_ITERATIONS, M=preconditioner)
    return np.asarray(spread.reshape(here.shape), dtype=np.float32)
