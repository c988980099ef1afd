"""What a source of frames is, and what all kinds of them share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from kt3dmoseg.io.images import Colour
from kt3dmoseg.types import ByteArray, Camera, FloatArray


@dataclass(frozen=True)
class Shot:
    """What is known of a clip before its frames are read.

    Parameters
    ----------
    numbers : sequence of int or None
        Numbers of the frames; None when only reading tells.
    sha256 : str
        Of everything the frames are decoded from, in order.
    description : mapping
        Where the frames come from, for the provenance; no path of this machine.
    timestamps : (F,) float64 or None
        Seconds.
    camera : Camera or None
        The camera.
    """

    numbers: Sequence[int] | None
    sha256: str
    description: dict[str, Any]
    timestamps: FloatArray | None = None
    camera: Camera | None = None


class Source(Protocol):
    """A clip's frames. Making one reads nothing, so that a bad clip fails when it is built."""

    @property
    def name(self) -> str:
        """Name of the clip."""
        ...

    @property
    def where(self) -> str:
        """The place on this machine, for messages."""
        ...

    def inspect(self) -> Shot:
        """Check the source and say what is known without decoding it."""
        ...

    def frames(self, colour: Colour) -> Iterator[ByteArray]:
        """Give gray frames one after the other."""
        ...
