"""Flow that some other program computed, read from files."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import ClassVar

from kt3dmoseg.errors import InputFileError, InvalidValueError
from kt3dmoseg.files import sha256_arrays
from kt3dmoseg.flow import check_pair
from kt3dmoseg.io.flow_files import FLOW_SUFFIXES, read_flow
from kt3dmoseg.io.images import frame_paths, read_frame
from kt3dmoseg.options import option
from kt3dmoseg.types import ByteArray, Float32Array


@dataclass(frozen=True)
class FlowFiles:
    """Flow fields from two folders; a pair's file is found by the content of its frames.

    Sorted by name, the i-th file of `forward` is the flow of frame i to frame i + 1, the i-th file of
    `backward` that of frame i + 1 to frame i. Formats: .flo, KITTI 16-bit .png, .npy, .npz.
    """

    uncached: ClassVar[bool] = True

    frames: str = option("", "folder of the frames that the flow was computed on")
    forward: str = option("", "folder with the flow of each frame to the next")
    backward: str = option("", "folder with the flow of each frame to the one before")

    def __call__(self, a: ByteArray, b: ByteArray) -> Float32Array:
        """Displacement of every pixel of `a`; see `kt3dmoseg.flow.Flow`.

        Raises
        ------
        InvalidValueError
            When the frames are not neighbours in the folder `frames`, or a field has another size.
        InputFileError, FileFormatError
            When a folder or field is missing or cannot be read.
        """
        check_pair(a, b)
        path = self._find(sha256_arrays(a), sha256_arrays(b))
        field = read_flow(path)
        if field.shape[:2] != a.shape:
            height, width = a.shape
            raise InvalidValueError(
                str(path), expected=f"a field of {width}x{height}", found=f"{field.shape[1]}x{field.shape[0]}"
            )
        return field

    def _find(self, first: str, second: str) -> Path:
        for number, pair in enumerate(pairwise(self._checksums)):
            if pair == (first, second):
                return self._forward[number]
            if pair == (second, first):
                return self._backward[number]
        raise InvalidValueError(
            "frames", expected=f"two neighbours of {self.frames}", found="a pair that is not there"
        )

    @cached_property
    def _checksums(self) -> list[str]:
        return [sha256_arrays(read_frame(path)) for path in frame_paths(self._folder("frames"))]

    @cached_property
    def _forward(self) -> list[Path]:
        return self._fields("forward")

    @cached_property
    def _backward(self) -> list[Path]:
        return self._fields("backward")

    def _fields(self, which: str) -> list[Path]:
        folder = self._folder(which)
        inside = sorted(folder.iterdir()) if folder.is_dir() else []
        paths = [path for path in inside if path.suffix.lower() in FLOW_SUFFIXES]
        wanted = len(self._checksums) - 1
        if len(paths) != wanted:
            raise InputFileError(
                str(folder), expected=f"{wanted} flow files, one per pair of frames", found=str(len(paths))
            )
        return paths

    def _folder(self, which: str) -> Path:
        if value := getattr(self, which):
            return Path(value)
        raise InvalidValueError(
            f"flow files: {which}",
            expected="a folder",
            found="none",
            fix=f"give {which}=FOLDER, on the command line -p {which}=FOLDER",
        )
