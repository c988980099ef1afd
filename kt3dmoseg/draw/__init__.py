"""Pictures of trajectories with trails, on the frames or on black."""

from dataclasses import dataclass

from kt3dmoseg.options import option


@dataclass(frozen=True)
class DrawOptions:
    """How trajectories are drawn."""  # here: `kt3dmoseg show --help` reads them without loading OpenCV

    trail: int = option(8, "length of the trails, frames", low=0)
    radius: float = option(2.0, "radius of the points, pixels of the frame", low=0.5, high=50)
    scale: int = option(1, "enlargement of the frames and of all that is drawn", low=1, high=8)
    dim: float = option(0.6, "brightness of the frames under the trajectories", low=0, high=1)
