"""Motion segmentation as proposals for the labelling page of kt3dmoseg.

Registered in the entry point group ``kt3dmoseg.proposers``, as any third party would.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kt3dmoseg.types import Clip, Labels
from mseg.errors import TooFewPointsError
from mseg.methods import segment

if TYPE_CHECKING:
    from kt3dmoseg.annotate.proposals import Request

# A person waits: enough trajectories to cover the frame, few enough for some seconds.
_MOST = 700
_FEWEST = 50
_SHORTEST = 5


def propose(request: Request) -> Labels:
    """Find the motions of a sample of the trajectories, which the others join; the largest is the background.

    TooFewPointsError when fewer than 50 trajectories live for 5 frames.
    """
    tracks = request.trajectories
    rows = np.flatnonzero(tracks.lengths >= _SHORTEST)
    if len(rows) < _FEWEST:
        raise TooFewPointsError("mseg", expected=f"{_FEWEST} trajectories of 5 frames", found=str(len(rows)))
    if len(rows) > _MOST:
        rows = np.sort(np.random.default_rng(0).choice(rows, _MOST, replace=False))
    clip = Clip(request.clip, tracks, rows, Labels(np.zeros(len(rows), dtype=np.int64)))
    found = segment(clip, "multibody", seed=0, rows="all").labels
    largest = int(np.argmax(np.bincount(found[rows], minlength=2)[1:])) + 1
    return Labels(np.where(found == largest, 1, np.where(found > 0, found + 1, 0)), background=1)
