"""The one palette: the same label has the same colour in pictures, in reports and on the labelling page."""

from typing import TypeAlias

Colour: TypeAlias = tuple[int, int, int]
"""Red, green, blue, 0 to 255."""

# Optimized for the largest CIELAB distance of the closest two, the grays below included, under normal vision,
# protanopia, deuteranopia and tritanopia as Machado, Oliveira and Fernandes (2009) simulate them: 15 or more.
# Light enough for dark text and dark frames. Sky blue and orange are those of Okabe and Ito (2008); of the
# others, each is the one farthest from all before it.
PALETTE: tuple[Colour, ...] = (
    (86, 180, 233),  # sky blue
    (230, 159, 0),  # orange
    (225, 240, 180),  # cream
    (0, 255, 255),  # cyan
    (255, 225, 15),  # yellow
    (240, 30, 255),  # magenta
    (195, 255, 135),  # lime
    (60, 165, 90),  # green
    (225, 105, 30),  # vermillion
    (165, 255, 225),  # mint
    (135, 210, 165),  # sage
    (90, 225, 75),  # bright green
)
BACKGROUND: Colour = (154, 167, 184)
UNLABELLED: Colour = (107, 114, 128)
REJECTED: Colour = (255, 77, 77)
WRONG: Colour = (227, 23, 10)  # the ring of an error, within a wider white one


def label_colour(label: int, background: int | None = None) -> Colour:
    """Colour of a label: dark gray for 0, unlabelled, light gray for the background; they repeat after 12."""
    if label <= 0:
        return UNLABELLED
    return BACKGROUND if label == background else PALETTE[(label - 1) % len(PALETTE)]


def css(colour: Colour) -> str:
    """Write a colour as ``#rrggbb``."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def css_palette() -> dict[str, list[str] | str]:
    """Give web pages the palette: ``labels`` from 1 on, and the colours with names."""
    return {
        "labels": [css(colour) for colour in PALETTE],
        "background": css(BACKGROUND),
        "unlabelled": css(UNLABELLED),
        "rejected": css(REJECTED),
        "wrong": css(WRONG),
    }
