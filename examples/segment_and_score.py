"""Segment a clip with several methods and score them.

Usage: python examples/segment_and_score.py [CLIP]; without a file a synthetic clip with exact tracks is used.
"""

import sys

import numpy as np

import kt3dmoseg
import mseg
from kt3dmoseg.synthetic import SceneOptions, make_scene


def synthetic_clip() -> kt3dmoseg.Clip:
    """Exact trajectories of points on a grid in the middle frame, with exact labels."""
    scene = make_scene(SceneOptions(width=828, height=250, frames=10, objects=2, seed=5))
    x, y = np.meshgrid(np.arange(8, 828, 16.0), np.arange(8, 250, 16.0))
    seeds = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 5)])
    tracks, labels = scene.trajectories(seeds), scene.labels(seeds)
    return kt3dmoseg.Clip("synthetic", tracks, np.arange(len(tracks)), labels)


def main(path: str | None = None) -> dict[str, float]:
    clip = synthetic_clip() if path is None else kt3dmoseg.load(path)
    print(f"{clip.name}: {len(clip.evaluated)} trajectories, {clip.n_motions} motions")
    errors = {}
    for method in ("one_motion", "fundamental", "keradd", "subset"):
        found = mseg.segment(clip, method, n_motions=clip.n_motions, seed=0)
        scores = mseg.score(truth=clip.labels, pred=found)
        errors[method] = float(scores.per_clip().mean())
        print(f"  {method:<12} error {100 * errors[method]:5.2f} %")
    return errors


if __name__ == "__main__":
    main(*sys.argv[1:])
