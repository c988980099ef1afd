"""Pictures: numbered frames of a folder as 8-bit gray, PNGs whose pixels are numbers, videos."""

import base64
import io
import os
import re
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from itertools import chain, pairwise
from pathlib import Path
from typing import Any, Literal, TypeAlias

import cv2
import numpy as np
import numpy.typing as npt
from PIL import Image, UnidentifiedImageError

from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.files import PathLike, atomic_path, listed, read_bytes, write_bytes
from kt3dmoseg.matching import number_in
from kt3dmoseg.types import ByteArray, FloatArray, IntArray

Colour: TypeAlias = Literal["refuse", "luma", "stored"]

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm", ".tif", ".tiff", ".webp")
_VIDEO = {".mp4": "mp4v", ".avi": "MJPG"}
_ANIMATION = {".gif": "GIF", ".apng": "PNG", ".webp": "WEBP"}
VIDEO_SUFFIXES = (".avi", ".mkv", ".mov", ".mp4", ".mpg", ".webm")
MOVING_SUFFIXES = (*_VIDEO, *_ANIMATION)
# FFmpeg's AV_LOG_QUIET, which OpenCV reads once: a damaged video is reported in one line of ours.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
_MAX_FILE = 1 << 28
MAX_PIXELS = 1 << 26
_SLOWEST, _FASTEST = 0.1, 240.0  # pictures per second
# Of KITTI MOTS, whose ids are 1000 * class + instance.
MOTS_CLASS, MOTS_VOID = 1000, 10_000
# Ids up to this are numbers of objects; gray levels that a person chose to see are brighter. Next to void
# no object has a number like the second: soft edges of a white object have.
_DARK, _BRIGHT = 20, 127
_FORMATS = ("PNG", "JPEG", "BMP", "PPM", "TIFF", "WEBP")  # none that runs another program
_BIT_DEPTH = 24  # where a PNG has it, in its header
_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
_GRAY_MODES = ("L", "I;16", "I;16B", "I", "F")
_DEEP = re.compile(r";16|^\('RGB', \d+\)$")  # the latter is PPM with a largest value other than 255
_ORIENTATION = 0x0112  # of EXIF; 1 is upright
# A marker before a segment, or the end; not the stuffed zeros and restarts within pixel data.
_MARKER = re.compile(rb"\xff[^\x00\x01\xd0-\xd7\xff]")


def frame_paths(folder: PathLike) -> list[Path]:
    """List the frames of a folder in the order of their numbers, by which their names end: ``000001.png``.

    InputFileError when the folder is missing, empty or holds a single frame; FileFormatError when a name
    has no number, a number is missing or given twice.
    """
    root = Path(folder)
    pictures = numbered_pictures(root)
    if len(pictures) < 2:
        expected = "at least two numbered frames (000001.png, 000002.png, ...)"
        found = f"only {next(iter(pictures.values())).name}" if pictures else "no pictures"
        fix = "give the folder that holds the frames of one clip"
        if below := next((path for path in listed(root) if not pictures and has_pictures(path)), None):
            fix = f"give {below}, or {root} for a clip of each of its folders"
        raise InputFileError(f"{root}", expected=expected, found=found, fix=fix)
    for before, after in pairwise(pictures):
        if after != before + 1:
            expected = f"frames numbered {min(pictures)} to {max(pictures)} without a gap"
            found, fix = f"{before} followed by {after}", "add the missing frames, or split the folder there"
            raise FileFormatError(f"{root}: frame {before + 1}", expected=expected, found=found, fix=fix)
    return list(pictures.values())


def has_pictures(folder: Path) -> bool:
    """Whether a path is a folder with pictures in it."""
    return folder.is_dir() and bool(_pictures(folder))


def is_clip(folder: Path) -> bool:
    """Whether a folder's own pictures are the frames of a clip; InputFileError when others lie below it."""
    if not has_pictures(folder):
        return False
    if below := next((path for path in listed(folder) if has_pictures(path)), None):
        expected = "frames, or one folder of frames per clip"
        found = f"both: {_pictures(folder)[0].name} and {below.name}"
        fix = "give the folder of one clip, or move one of them elsewhere"
        raise InputFileError(f"{folder}", expected=expected, found=found, fix=fix)
    return True


