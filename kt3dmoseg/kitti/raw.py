"""KITTI raw on disk: a day's calibration, and a drive read by frame number.

pykitti parses GPS/IMU packets here. What it does by position in a sorted list, cuts to
microseconds or takes from another sensor's clock is read directly: frames and packets by their number,
the camera's own timestamps to the nanosecond.
"""

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kt3dmoseg.catalog import CAMERAS, Drive, Fingerprint, check_integer, fingerprint, format_numbers
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.files import PathLike, read_bytes
from kt3dmoseg.kitti.tracklets import Tracklet, TrackletBox, project_box, read_tracklets
from kt3dmoseg.types import ByteArray, FloatArray, IntArray

CALIBRATION_FILES = ("calib_cam_to_cam.txt", "calib_imu_to_velo.txt", "calib_velo_to_cam.txt")
TRACKLET_FILE = "tracklet_labels.xml"
LARGEST_FILE = 64 << 20
LOCATED = "located.toml"  # the catalog in a KITTI raw root: clips whose frame numbers were proved

_FIX = "fetch it with kt3dmoseg pull, or give the folder that holds the day's folder"
_TIME = re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d(\.\d{1,9})?")


@contextmanager
def _reading(path: Path, expected: str) -> Iterator[None]:
    """Turn what goes wrong with a file or folder in this block into one line."""
    try:
        yield
    except OSError as error:
        raise InputFileError(f"{error.filename or path}: {error.strerror or error}", fix=_FIX) from None
    except (TypeError, ValueError) as error:
        raise FileFormatError(f"{path}", expected=expected, found=str(error)) from None


def frame_number(file_name: str) -> int | None:
    """Return the number of the frame that a file of this name holds; None for other files."""
    match = re.fullmatch(r"(\d{10})\.png", file_name)
    return int(match[1]) if match else None


def decode_frame(content: bytes, where: str) -> ByteArray:
    """Decode a PNG of 8 bits: (H, W) uint8 when it is gray, (H, W, 3) uint8 RGB when it has colour."""
    from kt3dmoseg.io import images

    image = images.decode(content, where)
    if image.dtype != np.uint8:
        raise FileFormatError(where, expected="an 8-bit PNG image", found=f"one of type {image.dtype}")
    return np.ascontiguousarray(image, dtype=np.uint8)


def read_clip(folder: Path) -> Iterator[tuple[bytes, ByteArray]]:
    """Yield every PNG file of a folder and its picture, in the order of the numbers; others are refused."""
    from kt3dmoseg.io.images import numbered_pictures

    for path in numbered_pictures(folder).values():
        if path.suffix.lower() != ".png":
            raise InputFileError(f"{folder}", expected="the clip's PNG files", found=path.name)
        content = read_bytes(path, LARGEST_FILE)
        yield content, decode_frame(content, str(path))


def fingerprint_folder(folder: Path) -> tuple[tuple[Fingerprint, ...], tuple[int, int]]:
    """Fingerprint a clip's PNG files, in the order of their numbers; return their size (W, H) in pixels, too.

    FileFormatError when there are none or they differ in size, InputFileError when one is not a PNG.
    """
    frames = [(fingerprint(content, image), image.shape[1::-1]) for content, image in read_clip(folder)]
    sizes = {size for _, size in frames}
    if len(sizes) != 1:
        raise FileFormatError(str(folder), expected="PNG files of one size", found=f"{sorted(sizes)}")
    return tuple(mark for mark, _ in frames), sizes.pop()


