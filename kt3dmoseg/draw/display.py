"""How values show themselves: tables for notebooks, plots with matplotlib (the extra ``plot``)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.draw.painting import Painting
from kt3dmoseg.draw.palette import PALETTE, Colour, css, label_colour
from kt3dmoseg.errors import InvalidValueError, MissingDependencyError
from kt3dmoseg.types import Clip, FloatArray, IntArray, Labels, Trajectories

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TRAIL = 8  # frames
_MARGIN = 5  # pixels
_DARK = "#14181f"  # the palette is made for dark frames


def html_table(
    title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], notes: Iterable[str] = ()
) -> str:
    """Lay out a table of texts; the first column is set left, the others right."""

    def line(tag: str, cells: Sequence[str]) -> str:
        sides = ("left", *["right"] * (len(cells) - 1))
        pairs = zip(sides, cells, strict=True)
        return "".join(
            f'<{tag} style="text-align:{side};padding:2px 8px">{_cell(cell)}</{tag}>' for side, cell in pairs
        )

    head = f"<thead><tr>{line('th', columns)}</tr></thead>" if any(columns) else ""
    body = "".join(f"<tr>{line('td', row)}</tr>" for row in rows)
    below = "".join(f"<div>{escape(note)}</div>" for note in notes)
    above = f"<div><b>{escape(title)}</b></div>" if title else ""
    return f"{above}<table>{head}<tbody>{body}</tbody></table>{below}"


class _Html(str):
    """Text that is HTML already."""

    __slots__ = ()


def _cell(text: str) -> str:
    return text if isinstance(text, _Html) else escape(text)


def labels_html(title: str, labels: Labels) -> str:
    """Table of the motions: colour, name, number of trajectories and share."""
    rows = []
    for value, name, size in _groups(labels):
        colour = css(label_colour(value, labels.background))
        swatch = _Html(f'<span style="color:{colour}">&#9632;</span> {value} {escape(name)}')
        rows.append((swatch, f"{size}", f"{100 * size / len(labels):.1f} %"))
    return html_table(title, ("motion", "trajectories", "share"), rows)


def clip_html(clip: Clip) -> str:
    """Facts of a clip, and its motions."""
    size, numbers = clip.dense.image_size, clip.frame_numbers
    facts = {
        "frames": f"{clip.n_frames}" + (f", {numbers[0]} to {numbers[-1]}" if len(numbers) else ""),
        "image size": f"{size[0]} x {size[1]} pixels" if size else "unknown",
        "trajectories": f"{len(clip.dense)}, {len(clip.evaluated)} of them evaluated",
        "camera": clip.camera.name if clip.camera else "",
    }
    table = html_table(f"Clip {clip.name}", ("", ""), [fact for fact in facts.items() if fact[1]])
    return table + labels_html("Motions of the evaluated trajectories", clip.labels)


def _groups(labels: Labels) -> list[tuple[int, str, int]]:
    """Value, name and size of every label that occurs, ascending."""
    called = {0: "unlabelled or outlier"} | dict(labels.names)
    if labels.background is not None:
        called.setdefault(labels.background, "background")
    values, sizes = np.unique(labels.label, return_counts=True)
    pairs = zip(values.tolist(), sizes.tolist(), strict=True)
    return [(value, called.get(value, ""), size) for value, size in pairs]


def plot_painting(
    painting: Painting,
    frame: int | None = None,
    *,
    title: str = "",
    picture: npt.ArrayLike | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot one frame with trails of 8 frames, or with `frame` None the whole trajectories.

    `picture` (H, W) or (H, W, 3) lies below; pixels as everywhere: x right, y down, from the centre of the
    top-left one.
    """
    tracks = painting.trajectories
    if frame is not None and not (isinstance(frame, (int, np.integer)) and 0 <= frame < tracks.n_frames):
        raise InvalidValueError("frame", expected=f"None or 0..{tracks.n_frames - 1}", found=f"{frame!r}")
    image = None if picture is None else _checked_picture(np.asarray(picture), tracks.image_size)
    low, high = _pixel_range(tracks, image)
    width, height = high - low
    made = _axes(ax, (8, min(8.0, 8 * height / width) + 1.2))  # first: it reports when matplotlib is missing
    from matplotlib.collections import LineCollection

    from_, to = (0, tracks.n_frames) if frame is None else (max(0, frame - _TRAIL), frame + 1)
    last = np.where(tracks.visible[:, :to], np.arange(to), -1).max(axis=1, initial=-1)
    rows = np.flatnonzero(last >= 0 if frame is None else last == frame)
    colours, (x, y) = painting.colours[rows] / 255, tracks.xy[rows, last[rows]].T
    made.set_facecolor(_DARK)
    if image is not None:
        made.imshow(image, cmap="gray", vmin=0, vmax=255)
    made.add_collection(LineCollection(list(tracks.xy[rows, from_:to]), colors=colours, linewidths=0.8))
    made.scatter(x, y, s=8, c=colours, linewidths=0, zorder=2)
    if painting.ringed is not None:
        wrong = painting.ringed[rows]
        made.scatter(x[wrong], y[wrong], s=36, facecolors="none", edgecolors="white", zorder=3)
    made.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]), aspect="equal", ylabel="pixels")
    made.set_title(", ".join(part for part in (title, "" if frame is None else f"frame {frame}") if part))
    _legend(made, painting.legend)
    return made


