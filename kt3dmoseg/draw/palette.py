"""The one palette: the same label has the same colour in pictures, in reports and on the labelling page."""

from __future__ import annotations

from typing import TypeAlias

Colour: TypeAlias = tuple[int, int, int]
"""Red, green, blue, 0 to 255."""

# After Okabe and Ito (2008), distinct also with a colour vision deficiency; the blue is lighter, to be read
# on dark frames and below dark text. Label 1 comes first; vermillion, near the red of errors, comes last.
PALETTE: tuple[Colour, ...] = (
    (86, 180, 233),  # sky blue
    (230, 159, 0),  # orange
    (0, 158, 115),  # bluish green
    (240, 228, 66),  # yellow
    (204, 121, 167),  # reddish purple
    (0, 136, 204),  # blue
    (213, 94, 0),  # vermillion
)
BACKGROUND: Colour = (154, 167, 184)
UNLABELLED: Colour = (107, 114, 128)
REJECTED: Colour = (255, 77, 77)


def label_colour(label: int, background: int | None = None) -> Colour:
    """Colour of a label.

    Parameters
    ----------
    label : int
        0 (unlabelled) is dark gray; colours repeat after seven labels.
    background : int, optional
        The label of the static scene, which is light gray.
    """
    if label <= 0:
        return UNLABELLED
    return BACKGROUND if label == background else PALETTE[(label - 1) % len(PALETTE)]


def motion_colour(motion: int | str) -> Colour:
    """Colour of an annotated object's motion: m has label m + 1, 0 is static, "reject" is ambiguous."""
    return REJECTED if isinstance(motion, str) else label_colour(motion + 1, background=1)


def css(colour: Colour) -> str:
    """Write a colour as ``#rrggbb``."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def css_palette() -> dict[str, list[str] | str]:
    """Give web pages the palette: ``labels`` from 1 on, ``background``, ``unlabelled``, ``rejected``."""
    return {
        "labels": [css(colour) for colour in PALETTE],
        "background": css(BACKGROUND),
        "unlabelled": css(UNLABELLED),
        "rejected": css(REJECTED),
    }