class Calibration:
    """Calibration of one camera, 0 to 3, of one day; each of the three files is read on first use.

    `folder` is the day's, with ``calib_*.txt``.
    """

    def __init__(self, folder: PathLike, camera: int) -> None:
        self.folder, self.camera = Path(folder), camera

    @property
    def P(self) -> FloatArray:
        """Projection from rectified camera-0 coordinates (metres) to pixels of the camera, (3, 4)."""
        return self._matrix("calib_cam_to_cam.txt", f"P_rect_{self.camera:02d}", (3, 4))

    @property
    def K(self) -> FloatArray:
        """Intrinsics of the rectified camera in pixels, (3, 3)."""
        return self.P[:, :3].copy()

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height of the rectified images in pixels."""
        width, height = self._matrix("calib_cam_to_cam.txt", f"S_rect_{self.camera:02d}", (2,))
        return int(width), int(height)

    @property
    def T_cam_velo(self) -> FloatArray:
        """Rigid motion from laser scanner to rectified camera coordinates in metres, (4, 4).

        ``K @ (T_cam_velo @ X)[:3]`` equals KITTI's ``P_rect @ R_rect_00 @ T_velo_to_cam @ X``
        (Geiger et al., IJRR 2013, eq. 8): the camera's offset is ``inv(K) @ P_rect[:, 3]``, of which
        pykitti keeps only the horizontal part, wrong by about 2 mm for the colour cameras.
        """
        unrectified = self._rigid("calib_velo_to_cam.txt")
        rectification, offset = np.eye(4), np.eye(4)
        rectification[:3, :3] = self._matrix("calib_cam_to_cam.txt", "R_rect_00", (3, 3))
        offset[:3, 3] = np.linalg.solve(self.K, self.P[:, 3])
        return np.asarray(offset @ rectification @ unrectified)

    @property
    def T_velo_imu(self) -> FloatArray:
        """Rigid motion from GPS/IMU to laser scanner coordinates in metres, (4, 4)."""
        return self._rigid("calib_imu_to_velo.txt")

    @property
    def T_cam_imu(self) -> FloatArray:
        """Rigid motion from GPS/IMU to rectified camera coordinates in metres, (4, 4)."""
        return self.T_cam_velo @ self.T_velo_imu

    def _rigid(self, name: str) -> FloatArray:
        motion = np.eye(4)
        motion[:3, :3], motion[:3, 3] = self._matrix(name, "R", (3, 3)), self._matrix(name, "T", (3,))
        return motion

    def _matrix(self, name: str, key: str, shape: tuple[int, ...]) -> FloatArray:
        path, values = self.folder / name, np.zeros(0)
        with _reading(path, "lines 'key: numbers'"):
            for line in filter(str.strip, path.read_text(encoding="utf-8", errors="replace").splitlines()):
                found, colon, numbers = line.partition(":")
                if not colon:
                    raise ValueError(repr(line[:60]))
                values = np.array(numbers.split(), dtype=np.float64) if found == key else values
        if values.size != np.prod(shape) or not np.isfinite(values).all():
            expected, found = f"{np.prod(shape)} numbers", f"{values.tolist()}"
            raise FileFormatError(f"{path}: {key}", expected=expected, found=found)
        return values.reshape(shape)


class RawDrive(Calibration):
    """One camera of a synchronised, rectified KITTI raw drive; everything is read on first use.

    It has the properties of its `Calibration`, as ``K``, ``T_cam_velo``, ``T_cam_imu`` and ``image_size``.
    `root` is the KITTI raw root, which holds ``2011_09_26/2011_09_26_drive_0005_sync``; `date` the day,
    ``"2011_09_26"``; `drive` the number, 5 or ``"0005"``; `camera` 0 gray left, 1 gray right, 2 colour left,
    3 colour right. A drive may be on disk in part. Numbers are those of KITTI's file names.

    InvalidValueError when date, drive or camera is not of KITTI's form; InputFileError when the drive's
    folder is missing; this or FileFormatError from every reader, when its file is missing or not as promised.
    """

    def __init__(self, root: PathLike, date: str, drive: int | str, camera: int | str = 0) -> None:
        self.root = Path(root)
        self.drive = Drive(date, drive)  # type: ignore[arg-type]  # it converts "0005"
        super().__init__(self.root / date, check_integer(camera, "camera", CAMERAS[-1]))
        self._drive_folder = self.root / self.drive.folder
        self._camera_folder = self.root / self.drive.camera_folder(self.camera)
        if not self._drive_folder.is_dir():
            raise InputFileError(f"{self._drive_folder}: no such folder", fix=_FIX)

    def __repr__(self) -> str:
        return f"RawDrive({str(self.root)!r}, {self.drive.date!r}, {self.drive.number}, camera={self.camera})"

    @property
    def numbers(self) -> IntArray:
        """Numbers of the frames on disk, ascending, (n,) int64."""
        folder, expected = self._camera_folder / "data", "KITTI's frames, 0000000000.png"
        with _reading(folder, expected):
            names = [path.name for path in folder.iterdir()]
        numbers = sorted(n for n in map(frame_number, names) if n is not None)
        if names and not numbers:
            fix = "fetch them with kt3dmoseg pull; converted frames are built as a plain folder of frames"
            raise FileFormatError(f"{folder}", expected=expected, found=min(names), fix=fix)
        return np.array(numbers, dtype=np.int64)

    def frame_path(self, number: int) -> Path:
        """Return the path of one frame; InputFileError lists those on disk when it is not."""
        path = self._camera_folder / f"data/{number:010d}.png"
        if not path.is_file():
            expected = f"a number on disk ({format_numbers(self.numbers) or 'none'})"
            raise InputFileError(f"{path}: no such frame", expected=expected, found=str(number), fix=_FIX)
        return path

    def frame(self, number: int) -> ByteArray:
        """Read one frame: (H, W) uint8 for the gray cameras 0 and 1, (H, W, 3) uint8 RGB for 2 and 3."""
        path = self.frame_path(number)
        return decode_frame(read_bytes(path, LARGEST_FILE), str(path))

    def datetimes(self, numbers: npt.ArrayLike) -> npt.NDArray[np.datetime64]:
        """Time at which the camera took each frame, (n,) datetime64[ns], KITTI's local clock.

        Line k of the camera's ``timestamps.txt`` (from 0) belongs to frame k.
        """
        return self._times(_numbers(numbers))[1:]

    def timestamps(self, numbers: npt.ArrayLike) -> FloatArray:
        """Time at which the camera took each frame, (n,) float64 seconds since the drive's first.

        The origin is the first frame of the drive, also when it is not on disk, so that clips of one drive
        share a clock. Nanoseconds survive: a drive lasts minutes, float64 then resolves 1e-13 s.
        """
        times = self._times(_numbers(numbers))
        return np.asarray((times[1:] - times[0]).astype(np.int64) / 1e9)

    def poses(self, numbers: npt.ArrayLike) -> FloatArray:
        """Poses of the GPS/IMU unit, T_world_imu, (n, 4, 4) float64, metres.

        The world is east-north-up with its origin where the *first of* `numbers` was taken (pykitti's
        convention for the packets that it is given; Mercator scale of that packet's latitude).
        Camera poses are ``drive.poses(numbers) @ np.linalg.inv(drive.T_cam_imu)``.
        """
        from pykitti.utils import load_oxts_packets_and_poses

        folder = self._drive_folder / "oxts/data"
        paths = [folder / f"{number:010d}.txt" for number in _numbers(numbers)]
        with _reading(folder, "files with one packet of 30 numbers"):
            packets = load_oxts_packets_and_poses(paths)
            if len(packets) != len(paths):
                raise ValueError(f"{len(packets)} packets in {len(paths)} files")
        return np.array([packet.T_w_imu for packet in packets], dtype=np.float64).reshape(-1, 4, 4)

    @property
    def tracklet_file(self) -> Path:
        """File of the drive's tracklet labels; KITTI has none for many drives."""
        return self._drive_folder / TRACKLET_FILE

    @property
    def has_tracklets(self) -> bool:
        """Whether the tracklet labels are on disk."""
        return self.tracklet_file.is_file()

    def tracklets(self) -> list[Tracklet]:
        """Read the labelled 3D boxes of the drive."""
        path = self.tracklet_file
        if not self.has_tracklets:
            raise InputFileError(f"{path}: no such file", fix="KITTI has tracklets for some drives only")
        return read_tracklets(path)

    def tracklet_boxes(self, number: int, tracklets: Iterable[Tracklet] | None = None) -> list[TrackletBox]:
        """Project the tracklets of one frame to boxes in the camera's image: those in view, nearest first.

        `tracklets` are what `tracklets` returned, to read the file once for many frames.
        """
        K, T, size = self.K, self.T_cam_velo, self.image_size
        boxes = []
        for index, tracklet in enumerate(self.tracklets() if tracklets is None else tracklets):
            if number not in tracklet.numbers:
                continue
            row, corners = tracklet.row(number), tracklet.corners(number) @ T[:3, :3].T + T[:3, 3]
            box = project_box(corners, K, size)
            if box is not None:
                flags = int(tracklet.occlusion[row]), int(tracklet.truncation[row])
                boxes.append(TrackletBox(index, tracklet.kind, box, float(corners[:, 2].mean()), *flags))
        return sorted(boxes, key=lambda box: box.depth)

    def _times(self, numbers: IntArray) -> npt.NDArray[np.datetime64]:
        """Read the times of the drive's first frame and of these, (1 + n,)."""
        path, times = self._camera_folder / "timestamps.txt", []
        text = read_bytes(path, LARGEST_FILE).decode(errors="replace")
        lines = [line.strip() for line in text.splitlines()]
        first = next((k for k, line in enumerate(lines) if line), 0)
        for k in (first, *numbers):
            if k >= len(lines):
                expected = f"one of the file's {len(lines)} lines, counted from 0"
                raise InvalidValueError(f"{path}: frame {k}", expected=expected, found=str(k))
            with _reading(path, f"in line {k + 1} a time like 2011-09-26 13:02:25.964389445"):
                if not _TIME.fullmatch(lines[k]):
                    raise ValueError(repr(lines[k]))
                times.append(np.datetime64(lines[k], "ns"))
        return np.array(times, dtype="datetime64[ns]")


def _numbers(numbers: npt.ArrayLike) -> IntArray:
    wanted = np.atleast_1d(np.asarray(numbers))
    if wanted.size and not (np.issubdtype(wanted.dtype, np.integer) and wanted.min() >= 0):
        raise InvalidValueError("numbers", expected="frame numbers >= 0", found=str(wanted.tolist())[:80])
    return wanted.astype(np.int64).ravel()
