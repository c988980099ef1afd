"""Calibration of a KITTI recording day, read through pykitti."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kt3dmoseg.errors import FileFormatError, InputFileError
from kt3dmoseg.kitti.layout import CALIBRATION_FILES
from kt3dmoseg.types import FloatArray

_CAM_TO_CAM, _IMU_TO_VELO, _VELO_TO_CAM = CALIBRATION_FILES
_FIX = "fetch the day's calibration with kt3dmoseg pull, or unpack its _calib.zip here"


@dataclass(frozen=True)
class Calibration:
    """Calibration of one camera of one day; each file is read when something of it is asked for.

    Parameters
    ----------
    folder : path
        The day's folder with its three ``calib_*.txt`` files.
    camera : int
        0 to 3.
    """

    folder: Path
    camera: int

    @property
    def P(self) -> FloatArray:
        """Projection from rectified camera-0 coordinates (metres) to pixels of the camera, (3, 4)."""
        return self._matrix(_CAM_TO_CAM, f"P_rect_{self.camera:02d}", (3, 4))

    @property
    def K(self) -> FloatArray:
        """Intrinsics of the rectified camera in pixels, (3, 3)."""
        return self.P[:, :3].copy()

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height of the rectified images in pixels."""
        width, height = self._matrix(_CAM_TO_CAM, f"S_rect_{self.camera:02d}", (2,))
        return int(width), int(height)

    @property
    def T_cam_velo(self) -> FloatArray:
        """Rigid motion from laser scanner to rectified camera coordinates in metres, (4, 4).

        ``K @ (T_cam_velo @ X)[:3]`` equals KITTI's ``P_rect @ R_rect_00 @ T_velo_to_cam @ X``
        (Geiger et al., IJRR 2013, eq. 8): the camera's offset is ``inv(K) @ P_rect[:, 3]``, of which
        pykitti keeps only the horizontal part, wrong by about 2 mm for the colour cameras.
        """
        unrectified = self._rigid(_VELO_TO_CAM)
        rectification = np.eye(4)
        rectification[:3, :3] = self._matrix(_CAM_TO_CAM, "R_rect_00", (3, 3))
        offset = np.eye(4)
        offset[:3, 3] = np.linalg.solve(self.K, self.P[:, 3])
        return np.asarray(offset @ rectification @ unrectified)

    @property
    def T_velo_imu(self) -> FloatArray:
        """Rigid motion from GPS/IMU to laser scanner coordinates in metres, (4, 4)."""
        return self._rigid(_IMU_TO_VELO)

    @property
    def T_cam_imu(self) -> FloatArray:
        """Rigid motion from GPS/IMU to rectified camera coordinates in metres, (4, 4)."""
        return self.T_cam_velo @ self.T_velo_imu

    def _rigid(self, name: str) -> FloatArray:
        from pykitti.utils import transform_from_rot_trans

        rotation, translation = self._matrix(name, "R", (3, 3)), self._matrix(name, "T", (3,))
        return np.asarray(transform_from_rot_trans(rotation, translation), dtype=np.float64)

    def _matrix(self, name: str, key: str, shape: tuple[int, ...]) -> FloatArray:
        path = self.folder / name
        values = _read(path).get(key)
        if values is None or values.size != np.prod(shape) or not np.isfinite(values).all():
            found = "none" if values is None else f"{values.tolist()}"
            raise FileFormatError(f"{path}: {key}", expected=f"{np.prod(shape)} numbers", found=found)
        return np.asarray(values, dtype=np.float64).reshape(shape)


def _read(path: Path) -> dict[str, FloatArray]:
    from pykitti.utils import read_calib_file

    try:
        return dict(read_calib_file(path))
    except FileNotFoundError:
        raise InputFileError(f"{path}: no such file", fix=_FIX) from None
    except OSError as error:
        raise InputFileError(f"{path}: {error.strerror or error}") from error
    except ValueError:
        # pykitti splits every line at its first colon; an empty line or text without one ends here.
        raise FileFormatError(str(path), expected="lines 'key: numbers'", found="something else") from None