def plot_labels(labels: Labels, *, title: str = "", ax: Axes | None = None) -> Axes:
    """Bars of the number of trajectories of every motion."""
    made, groups = _axes(ax, (6, 0.4 * labels.n_motions + 1.5)), _groups(labels)
    colours = [css(label_colour(value, labels.background)) for value, *_ in groups]
    names = [f"{value} {name}".rstrip() for value, name, _ in groups]
    bars = made.barh(range(len(groups)), [size for *_, size in groups], color=colours)
    made.bar_label(bars, padding=3)
    made.set(yticks=range(len(groups)), yticklabels=names, xlabel="trajectories", title=title)
    made.margins(x=0.12)
    made.invert_yaxis()
    return made


def plot_clip_values(
    values: Mapping[str, FloatArray], clips: Sequence[str], *, axis: str, title: str, ax: Axes | None = None
) -> Axes:
    """One row per clip: the mean over seeds of each method (clips, seeds), a line from least to most."""
    made = _axes(ax, (7, 0.3 * len(clips) + 1.5))
    offsets = (np.arange(len(values)) - (len(values) - 1) / 2) * min(0.2, 0.8 / len(values))
    for number, ((name, value), offset) in enumerate(zip(values.items(), offsets, strict=True)):
        colour, y = css(PALETTE[number % len(PALETTE)]), np.arange(len(clips)) + offset
        made.hlines(y, value.min(axis=1), value.max(axis=1), color=colour, linewidth=1.5)
        made.scatter(
            value.mean(axis=1), y, s=28, color=colour, edgecolors="#333333", linewidths=0.5, zorder=2,
            label=f"{name}, mean {value.mean():.2f}",
        )  # fmt: skip
    made.set(yticks=range(len(clips)), yticklabels=clips, ylim=(len(clips) - 0.5, -0.5))
    made.set(xlabel=axis, title=title)
    made.grid(axis="x", alpha=0.3)
    made.legend(loc="upper left", bbox_to_anchor=(1, 1), frameon=False)
    return made


def group_labels(values: IntArray) -> Labels:
    """Predicted groups as labels, 0 called by its one meaning there."""
    return Labels(values, names={0: "outlier"})


def _axes(given: Axes | None, size: tuple[float, float]) -> Axes:
    if given is not None:
        return given
    try:
        from matplotlib import pyplot
    except ImportError:
        raise MissingDependencyError("plots need matplotlib", fix="pip install 'kt3dmoseg[plot]'") from None
    return pyplot.subplots(figsize=size, layout="constrained")[1]


def _checked_picture(
    picture: npt.NDArray[np.generic], size: tuple[int, int] | None
) -> npt.NDArray[np.generic]:
    shape = picture.shape
    if shape[2:] not in ((), (3,)) or len(shape) < 2 or (size and shape[1::-1] != size):
        wanted = f"({size[1]}, {size[0]})" if size else "(H, W)"
        raise InvalidValueError("picture", expected=f"{wanted}, or with 3 channels", found=f"shape {shape}")
    return picture


def _pixel_range(
    tracks: Trajectories, picture: npt.NDArray[np.generic] | None
) -> tuple[FloatArray, FloatArray]:
    """Least and largest x and y to show: those of the picture, or else of the points."""
    size = tracks.image_size or (None if picture is None else picture.shape[1::-1])
    if size is None and tracks.visible.any():
        points = tracks.xy[tracks.visible]
        return points.min(axis=0) - _MARGIN, points.max(axis=0) + _MARGIN
    return np.full(2, -0.5), np.array(size or (64, 48)) - 0.5


def _legend(ax: Axes, legend: Sequence[tuple[str, Colour]]) -> None:
    from matplotlib.lines import Line2D

    if not legend:
        return
    form: dict[str, Any] = {
        "linestyle": "",
        "marker": "o",
        "markeredgecolor": "#333333",
        "markeredgewidth": 0.5,
    }
    entries = [Line2D([], [], color=css(colour), label=text, **form) for text, colour in legend]
    ax.legend(handles=entries, loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=3, frameon=False)
