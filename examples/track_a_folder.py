"""Track points through a folder of frames and look at what came out.

Usage: python examples/track_a_folder.py [FRAMES]; without a folder a synthetic drive is made and tracked.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import kt3dmoseg
from kt3dmoseg.synthetic import SceneOptions, make_scene, track_errors, write_drive


def main(frames: str | None = None) -> kt3dmoseg.Trajectories:
    with tempfile.TemporaryDirectory() as folder:
        scene = None
        if frames is None:
            scene = make_scene(SceneOptions(width=414, height=125, frames=6, objects=2))
            frames = str(write_drive(scene, folder) / "image_00" / "data")
        tracks = kt3dmoseg.track(frames)

        print(f"{Path(frames).name}: {len(tracks)} trajectories over {tracks.n_frames} frames")
        print(f"mean length {tracks.lengths.mean():.1f} frames")
        rows, x1, x2 = tracks.pair(0, 1)
        motion = np.median(np.linalg.norm(x2 - x1, axis=1))
        print(f"median motion of {len(rows)} from frame 0 to 1: {motion:.2f} px")
        if scene is not None:
            print(f"median error after one frame: {np.nanmedian(track_errors(scene, tracks, 1)):.3f} px")
        kt3dmoseg.save(as_clip(tracks), Path(folder) / "tracks.h5")
        return tracks


def as_clip(tracks: kt3dmoseg.Trajectories) -> kt3dmoseg.Clip:
    """Wrap trajectories without labels as a clip, the unit that files hold."""
    every = np.arange(len(tracks))
    return kt3dmoseg.Clip("my clip", tracks, every, kt3dmoseg.Labels(np.zeros_like(every)))


if __name__ == "__main__":
    main(*sys.argv[1:])
