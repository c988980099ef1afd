"""What can be chosen about a synthetic drive."""

from __future__ import annotations

from dataclasses import dataclass

from kt3dmoseg.options import check, option

FRAMES_PER_SECOND = 10.0


@dataclass(frozen=True)
class SceneOptions:
    """Options of a synthetic drive.

    The defaults give a clip with the size, focal length, frame rate and image noise of a KITTI raw drive.

    Raises
    ------
    InvalidValueError
        When a number is out of bounds.
    """

    width: int = option(1242, "image width in pixels", low=64, high=4096)
    height: int = option(375, "image height in pixels", low=32, high=4096)
    frames: int = option(12, "number of frames, 10 a second", low=1, high=2000)
    objects: int = option(3, "number of independently moving vehicles", low=0, high=4)
    seed: int = option(0, "seed of everything random: street, textures, motions, image noise", low=0)
    speed: float = option(5.0, "speed of the camera in m/s", low=0.0, high=40.0)
    turn: float = option(3.0, "yaw rate of the camera in degrees per second, to the right", low=-45, high=45)
    noise: float = option(1.5, "standard deviation of the image noise in grey levels", low=0.0, high=50.0)
    samples: int = option(2, "rays per pixel: the square of this", low=1, high=8)

    def __post_init__(self) -> None:
        check(self, where="SceneOptions")
