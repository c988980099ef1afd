"""Optical flow fields on disk: Middlebury ``.flo``, KITTI 16-bit ``.png``, ``.npy``, ``.npz``.

In memory a field is (H, W, 2) float32, the displacement in pixels (right, down), NaN where unknown.
"""

import io
import os
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError, InvalidValueError
from kt3dmoseg.files import PathLike, read_bytes, write_bytes
from kt3dmoseg.io.images import decode
from kt3dmoseg.io.npz import npy_bytes, read_npy, read_npz, write_npz
from kt3dmoseg.types import BoolArray, Float32Array

FLOW_SUFFIXES = (".flo", ".png", ".npy", ".npz")

_FLO_TAG = struct.pack("<f", 202021.25)
_FLO_UNKNOWN, _FLO_WRITTEN = 1e9, 1e10
_KITTI_SCALE, _KITTI_ZERO = 64.0, 1 << 15
_MAX_FILE = 1 << 30


def read_flow(path: PathLike) -> Float32Array:
    """Read a flow field, (H, W, 2) float32, NaN where unknown; the content decides about the format.

    ``.flo`` (Baker et al., IJCV 2011), KITTI's 16-bit PNG (u = R / 64 - 512, v = G / 64 - 512, valid = B;
    Menze and Geiger, CVPR 2015), or an array (H, W, 2) or (2, H, W) in ``.npy`` or ``.npz`` (its array
    ``flow``, or the only one). InputFileError when the file cannot be read; FileFormatError when it is none
    of these, damaged, or declares a wrong size.
    """
    where, content = os.fspath(path), read_bytes(path, _MAX_FILE)
    if content[:4] == _FLO_TAG:
        return _from_flo(content, where)
    if content[:8] == b"\x89PNG\r\n\x1a\n":
        return _from_kitti(decode(content, where), where)
    if content[:6] == b"\x93NUMPY":
        arrays = {"flow": read_npy(io.BytesIO(content), len(content), where)}
    elif content[:4] == b"PK\x03\x04":
        arrays = read_npz(path)
    else:
        found = f"a file that starts with {content[:8]!r}"
        raise FileFormatError(where, expected="a flow field (.flo, KITTI .png, .npy, .npz)", found=found)
    if "flow" not in arrays and len(arrays) != 1:
        raise FileFormatError(where, expected="an array 'flow'", found=", ".join(sorted(arrays)))
    array = arrays.get("flow", next(iter(arrays.values())))
    if array.ndim == 3 and array.shape[0] == 2 and array.shape[2] != 2:
        array = np.moveaxis(array, 0, -1)
    if array.ndim != 3 or array.shape[2] != 2 or array.dtype.kind not in "iuf":
        found = f"{array.dtype} {array.shape}"
        raise FileFormatError(where, expected="numbers (H, W, 2) or (2, H, W)", found=found)
    return np.ascontiguousarray(array, dtype=np.float32)


def write_flow(path: PathLike, flow: npt.ArrayLike) -> None:
    """Write a flow field (H, W, 2) in pixels, NaN where unknown, in the format of the suffix, atomically.

    PNG keeps 1/64 px within +-512 px. InvalidValueError for another shape or suffix, or a displacement that
    does not fit into a PNG; InputFileError when the file cannot be written.
    """
    field = np.asarray(flow, dtype=np.float32)
    if field.ndim != 3 or field.shape[2] != 2:
        raise InvalidValueError("flow", expected="shape (H, W, 2)", found=f"{field.shape}")
    known = np.asarray(np.isfinite(field).all(axis=2, keepdims=True))
    match Path(path).suffix.lower():
        case ".flo":
            values = np.where(known, field, _FLO_WRITTEN).astype("<f4")
            write_bytes(path, _FLO_TAG + struct.pack("<ii", *field.shape[1::-1]) + values.tobytes())
        case ".png":
            write_bytes(path, _to_kitti(field, known))
        case ".npy":
            write_bytes(path, npy_bytes(field))
        case ".npz":
            write_npz(path, {"flow": field})
        case other:
            expected = f"a suffix of {', '.join(FLOW_SUFFIXES)}"
            raise InvalidValueError(os.fspath(path), expected=expected, found=repr(other))


def _from_flo(content: bytes, where: str) -> Float32Array:
    width, height = struct.unpack("<ii", content[4:12].ljust(8, b"\0"))
    needed = 12 + 8 * width * height
    if width < 1 or height < 1 or needed != len(content):
        expected = f"{max(needed, 20)} bytes"
        raise FileFormatError(
            f"{where}: .flo of {width}x{height}", expected=expected, found=f"{len(content)}"
        )
    field = np.frombuffer(content, "<f4", offset=12).astype(np.float32).reshape(height, width, 2)
    with np.errstate(invalid="ignore"):
        known = np.all(np.abs(field) <= _FLO_UNKNOWN, axis=2, keepdims=True)
    return np.where(known, field, np.float32(np.nan))


def _from_kitti(picture: npt.NDArray[Any], where: str) -> Float32Array:
    if picture.dtype != np.uint16 or picture.ndim != 3:
        found = f"{picture.dtype} of shape {picture.shape}"
        raise FileFormatError(where, expected="a 16-bit RGB PNG as KITTI's flow", found=found)
    field = (picture[..., :2].astype(np.float32) - _KITTI_ZERO) / np.float32(_KITTI_SCALE)
    field[picture[..., 2] == 0] = np.nan
    return field


def _to_kitti(field: Float32Array, known: BoolArray) -> bytes:
    steps = np.rint(np.where(known, field, 0).astype(np.float64) * _KITTI_SCALE) + _KITTI_ZERO
    if ((steps < 0) | (steps >= 1 << 16)).any():
        expected = "displacements within -512..511.98 px, all that a KITTI PNG holds"
        found = f"{np.abs(field[known[..., 0]]).max():g}"
        raise InvalidValueError("flow", expected=expected, found=found, fix="write .flo or .npy")
    bgr = np.concatenate([known, steps[..., ::-1]], axis=2).astype(np.uint16)
    return bytes(cv2.imencode(".png", bgr)[1])
