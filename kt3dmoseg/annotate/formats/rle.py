"""Run-length encoded masks as in COCO: columns first, runs of 0 and 1 in turn, starting with 0.

The compressed text stores each run, from the third on as its difference to the run before the last, in
groups of 5 bits, lowest first; bit 6 says that more follow, and 48 is added to make a printable character.
"""

from __future__ import annotations

import numpy as np

from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.types import BoolArray, IntArray

_MAX_PIXELS = 1 << 28


def encode(mask: BoolArray) -> str:
    """Return the compressed run lengths of an (H, W) mask."""
    flat = mask.ravel(order="F").astype(np.int8)
    changes = np.flatnonzero(np.diff(flat, prepend=0)) if flat.size else np.zeros(0, dtype=np.int64)
    runs = np.diff(np.concatenate([[0], changes, [flat.size]]))
    return _to_text(runs.tolist())


def decode(text: str, height: int, width: int, where: str = "RLE") -> BoolArray:
    """Return the (height, width) mask of compressed run lengths.

    Raises
    ------
    FileFormatError
        When the text is damaged or its runs do not fill the mask.
    """
    if height * width > _MAX_PIXELS:
        raise FileFormatError(where, expected=f"at most {_MAX_PIXELS} pixels", found=f"{width}x{height}")
    return from_runs(_to_runs(text, where), height, width, where)


def from_runs(runs: list[int], height: int, width: int, where: str = "RLE") -> BoolArray:
    """Return the (height, width) mask of uncompressed run lengths; raises as `decode`."""
    lengths: IntArray = np.array(runs, dtype=np.int64)
    if (lengths < 0).any() or lengths.sum() != height * width:
        raise FileFormatError(
            where, expected=f"runs that fill {width}x{height} pixels", found=f"{lengths.sum()} pixels"
        )
    flat = np.repeat(np.arange(len(lengths)) % 2 == 1, lengths)
    return flat.reshape((height, width), order="F")


def _to_text(runs: list[int]) -> str:
    out = []
    for i, run in enumerate(runs):
        value = run - (runs[i - 2] if i > 2 else 0)
        more = True
        while more:
            group = value & 0x1F
            value >>= 5
            more = value != (-1 if group & 0x10 else 0)
            out.append(chr((group | (0x20 if more else 0)) + 48))
    return "".join(out)


def _to_runs(text: str, where: str) -> list[int]:
    runs: list[int] = []
    value = shift = 0
    for character in text:
        group = ord(character) - 48
        if not 0 <= group < 64 or shift > 40:
            raise FileFormatError(where, expected="compressed run lengths", found=repr(text[:40]))
        value |= (group & 0x1F) << shift
        shift += 5
        if not group & 0x20:
            if group & 0x10:
                value -= 1 << shift
            runs.append(value + (runs[-2] if len(runs) > 2 else 0))
            value = shift = 0
    if shift:
        raise FileFormatError(where, expected="compressed run lengths", found="an unfinished one")
    return runs