def numbered_pictures(folder: Path) -> dict[int, Path]:
    """Return the pictures of a folder by number, in order; there may be gaps, but no number twice."""
    out: dict[int, Path] = {}
    for file in _pictures(folder):
        if not file.is_file():
            raise FileFormatError(f"{file}", expected="a picture", found="a folder or device")
        number = frame_number(file)
        if number in out:
            where, found = f"{folder}: frame {number}", f"{out[number].name} and {file.name}"
            raise FileFormatError(where, expected="one file", found=found, fix="keep one of them")
        out[number] = file
    return dict(sorted(out.items()))


def _pictures(folder: Path) -> list[Path]:
    return [path for path in listed(folder) if path.suffix.lower() in IMAGE_SUFFIXES]


def frame_number(path: PathLike) -> int:
    """Return the last number in a frame's file name."""
    number = number_in(Path(path).name)
    if number is None:
        expected, fix = "a name that ends in the frame's number, as 000001.png", "rename or remove the file"
        raise FileFormatError(os.fspath(path), expected=expected, found=Path(path).name, fix=fix)
    return number


def picture_size(path: PathLike) -> tuple[int, int]:
    """Width and height of a picture; raises as `read_frame`."""
    return _loaded(read_bytes(path, _MAX_FILE), os.fspath(path))[0].size


def read_frame(path: PathLike, colour: Colour = "refuse") -> ByteArray:
    """Read one frame as 8-bit gray, (H, W) uint8.

    `colour` decides about a picture whose channels differ: refuse it, take its luma
    0.299 R + 0.587 G + 0.114 B (ITU-R BT.601), or keep it as it is stored, (H, W, 3). InputFileError when
    the file cannot be read; FileFormatError when it is damaged, 16-bit, or in colour that is refused.
    """
    return gray(read_picture(path), os.fspath(path), colour)


def read_frames(paths: Iterable[PathLike], colour: Colour = "refuse") -> Iterator[ByteArray]:
    """Read frames as `read_frame` does; FileFormatError also for one of another size than the first."""
    first: tuple[str, tuple[int, ...]] | None = None
    for path in paths:
        frame = read_frame(path, colour)
        name, shape = first = first or (Path(path).name, frame.shape[:2])
        if frame.shape[:2] != shape:
            expected, found = f"{shape[1]}x{shape[0]} px, as {name}", f"{frame.shape[1]}x{frame.shape[0]}"
            raise FileFormatError(f"{path}", expected=expected, found=found, fix="give frames of one size")
        yield frame


def read_picture(path: PathLike) -> npt.NDArray[Any]:
    """Read a picture as it is stored; see `decode`."""
    return decode(read_bytes(path, _MAX_FILE), os.fspath(path))


def decode(content: bytes, where: str) -> npt.NDArray[Any]:
    """Decode a picture with the depth it is stored in: (H, W) gray, or (H, W, 3) RGB without transparency.

    FileFormatError when it is no picture, huge, cut short, or damaged as far as its format shows that.
    """
    image, stored = _loaded(content, where)
    if not image.mode.startswith("I;16") and _DEEP.search(stored):  # of these, Pillow keeps 8 bits
        encoded, as_stored = np.frombuffer(content, np.uint8), cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH
        with quiet_opencv():
            picture = cv2.imdecode(encoded, as_stored)
        if picture is None:
            raise FileFormatError(where, expected="a depth that OpenCV decodes", found=stored)
        return np.asarray(picture if picture.ndim == 2 else picture[..., ::-1])
    if image.mode not in _GRAY_MODES:
        image = image.convert("L" if image.mode == "1" else "RGB")
    return np.asarray(image)


