"""Pictures of trajectories with trails, on the frames or on black."""

from __future__ import annotations

from typing import TYPE_CHECKING

from kt3dmoseg.draw.options import DrawOptions
from kt3dmoseg.lazy import lazy

if TYPE_CHECKING:
    from kt3dmoseg.draw.painting import Painting as Painting
    from kt3dmoseg.draw.painting import by_label as by_label
    from kt3dmoseg.draw.painting import by_length as by_length
    from kt3dmoseg.draw.painting import by_prediction as by_prediction
    from kt3dmoseg.draw.painting import draw_frame as draw_frame
    from kt3dmoseg.draw.palette import PALETTE as PALETTE
    from kt3dmoseg.draw.palette import UNLABELLED as UNLABELLED
    from kt3dmoseg.draw.palette import label_colour as label_colour

# Imported on first use: `kt3dmoseg show --help` reads the options without loading OpenCV.
_PUBLIC = {
    "PALETTE": "palette",
    "UNLABELLED": "palette",
    "Painting": "painting",
    "by_label": "painting",
    "by_length": "painting",
    "by_prediction": "painting",
    "draw_frame": "painting",
    "label_colour": "palette",
}

__all__ = ["DrawOptions", *_PUBLIC]  # noqa: PLE0604

__getattr__, __dir__ = lazy(__name__, _PUBLIC)
