"""Pictures of trajectories with trails, on the frames or on black."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from kt3dmoseg.draw.options import DrawOptions

if TYPE_CHECKING:
    from kt3dmoseg.draw.painting import PALETTE as PALETTE
    from kt3dmoseg.draw.painting import UNLABELLED as UNLABELLED
    from kt3dmoseg.draw.painting import Painting as Painting
    from kt3dmoseg.draw.painting import by_label as by_label
    from kt3dmoseg.draw.painting import by_length as by_length
    from kt3dmoseg.draw.painting import by_prediction as by_prediction
    from kt3dmoseg.draw.painting import draw_frame as draw_frame
    from kt3dmoseg.draw.painting import label_colour as label_colour

# Imported on first use: `kt3dmoseg show --help` reads the options without loading OpenCV.
_PUBLIC = {
    "PALETTE": "kt3dmoseg.draw.painting",
    "UNLABELLED": "kt3dmoseg.draw.painting",
    "Painting": "kt3dmoseg.draw.painting",
    "by_label": "kt3dmoseg.draw.painting",
    "by_length": "kt3dmoseg.draw.painting",
    "by_prediction": "kt3dmoseg.draw.painting",
    "draw_frame": "kt3dmoseg.draw.painting",
    "label_colour": "kt3dmoseg.draw.painting",
}

__all__ = ["DrawOptions", *_PUBLIC]  # noqa: PLE0604


def __getattr__(name: str) -> Any:  # noqa: ANN401
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