def decode_indices(content: bytes, where: str) -> tuple[IntArray, int]:
    """Decode a PNG of one channel, whatever its palette, to numbers (H, W) int64 and their bits (1 to 16)."""
    if not content.startswith(_PNG):
        raise FileFormatError(where, expected="an indexed or gray PNG", found="another file")
    image, _ = _loaded(content, where)
    if (channels := len(image.getbands())) != 1:
        found, fix = f"{channels} channels", "write it as indexed PNG, not as colours"
        raise FileFormatError(where, expected="one channel of numbers", found=found, fix=fix)
    bits = content[_BIT_DEPTH]
    # Pillow stretches gray of 2 and 4 bits to 0..255.
    stretch = 255 // ((1 << bits) - 1) if image.mode == "L" else 1
    return np.asarray(image).astype(np.int64) // stretch, bits


def void_ids(used: Collection[int], bits: int, where: str) -> list[int]:
    """Return which of the ids that the masks of a clip use are void, nothing to be scored on.

    10000 in the 16 bits of MOTS; in 8 bits 254 (ours) and 255 (DAVIS), but masks of 0 and 255 are of one
    object. Raises FileFormatError where 255 may be either, next to other values that one can see, and where
    no pixel is 0, the background.
    """
    if 0 not in used:
        expected, fix = "0 for the background", "number the background 0, and the objects from 1 on"
        raise FileFormatError(where, expected=expected, found=f"only {sorted(used)[:5]}", fix=fix)
    if bits == 16:
        return [MOTS_VOID]
    others = set(used) - {0, 255}
    if not others:
        return []
    if 255 in used and (min(others) > _DARK or max(others - {254}) > _BRIGHT):
        expected, fix = "ids 1, 2, ... (255 = void)", "number the objects from 1 on"
        raise FileFormatError(where, expected=expected, found=f"255 and {sorted(others)[:5]}", fix=fix)
    return [254, 255]


def encode_indices(indices: ByteArray, palette: ByteArray) -> bytes:
    """Encode indices (H, W) as a PNG with a palette, (256, 3) uint8 red, green and blue of each number."""
    image = Image.fromarray(indices)
    image.putpalette(palette.tobytes())
    buffer = io.BytesIO()
    image.save(buffer, "PNG")
    return buffer.getvalue()


def davis_palette() -> ByteArray:
    """Return the palette of PASCAL VOC and DAVIS, (256, 3) RGB.

    The bits of the index are spread over the high bits of the channels.
    """
    palette, index = np.zeros((256, 3), dtype=np.int64), np.arange(256)
    for bit in range(8):
        palette[:, bit % 3] |= ((index >> bit) & 1) << (7 - bit // 3)
    return palette.astype(np.uint8)


def _loaded(content: bytes, where: str) -> tuple[Image.Image, str]:
    """Return a checked picture and how Pillow describes its storage; what Pillow raises becomes one line."""
    fix = "the file is damaged; fetch it again"
    if content.startswith(_JPEG) and not _has_end(content):
        found = f"a file cut short at {len(content)} bytes"
        raise FileFormatError(where, expected="a complete JPEG", found=found, fix=fix)
    try:
        with Image.open(io.BytesIO(content), formats=_FORMATS) as image:
            if image.width * image.height > MAX_PIXELS:
                raise Image.DecompressionBombError(f"({image.width}x{image.height})")
            if image.format == "PNG":
                image.verify()  # the checksums, which decoding passes over
        with Image.open(io.BytesIO(content), formats=_FORMATS) as image:
            stored = str(image.tile[0].args) if image.tile else ""
            image.load()
    except (Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
        found = str(error).partition("(")[2].partition(")")[0]
        raise FileFormatError(where, expected=f"at most {MAX_PIXELS} pixels", found=found) from None
    except UnidentifiedImageError:
        found = f"a file that starts with {content[:8]!r}" if content else "an empty file"
        raise FileFormatError(where, expected="a picture", found=found) from None
    except Exception as error:  # Pillow's readers raise anything on damaged files
        raise FileFormatError(where, expected="an intact picture", found=str(error), fix=fix) from None
    orientation = 1
    with suppress(Exception):  # whatever Pillow raises on damaged EXIF, which browsers pass over, too
        orientation = image.getexif().get(_ORIENTATION, 1)
    if orientation in range(2, 9):  # browsers turn or mirror it: points tracked in it would lie elsewhere
        fix = "turn the pixels and remove the tag, as 'mogrify -auto-orient' does"
        found = f"EXIF orientation {orientation}"
        raise FileFormatError(where, expected="a picture stored upright", found=found, fix=fix)
    return image, stored


def _has_end(content: bytes) -> bool:
    """Whether a JPEG's picture ends (ITU-T T.81, B.1); previews within segments are skipped.

    libjpeg decodes the zeros of an unfinished download to gray, without a warning.
    """
    at = len(_JPEG)
    while found := _MARKER.search(content, at):
        if content[found.start() + 1] == 0xD9:  # end of image
            return True
        at = found.end() + int.from_bytes(content[found.end() : found.end() + 2], "big")
    return False


@contextmanager
def quiet_opencv() -> Iterator[None]:
    """Keep OpenCV from writing to standard error: a damaged file is reported in one line of ours."""
    logging = getattr(cv2.utils, "logging", cv2)  # where it lies depends on OpenCV's release
    level = logging.setLogLevel(0)  # silent
    try:
        yield
    finally:
        logging.setLogLevel(level)


def gray(picture: npt.NDArray[Any], where: str, colour: Colour = "refuse") -> ByteArray:
    """Return (H, W) uint8 from a decoded picture; see `read_frame`."""
    if picture.dtype != np.uint8:
        found = f"{8 * picture.dtype.itemsize} bits per channel"
        fix = "convert it to 8-bit gray first, with one scale for the whole clip"
        raise FileFormatError(where, expected="an 8-bit picture", found=found, fix=fix)
    if picture.ndim == 2:
        return picture
    if (picture == picture[..., :1]).all():
        return np.ascontiguousarray(picture[..., 0])
    if colour == "refuse":
        fix = "convert it to gray, or ask for its luma, colour='luma'"
        raise FileFormatError(where, expected="a gray picture", found="colour", fix=fix)
    return picture if colour == "stored" else np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY))


