"""T-Linkage under three protocols: one threshold for all, chosen by code length, chosen with the labels.

Measures each threshold for all sequences, the threshold that the method itself chooses for every sequence
(its default, without labels), and for every sequence the threshold with the least error. The last uses the
answer; it bounds what any rule for choosing thresholds could reach.

    python tools/best_threshold.py ../shared/data/hopkins155
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import kt3dmoseg
from mseg.evaluation import classification_error
from mseg.methods import segment

THRESHOLDS = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)


def run(arguments: argparse.Namespace) -> None:
    """Print errors in per cent: one line per threshold, then the best per sequence."""
    paths = sorted(arguments.folder.glob("*/*_truth.mat"))[:: arguments.every]
    clips = [kt3dmoseg.load(path) for path in paths if path.parent.name != "dancing"]
    motions = np.array([clip.n_motions for clip in clips])
    errors = np.array([[_error(clip, arguments.seed, e) for e in THRESHOLDS] for clip in clips])
    chosen = np.array([_error(clip, arguments.seed) for clip in clips])
    print(f"{len(clips)} sequences, error in per cent: two motions, three motions, all")
    for threshold, column in zip(THRESHOLDS, errors.T, strict=True):
        print(f"epsilon {threshold:4.2f} for all        {_means(column, motions)}")
    print(f"epsilon chosen by code      {_means(chosen, motions)}")
    print(f"epsilon chosen with labels  {_means(errors.min(axis=1), motions)}")


def _error(clip: kt3dmoseg.Clip, seed: int, threshold: float | None = None) -> float:
    fixed = {} if threshold is None else {"epsilon": threshold, "choose_epsilon": False}
    found = segment(clip, "tlinkage", n_motions=clip.n_motions, seed=seed, **fixed)
    return 100 * classification_error(clip.labels.label, found.labels)


def _means(errors: np.ndarray, motions: np.ndarray) -> str:
    groups = [errors[motions == 2], errors[motions == 3], errors]
    return "  ".join(f"{group.mean():6.2f}" if len(group) else "     -" for group in groups)


def main() -> int:
    """Parse the command line and run."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="folder of Hopkins155 sequences")
    parser.add_argument("--every", type=int, default=1, help="take every n-th sequence only")
    parser.add_argument("--seed", type=int, default=0, help="seed of the samples")
    run(parser.parse_args())
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
