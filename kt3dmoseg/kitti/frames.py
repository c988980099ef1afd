"""Decoding frames and taking their fingerprints."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kt3dmoseg.catalog.entries import Fingerprint, fingerprint
from kt3dmoseg.errors import FileFormatError, InputFileError
from kt3dmoseg.files import read_bytes
from kt3dmoseg.types import ByteArray

LARGEST_FRAME = 64 << 20


def decode(content: bytes, where: str) -> ByteArray:
    """Decode a PNG: (H, W) uint8 when it is gray, (H, W, 3) uint8 RGB when it has colour.

    Raises
    ------
    FileFormatError
        When it is not a picture of 8 bits, or only a part of one.
    """
    from kt3dmoseg.io import images

    image = images.decode(content, where)
    if image.dtype != np.uint8:
        raise FileFormatError(where, expected="an 8-bit PNG image", found=f"one of type {image.dtype}")
    return np.ascontiguousarray(image if image.ndim == 2 else image[..., 2::-1], dtype=np.uint8)


def read_frame(path: Path) -> ByteArray:
    """Read and `decode` a PNG file of at most 64 MiB."""
    return decode(read_bytes(path, LARGEST_FRAME), str(path))


def frame_paths(folder: Path) -> list[Path]:
    """List the PNG files of a folder in the order of their names.

    Raises
    ------
    InputFileError
        When there are none.
    """
    paths = sorted(folder.glob("*.png"))
    if not paths:
        raise InputFileError(f"{folder}: no PNG files there")
    return paths


def fingerprint_folder(folder: Path) -> tuple[tuple[Fingerprint, ...], tuple[int, int]]:
    """Fingerprint a clip's frames, in the order of their names.

    Returns
    -------
    frames : tuple of Fingerprint
        One per PNG file.
    size : (W, H)
        Their size in pixels.

    Raises
    ------
    FileFormatError
        When the frames differ in size or one is not a PNG.
    """
    marks, sizes = [], set()
    for path in frame_paths(folder):
        content = read_bytes(path, LARGEST_FRAME)
        image = decode(content, str(path))
        marks.append(fingerprint(content, image))
        sizes.add((image.shape[1], image.shape[0]))
    if len(sizes) != 1:
        raise FileFormatError(str(folder), expected="frames of one size", found=f"{sorted(sizes)}")
    return tuple(marks), sizes.pop()