@contextmanager
def _opened_video(path: PathLike) -> Iterator[cv2.VideoCapture]:
    with quiet_opencv():
        # OpenCV's other readers write to standard error what they do not understand.
        video = cv2.VideoCapture(os.fspath(path), cv2.CAP_FFMPEG)
    try:
        yield video
    finally:
        video.release()


def read_video(path: PathLike, first: int = 0, step: int = 1, stop: int | None = None) -> Iterator[ByteArray]:
    """Yield every `step`-th picture of a video from `first` to before `stop`, (H, W, 3) RGB.

    FileFormatError when OpenCV decodes none.
    """
    number = first if first and _can_seek(path, first) else 0
    with _opened_video(path) as video:
        if number:
            video.set(cv2.CAP_PROP_POS_FRAMES, number)
        while (stop is None or number < stop) and video.grab():
            if number >= first and (number - first) % step == 0:
                intact, picture = video.retrieve()
                if not intact:
                    break
                yield np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), np.uint8)
            number += 1
    if not number:
        raise FileFormatError(os.fspath(path), expected="a video that OpenCV decodes", found="none")


def _can_seek(path: PathLike, number: int) -> bool:
    """Whether OpenCV goes to a picture by its number: it counts by time, and misses at a variable rate."""
    times = video_facts(path)[0]
    with _opened_video(path) as video:
        found = video.set(cv2.CAP_PROP_POS_FRAMES, number) and video.grab()
        there = np.flatnonzero(times == video.get(cv2.CAP_PROP_POS_MSEC) / 1000)
    return found and there.tolist() == [number]


def video_facts(path: PathLike) -> tuple[FloatArray, int]:
    """Return the time of every picture of a video in seconds, and by how many degrees pictures are turned.

    The video is decoded, once: the number in its header is often wrong. `read_video` turns the pictures.
    """
    file = Path(path).stat()
    return _video_facts(os.fspath(path), file.st_size, file.st_mtime_ns)


