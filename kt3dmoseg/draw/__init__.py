"""Pictures of trajectories with trails, on the frames or on black."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from kt3dmoseg.draw.palette import PALETTE, UNLABELLED, label_colour
from kt3dmoseg.options import option
from kt3dmoseg.registry import lazy

if TYPE_CHECKING:
    from kt3dmoseg.draw.painting import Painting as Painting
    from kt3dmoseg.draw.painting import by_label as by_label
    from kt3dmoseg.draw.painting import by_length as by_length
    from kt3dmoseg.draw.painting import by_prediction as by_prediction
    from kt3dmoseg.draw.painting import draw_frame as draw_frame

# Imported on first use: `kt3dmoseg show --help` reads the options without loading OpenCV.
_PUBLIC = dict.fromkeys(("Painting", "by_label", "by_length", "by_prediction", "draw_frame"), "painting")

__all__ = ["PALETTE", "UNLABELLED", "DrawOptions", "label_colour", *_PUBLIC]  # noqa: PLE0604

__getattr__, __dir__ = lazy(__name__, _PUBLIC)


@dataclass(frozen=True)
class DrawOptions:
    """How trajectories are drawn."""

    trail: int = option(8, "length of the trails, frames", low=0)
    radius: float = option(2.0, "radius of the points, pixels of the frame", low=0.5, high=50)
    scale: int = option(1, "enlargement of the frames and of all that is drawn", low=1, high=8)
    dim: float = option(0.6, "brightness of the frames under the trajectories", low=0, high=1)
