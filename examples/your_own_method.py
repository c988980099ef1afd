"""Write a segmentation method: a frozen dataclass of parameters with one verb.

This one clusters positions and velocities. It does badly, and shows why the task is hard: seen from a moving
car, velocity follows depth rather than motion. To make it a name that
`mseg run --method velocity` finds, your package announces it in its pyproject.toml:

    [project.entry-points."mseg.methods"]
    velocity = "your_package:Velocity"
"""

from dataclasses import dataclass

import numpy as np
from scipy.cluster.vq import kmeans2
from segment_and_score import synthetic_clip

import mseg
from kt3dmoseg.options import option
from kt3dmoseg.types import Clip


@dataclass(frozen=True)
class Velocity:
    """Cluster positions and velocities with k-means."""

    weight: float = option(3.0, "weight of a velocity next to a position", low=0.0)

    def segment(self, clip: Clip, *, n_motions: int | None, rng: np.random.Generator) -> mseg.Segmentation:
        """Segment the evaluated trajectories; see `mseg.types.Method`."""
        tracks = clip.evaluated_trajectories
        place = mean_of_known(tracks.xy)
        speed = mean_of_known(np.diff(tracks.xy, axis=1))
        features = np.hstack([place / place.std(), self.weight * speed / speed.std()])
        _, groups = kmeans2(features, n_motions or 2, minit="++", rng=rng)
        return mseg.Segmentation(groups + 1)


def mean_of_known(values: np.ndarray) -> np.ndarray:
    """Mean over frames (N, F, 2) -> (N, 2) of what is not NaN; 0 where nothing is."""
    known = ~np.isnan(values)
    return np.where(known, values, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)


def main() -> float:
    clip = synthetic_clip()
    found = mseg.segment(clip, Velocity(weight=5.0), n_motions=clip.n_motions, seed=0)
    error = float(mseg.score(truth=clip.labels, pred=found).per_clip().mean())
    print(f"velocity: error {100 * error:.2f} %")
    return error


if __name__ == "__main__":
    main()
