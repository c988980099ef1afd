"""How values show themselves: tables for notebooks, plots with matplotlib (the extra ``plot``)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from jinja2 import Template
from markupsafe import Markup

from kt3dmoseg.draw.painting import Painting, groups
from kt3dmoseg.draw.palette import PALETTE, WRONG, css, label_colour
from kt3dmoseg.errors import InvalidValueError, optional
from kt3dmoseg.types import Clip, FloatArray, IntArray, Labels

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TRAIL = 8  # frames
_DARK, _EDGE = "#14181f", "#333333"  # the palette is made for dark frames
_TABLE = Template(
    """{%- macro row(tag, cells) %}<tr>{% for cell in cells -%}
<{{ tag }} style="text-align:{{ 'left' if loop.first else 'right' }};padding:2px 8px">{{ cell }}</{{ tag }}>
{%- endfor %}</tr>{% endmacro -%}
{% if title %}<div><b>{{ title }}</b></div>{% endif %}<table>
{%- if columns | join %}<thead>{{ row("th", columns) }}</thead>{% endif -%}
<tbody>{% for cells in rows %}{{ row("td", cells) }}{% endfor %}</tbody></table>
{%- for note in notes %}<div>{{ note }}</div>{% endfor %}""",
    autoescape=True,
)


def html_table(
    title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], notes: Iterable[str] = ()
) -> str:
    """Lay out a table of texts; the first column is set left, the others right."""
    return str(_TABLE.render(title=title, columns=columns, rows=rows, notes=notes))


def labels_html(title: str, labels: Labels) -> str:
    """Table of the motions: colour, name, number of trajectories and share."""
    swatch, rows = Markup('<span style="color:{}">&#9632;</span> {} {}'), []
    for value, name, size in groups(labels):
        colour = css(label_colour(value, labels.background))
        share = f"{100 * size / len(labels):.1f} %"
        rows.append((swatch.format(colour, value, name), f"{size}", share))
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


def plot_painting(
    painting: Painting,
    frame: int | None = None,
    *,
    title: str = "",
    picture: npt.ArrayLike | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot one frame with trails of 8 frames, or with `frame` None the whole trajectories.

    `picture` (H, W) or (H, W, 3), uint8 or 0 to 1, lies below; pixels as everywhere: x right, y down, from
    the centre of the top-left one.
    """
    tracks = painting.trajectories
    if frame is not None and not (isinstance(frame, (int, np.integer)) and 0 <= frame < tracks.n_frames):
        raise InvalidValueError("frame", expected=f"None or 0..{tracks.n_frames - 1}", found=f"{frame!r}")
    image = None if picture is None else _checked_picture(np.asarray(picture), tracks.image_size)
    size = tracks.image_size if image is None else image.shape[1::-1]
    width, height = size or (4, 3)
    made = _axes(ax, (8, min(8.0, 8 * height / width) + 1.2))  # first: it reports when matplotlib is missing
    from matplotlib.collections import LineCollection
    from matplotlib.patheffects import withStroke

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
        rings = made.scatter(x[wrong], y[wrong], s=36, facecolors="none", edgecolors=css(WRONG), zorder=3)
        rings.set(linewidths=0.9, path_effects=[withStroke(linewidth=2.2, foreground="white")])
    made.set(aspect="equal", ylabel="pixels")
    if size:
        made.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
    elif not made.yaxis_inverted():
        made.invert_yaxis()
    made.set_title(", ".join(part for part in (title, "" if frame is None else f"frame {frame}") if part))
    for text, colour in painting.legend:
        made.scatter([], [], color=css(colour), edgecolors=_EDGE, linewidths=0.5, label=text)
    if painting.legend:
        made.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=3, fontsize="small", frameon=False)
    return made


def _checked_picture(
    picture: npt.NDArray[np.generic], size: tuple[int, int] | None
) -> npt.NDArray[np.generic]:
    shape = picture.shape
    if shape[2:] not in ((), (3,)) or len(shape) < 2 or (size and shape[1::-1] != size):
        wanted = f"{size[::-1]}" if size else "(H, W)"
        raise InvalidValueError("picture", expected=f"{wanted}, or with 3 channels", found=f"shape {shape}")
    values: Any = picture
    if picture.dtype.kind == "f" and ((values >= 0) & (values <= 1)).all():
        return np.asarray(np.rint(255 * picture), dtype=np.uint8)  # as matplotlib reads files
    if picture.dtype != np.uint8:
        raise InvalidValueError("picture", expected="uint8, or 0 to 1", found=f"{picture.dtype}")
    return picture


def plot_labels(labels: Labels, *, ax: Axes | None = None) -> Axes:
    """Bars of the number of trajectories of every motion."""
    made, found = _axes(ax, (6, 0.4 * labels.n_motions + 1.5)), groups(labels)
    colours = [css(label_colour(value, labels.background)) for value, *_ in found]
    names = [f"{value} {name}".rstrip() for value, name, _ in found]
    bars = made.barh(range(len(found)), [size for *_, size in found], color=colours)
    made.bar_label(bars, padding=3)
    made.set(yticks=range(len(found)), yticklabels=names, xlabel="trajectories")
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
        mean, text = value.mean(axis=1), f"{name}, mean {value.mean():.2f}"
        made.hlines(y, value.min(axis=1), value.max(axis=1), color=colour, linewidth=1.5)
        made.scatter(mean, y, s=28, color=colour, edgecolors=_EDGE, linewidths=0.5, zorder=2, label=text)
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
    pyplot = optional("matplotlib.pyplot", "plots need", "plot")
    axes: Axes = pyplot.subplots(figsize=size, layout="constrained")[1]
    return axes
