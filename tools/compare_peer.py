"""Time every step of the paper's method on Seq005_Clip01, and what the authors' code needs.

python tools/compare_peer.py [CLIP]    CPU seconds of one core; the best of five for each step.

The peers' figures were measured once, on one core of a 2-core cloud machine, under Octave: the code
as released (with the fixes that Octave needs), and a variant with vectorised residuals and compiled
helpers. The speed of this machine's core is printed as the rate of a matrix product.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.linalg.blas import ssyrk
from scipy.sparse import csr_array
from threadpoolctl import threadpool_limits

from kt3dmoseg.io import load
from kt3dmoseg.types import Clip
from mseg.benchmark import find_clips
from mseg.evaluation import load_protocol
from mseg.evaluation.results import ResultsTable
from mseg.kernels import sample_hypotheses, sparsify, view_kernel
from mseg.methods.paper import Subset
from mseg.types import ModelKind

KINDS: tuple[ModelKind, ...] = ("affine", "homography", "fundamental")
# Step -> (as released, compiled variant), CPU seconds on Seq005_Clip01.
PEERS = {
    "hypotheses affine": (12.1, 13.6),
    "hypotheses homography": (23.3, 18.8),
    "hypotheses fundamental": (31.6, 2.4),
    "kernel affine": (9.7, 3.9),
    "kernel homography": (10.6, 3.8),
    "kernel fundamental": (31.5, 1.2),
    "subset fusion, k-means": (10.6, 8.5),
}
REPEATS = 5


def main(arguments: list[str]) -> None:
    clip = load(arguments[0] if arguments else find_clips(load_protocol("kt3dmoseg"))[0]["Seq005_Clip01"])
    with threadpool_limits(limits=1, user_api="blas"):
        rate, products = product_rate(), product_seconds(clip)
        seconds = times(clip)
    rows = []
    for step, ours in [*seconds.items(), ("together", sum(seconds.values()))]:
        released, compiled = PEERS.get(step, tuple(map(sum, zip(*PEERS.values(), strict=True))))
        rows.append(
            [
                step,
                f"{ours:.3f}",
                f"{released:.1f}",
                f"{compiled:.1f}",
                f"{released / ours:.0f}",
                f"{compiled / ours:.0f}",
            ]
        )
    columns = ["step", "here", "released", "compiled", "released / here", "compiled / here"]
    shape = f"{len(clip.evaluated)} trajectories, {clip.n_frames} frames"
    notes = [
        f"Single-precision matrix product on this core: {rate:.0f} GFLOP/s.",
        f"Of the kernels, the products of marks over visible points alone: {products:.3f} s per view.",
    ]
    print(ResultsTable(f"{clip.name}, {shape}: CPU seconds", columns, rows, notes).text())


def times(clip: Clip) -> dict[str, float]:
    """CPU seconds of every step."""
    points, method = clip.evaluated_trajectories, Subset()
    seconds, kernels = {}, []
    for kind in KINDS:
        hypotheses, seconds[f"hypotheses {kind}"] = best(
            lambda kind=kind: sample_hypotheses(points, kind, np.random.default_rng(0))
        )
        kernel, seconds[f"kernel {kind}"] = best(
            lambda hypotheses=hypotheses: sparsify(view_kernel(points, hypotheses), method.alpha)
        )
        kernels.append(kernel)

    _, seconds["subset fusion, k-means"] = best(
        lambda: method.group(list(map(csr_array, kernels)), clip.n_motions, np.random.default_rng(0))
    )
    return dict(sorted(seconds.items(), key=lambda item: list(PEERS).index(item[0])))


def best(work: Callable[[], Any]) -> tuple[Any, float]:
    """Return the result and the least CPU time of a few runs: the others were disturbed."""
    found, least = None, float("inf")
    for _ in range(REPEATS):
        start = time.process_time()
        found = work()
        least = min(least, time.process_time() - start)
    return found, least


def product_seconds(clip: Clip) -> float:
    """CPU seconds of the products that one view's kernel cannot do without."""
    points = clip.evaluated_trajectories
    sizes = [len(points.pair(f, f + 1)[0]) for f in range(clip.n_frames - 1)]
    marks = [np.ones((size, Subset().hypotheses), dtype=np.float32) for size in sizes]
    return best(lambda: [ssyrk(1.0, m.T, trans=1, lower=1) for m in marks])[1]


def product_rate() -> float:
    """GFLOP/s of a single-precision matrix product."""
    a = np.random.default_rng(0).random((1000, 2000), dtype=np.float32)
    _, seconds = best(lambda: a @ a.T.copy())
    return 2 * 1000 * 1000 * 2000 / seconds / 1e9


if __name__ == "__main__":
    main(sys.argv[1:])
