"""Choosing clips: windows of recordings, measured and ranked by the principles of the paper."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from kt3dmoseg.options import option
from kt3dmoseg.registry import lazy

if TYPE_CHECKING:
    from kt3dmoseg.choosing.ranking import choose as choose
    from kt3dmoseg.choosing.ranking import select as select
    from kt3dmoseg.choosing.windows import Window as Window
    from kt3dmoseg.choosing.windows import measure_windows as measure_windows
else:  # imported on first use: the help of commands reads only the options
    __getattr__, __dir__, __all__ = lazy(__name__, "ChooseOptions")

ALGORITHM_VERSION = 3
"""Raised when the same frames get other measures."""


@dataclass(frozen=True)
class ChooseOptions:
    """Which windows are looked at, and how many are chosen."""

    count: int = option(20, "windows that are chosen", low=1, high=1000)
    shortest: int = option(10, "frames of the shortest window", low=6, high=200)
    longest: int = option(20, "frames of the longest window", low=6, high=200)
    stride: int = option(5, "frames from the start of one window to the next", low=1)
    apart: int = option(20, "least number of frames between chosen windows of a recording", low=0)
    movers: Literal["auto", "tracklets", "mseg", "residual"] = option(
        "auto", "what finds motions; auto: tracklets where there are any, else mseg, else residual"
    )
    flow: str = option("dis_medium", "optical flow, a name of kt3dmoseg.flow.list()", metavar="NAME")
    colour: Literal["refuse", "luma"] = option("luma", "colour frames: refuse them, or take their luma")
