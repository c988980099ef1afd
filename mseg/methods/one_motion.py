"""Everything in one group: the baseline that needs no images, no geometry and no choice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kt3dmoseg.types import Clip
from mseg.types import Segmentation


@dataclass(frozen=True)
class OneMotion:
    """Put all evaluated trajectories into one motion.

    Its error is one minus the share of the largest motion, the prevalence row of the paper's table
    ("all trajectories assigned to the dominant motion"). It looks at no label to do so: with a
    one-to-one match of groups to motions the only group always meets the largest motion.

    Source: Xu, Cheong, Li, "Motion segmentation by exploiting complementary geometric models", CVPR
    2018, section 4.2. Input: any. Number of motions: ignored. Cost: none.
    """

    deterministic: ClassVar[bool] = True

    def segment(self, clip: Clip, *, n_motions: int | None, rng: np.random.Generator) -> Segmentation:
        """Label every evaluated trajectory 1; see `mseg.types.Method.segment`."""
        return Segmentation(np.ones(len(clip.evaluated), dtype=np.int64))
