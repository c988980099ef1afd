"""Flow that some other program computed, read from files."""

import re
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import ClassVar

from kt3dmoseg.errors import InputFileError, InvalidValueError
from kt3dmoseg.files import listed, sha256_arrays
from kt3dmoseg.flow import check_pair
from kt3dmoseg.io.flow_files import FLOW_SUFFIXES, read_flow
from kt3dmoseg.io.images import frame_paths, read_frame
from kt3dmoseg.options import option
from kt3dmoseg.types import ByteArray, Float32Array

_DIGITS = re.compile(r"\d{1,18}")


@dataclass(frozen=True)
class FlowFiles:
    """Flow fields from two folders; a pair's file is found by the content of its frames.

    Sorted by the numbers in their names, the i-th file of `forward` is the flow of frame i to frame i + 1,
    the i-th file of `backward` that of frame i + 1 to frame i. Formats: .flo, KITTI 16-bit .png, .npy, .npz.
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
        path = self._fields.get((sha256_arrays(a), sha256_arrays(b)))
        if path is None:
            expected, found = f"two neighbours of {self.frames}", "a pair that is not there"
            raise InvalidValueError("frames", expected=expected, found=found)
        field = read_flow(path)
        if field.shape[:2] != a.shape:
            expected, found = ("{1}x{0}".format(*shape) for shape in (a.shape, field.shape))
            raise InvalidValueError(f"{path}", expected=f"a field of {expected}", found=found)
        return field

    @cached_property
    def _fields(self) -> dict[tuple[str, str], Path]:
        """Files by the checksums of their pairs of frames; of frames that come twice, the first."""
        checksums = [sha256_arrays(read_frame(path, "luma")) for path in frame_paths(self._folder("frames"))]
        found: dict[tuple[str, str], Path] = {}
        forward, backward = (self._files(which, len(checksums) - 1) for which in ("forward", "backward"))
        for (first, second), there, back in zip(pairwise(checksums), forward, backward, strict=True):
            found.setdefault((first, second), there)
            found.setdefault((second, first), back)
        return found

    def _files(self, which: str, count: int) -> list[Path]:
        folder = self._folder(which)
        paths = [path for path in listed(folder) if path.suffix.lower() in FLOW_SUFFIXES]
        paths.sort(key=lambda path: [int(digits) for digits in _DIGITS.findall(path.stem)])  # 2 before 10
        if len(paths) != count:
            expected = f"{count} flow files, one per pair of frames"
            raise InputFileError(f"{folder}", expected=expected, found=f"{len(paths)}")
        return paths

    def _folder(self, which: str) -> Path:
        if value := getattr(self, which):
            return Path(value)
        fix = f"give {which}=FOLDER as a parameter"
        raise InvalidValueError(f"flow files: {which}", expected="a folder", found="none", fix=fix)
