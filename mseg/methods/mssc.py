"""Motion segmentation via a sparsity constraint (MSSC)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kt3dmoseg.options import option
from kt3dmoseg.types import Float32Array, Trajectories
from mseg.kernels import GUARD, covisible_frames
from mseg.methods.paper import SingleView


@dataclass(frozen=True)
class MSSC(SingleView):
    """Accumulate which homographies trajectories share, keep the informative neighbours, cut the graph.

    1. Homographies are fitted to random minimal samples of every two consecutive frames. Two trajectories
       correlate in a frame pair by the share of common hypotheses among the best ones of each.
    2. Correlations are summed over all frame pairs. The sum is not divided by the number of frames in which
       both are seen, as the paper of 2018 does: long common histories weigh more.
    3. A trajectory keeps the neighbours whose share of the row's distances has a logarithm under the row's
       mean (negative entropy), after correlations are raised to the power alpha (`mseg.kernels.sparsify`).
    4. Spectral clustering.

    Source: Lai, Wang, Yan, Chin, Zhao, "Motion segmentation via a sparsity constraint", IEEE T-ITS 18(4),
    2017. No code of it is public; steps 1 to 3 follow its description in Xu, Cheong, Li, CVPR 2018 (section
    3.1 and 4), whose H view differs by the division. Numbers of hypotheses, of preferred ones and restarts
    are those of 2018. Its segment-and-merge search for the number of motions is not described there and is
    left out. The power is that of Jiang et al., AAAI 2021, for the same kernel and rule: without it (alpha =
    1) rows keep so many neighbours that a small motion has most of its weight in others, and the largest
    motion is cut in two instead.
    Input: gaps allowed. Number of motions: given, or found as in the paper's methods. Outliers: not handled.
    Cost: O(F N^2 M) for M hypotheses per pair, O(N^2) memory.
    """

    kinds = ("homography",)

    alpha: float = option(3.0, "power of the kernel before neighbours are chosen", low=0)

    def rescale(self, kernel: Float32Array, points: Trajectories) -> Float32Array:
        """Undo the division."""
        return np.asarray(kernel * (covisible_frames(points) + np.float32(GUARD)), dtype=np.float32)
