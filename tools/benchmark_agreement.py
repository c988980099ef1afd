"""Show whether two benchmarks rank methods alike, and which differences one of them can show.

Usage: mseg benchmark synth --methods ... --seeds 3 --json synth.json (and for kt3dmoseg); then
       python tools/benchmark_agreement.py synth.json kt3dmoseg.json ...

The first file is the benchmark in question. For each other one: Kendall's tau between the mean errors, with
its interval when the clips of both are drawn again. Then all pairs of methods on the first: the difference in
points, its standard error over clips, Wilcoxon's p, and the difference that would be significant.
"""

from __future__ import annotations

import json
import sys
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.stats import kendalltau

from mseg.evaluation.statistics import wilcoxon_p

DRAWS = 2000


def per_clip(path: str) -> tuple[list[str], np.ndarray]:
    """Read the methods and their errors in per cent, (methods, clips), means over seeds."""
    found = json.loads(Path(path).read_text(encoding="utf-8"))
    return [method["method"] for method in found["methods"]], 100 * np.mean(found["errors"], axis=2)


def main(first: str, *others: str) -> None:
    methods, errors = per_clip(first)
    print(f"{first}: {errors.shape[1]} clips")
    for name, row in zip(methods, errors, strict=True):
        print(f"  {name:12} mean {row.mean():6.2f}  median {np.median(row):6.2f}")
    rng = np.random.default_rng(0)
    for other in others:
        names, real = per_clip(other)
        real = real[[names.index(name) for name in methods]]
        tau = kendalltau(errors.mean(axis=1), real.mean(axis=1)).statistic
        agree = [
            kendalltau(
                *(e[:, rng.integers(e.shape[1], size=e.shape[1])].mean(axis=1) for e in (errors, real))
            )
            for _ in range(DRAWS)
        ]
        low, high = np.percentile([draw.statistic for draw in agree], [2.5, 97.5])
        means = ", ".join(f"{name} {row.mean():.2f}" for name, row in zip(methods, real, strict=True))
        print(
            f"{other}: {real.shape[1]} clips: {means}\n  Kendall's tau {tau:+.2f} ({low:+.2f} to {high:+.2f})"
        )
    print("pairs: difference, standard error, Wilcoxon p, significant from")
    for i, j in combinations(range(len(methods)), 2):
        apart = errors[i] - errors[j]
        error = apart.std(ddof=1) / np.sqrt(len(apart))
        pair = f"{methods[i]} - {methods[j]}"
        print(f"  {pair:26} {apart.mean():+7.2f} {error:6.2f}  {wilcoxon_p(apart):8.2g} {1.96 * error:6.2f}")


if __name__ == "__main__":
    main(*sys.argv[1:])