@lru_cache(maxsize=8)
def _video_facts(path: str, *_: int) -> tuple[FloatArray, int]:  # size and time: it may change
    with _opened_video(path) as video:
        times = [video.get(cv2.CAP_PROP_POS_MSEC) / 1000 for _ in iter(video.grab, False)]
        turned = int(video.get(cv2.CAP_PROP_ORIENTATION_META))
    if not times:
        raise FileFormatError(path, expected="a video that OpenCV decodes", found="none")
    return np.array(times), turned % 360


def resized(frame: ByteArray, size: tuple[int, int]) -> ByteArray:
    """Return a frame at another size (width, height); along a side that is shorter, pixels are averaged."""
    least = min(size[0], frame.shape[1]), min(size[1], frame.shape[0])
    averaged = cv2.resize(frame, least, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.resize(averaged, size, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)


def write_png(path: PathLike, picture: ByteArray) -> None:
    """Write one (H, W, 3) RGB or (H, W) gray picture atomically."""
    stored = picture[..., ::-1] if picture.ndim == 3 else picture
    write_bytes(path, bytes(cv2.imencode(".png", np.ascontiguousarray(stored))[1]))


def jpeg_address(picture: ByteArray, width: int, quality: int) -> str:
    """Return a picture (H, W) or (H, W, 3) BGR, at most so wide, as the address of data of a JPEG."""
    height, across = picture.shape[:2]
    size = width, max(1, round(height * width / across))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA) if across > width else picture
    content = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return "data:image/jpeg;base64," + base64.b64encode(content.tobytes()).decode()


def check_rate(rate: float) -> None:
    """Raise InvalidValueError for a rate of pictures per second that `write_moving` cannot write."""
    if not _SLOWEST <= rate <= _FASTEST:  # nor NaN
        expected = f"a number above 0, from {_SLOWEST:g} to {_FASTEST:g}"
        raise InvalidValueError("rate", expected=expected, found=f"{rate}")


def write_moving(path: PathLike, pictures: Iterable[ByteArray], rate: float) -> None:
    """Write (H, W, 3) RGB pictures of one size as a video or animation, by the path's suffix.

    Videos, ``.mp4`` and ``.avi``, take one picture into memory at a time. `rate` is in pictures per second.
    InvalidValueError for another suffix, InputFileError when the file cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix in _VIDEO:
        _write_video(Path(path), pictures, rate, suffix)
    elif suffix in _ANIMATION:
        first, *others = (Image.fromarray(picture) for picture in pictures)
        buffer = io.BytesIO()
        options = {"duration": round(1000 / rate), "loop": 0, "lossless": True}
        first.save(buffer, _ANIMATION[suffix], save_all=True, append_images=others, **options)
        write_bytes(path, buffer.getvalue())
    else:
        known = ", ".join(MOVING_SUFFIXES)
        raise InvalidValueError(os.fspath(path), expected=f"a suffix of {known}", found=repr(suffix))


def _write_video(path: Path, pictures: Iterable[ByteArray], rate: float, suffix: str) -> None:
    # The last row or column of an odd size is repeated: these codecs would drop it (4:2:0 chroma).
    even = (np.pad(p, ((0, p.shape[0] % 2), (0, p.shape[1] % 2), (0, 0)), mode="edge") for p in pictures)
    first = next(even)
    with atomic_path(path) as temporary, quiet_opencv():
        named = temporary.with_name(temporary.name + suffix)  # OpenCV goes by the name
        try:
            code = cv2.VideoWriter.fourcc(*_VIDEO[suffix])
            writer, count = cv2.VideoWriter(os.fspath(named), code, rate, first.shape[1::-1]), 0
            if not writer.isOpened():
                raise InputFileError(f"{path}: OpenCV cannot write this video", fix="try .avi")
            for picture in chain([first], even):
                writer.write(np.ascontiguousarray(picture[..., ::-1]))
                count += 1
            writer.release()
            with _opened_video(named) as video:  # read back: OpenCV does not report a full disk
                found = sum(1 for _ in iter(video.grab, False))
            if found < count:
                shown = f"{found} of {count} pictures"
                raise InputFileError(f"{path}: cannot write", found=shown, fix="is the disk full?")
            os.replace(named, temporary)
        finally:
            named.unlink(missing_ok=True)
