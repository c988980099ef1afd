"""The one builder of pages: jinja2 templates of ``static/`` with automatic escaping, and pictures inside."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from kt3dmoseg.draw.palette import css_palette
from kt3dmoseg.types import ByteArray

_STEPS = (0.01, 0.02, 0.05, 0.10, 0.15, 0.20, 0.25)
# Width and JPEG quality of pictures: the first with which all of a clip fit.
_SIZES = ((960, 72), (800, 65), (640, 60), (480, 55), (320, 50))


def render(template: str, **values: object) -> str:
    """Fill in a template of ``static/``."""
    return str(_environment().get_template(template).render(palette=css_palette(), **values))


@cache
def _environment() -> Any:  # noqa: ANN401  # a jinja2 environment
    from jinja2 import Environment, FileSystemLoader

    loader = FileSystemLoader(Path(__file__).with_name("static"))
    made = Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    made.policies["json.dumps_kwargs"] = {"separators": (",", ":")}
    made.filters["mean"] = np.mean
    made.filters["percent"] = lambda value, digits=2: f"{100 * value:.{digits}f}"
    made.filters["points"] = lambda value: f"{value:+.2f}" if round(value, 2) else "0.00"
    # The round distance of the lines of a bar's axis, four of which hold all values, and where a value lies.
    made.filters["step"] = lambda top: next((step for step in _STEPS if 4 * step >= top), _STEPS[-1])
    made.filters["along"] = lambda value, step: f"{25 * min(4.0, value / step):.2f}%"
    return made


def jpegs(pictures: Sequence[ByteArray], most: int) -> list[str]:
    """Write pictures (H, W) or (H, W, 3) as addresses of data, together at most so many characters.

    Where small pictures are too many as well, some are left empty: every second one, or more.
    """
    from kt3dmoseg.io.images import jpeg_address  # Codabench scores without OpenCV

    made: list[str] = []
    for width, quality in _SIZES:
        made = [jpeg_address(picture, width, quality) for picture in pictures]
        if sum(map(len, made)) <= most:
            break
    step = max(1, -(-sum(map(len, made)) // max(1, most)))
    while sum(map(len, made[::step])) > most:
        step += 1
    return [address if i % step == 0 else "" for i, address in enumerate(made)]
