"""Where drives are read from: KITTI's server, a mirror, a folder; and what the target folder keeps of it.

KITTI packs a drive's frames, a day's calibration and a drive's tracklets into one zip each. A server's zips
are read through ranges, the directory first, then only the wanted files; a folder has the zips as downloaded,
or the files extracted. What a zip's directory states is a claim: an archive is refused for unsafe names,
symbolic links, duplicates, encrypted files and files that overlap; a file is refused when it is too large or
its bytes do not bear out size and CRC32.
"""

from __future__ import annotations

import io
import json
import re
import shutil
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import NamedTuple, TypeAlias, TypeVar

from kt3dmoseg import catalog
from kt3dmoseg.catalog import Drive, Entry
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.files import SafeZip, ZipLimits, hold_folder, parse_json, read_bytes, write_bytes, write_text
from kt3dmoseg.kitti import Origin
from kt3dmoseg.kitti.http import AbsentError, Client, RangesIgnoredError, Traffic
from kt3dmoseg.kitti.raw import LARGEST_FILE, LOCATED

T = TypeVar("T")
Chunks: TypeAlias = Callable[[int, int], Iterator[bytes]]

_LARGEST_DIRECTORY = 8 << 20
_HEADER = 30
_TAIL = (1 << 16) + 22 + 20 + 56  # the end record with its longest comment, and zip64's locator and record
# KITTI's zips hold 4 GB; one file is limited when it is read. Deflate cannot reach more than 1032 : 1.
_LIMITS = ZipLimits(
    files=1 << 20, file_bytes=1 << 40, total_bytes=1 << 50, ratio=1100, free_bytes=1024, depth=32
)
_LONGEST_GAP = 4096  # a smaller gap between two files is read too, which saves a request
_LONGEST_RUN = 2 << 20  # what is under way is lost when a pull is killed
_ATTEMPTS = 3
_RESERVE = 16 << 20
_COMMENT = """Frame numbers of clips in KITTI raw drives, and how they were proved.
Written by kt3dmoseg locate and pull; pull starts from them."""


class DamagedError(FileFormatError):
    """Bytes do not match their checksum or their directory; reading them again may help."""


class _RangeFile(io.RawIOBase):
    """A remote file, for `zipfile`: it keeps the end, and takes the rest from the requested range.

    The end, where the directory is, grows backwards as far as it is read, until a range is requested.
    """

    def __init__(self, name: str, size: int, chunks: Chunks, tail: bytes) -> None:
        self.name, self.size = name, size
        self.tail = tail or b"".join(chunks(max(0, size - _TAIL), min(size, _TAIL)))
        self._chunks, self._at = chunks, 0
        self._range: tuple[int, bytearray, Iterator[bytes]] | None = None

    @property
    def held(self) -> int:
        return self.size - len(self.tail)

    def request(self, start: int, length: int) -> Iterator[bytes]:
        """Request a range, from which `read` takes as it arrives; return what is left of it then."""
        kept = self.tail[start - self.held :] if start >= self.held else b""
        arriving = iter([kept]) if kept else self._chunks(start, length)
        self._range = start, bytearray(), arriving
        return arriving

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = 0) -> int:
        self._at = offset + (0, self._at, self.size)[whence]
        if self._at < 0:
            raise OSError("a position before the archive's start")
        return self._at

    def read(self, size: int | None = -1) -> bytes:
        end = self.size if size is None or size < 0 else min(self.size, self._at + size)
        start, buffer, arriving = self._range or self._directory()
        while start + len(buffer) < end and (chunk := next(arriving, b"")):
            buffer += chunk
        block = bytes(buffer[self._at - start : max(self._at, end) - start])
        self._at += len(block)
        return block

    def _directory(self) -> tuple[int, bytearray, Iterator[bytes]]:
        if self.size - self._at > _LARGEST_DIRECTORY:
            found = f"one that begins {self.size - self._at} bytes before the end"
            expected = f"a directory of at most {_LARGEST_DIRECTORY} bytes"
            raise FileFormatError(self.name, expected=expected, found=found)
        if self._at < self.held:
            self.tail = b"".join(self._chunks(self._at, self.held - self._at)) + self.tail
        return self.held, bytearray(self.tail), iter(())


class Archive:
    """A zip archive on a server or on disk.

    ``chunks(start, length)`` yields exactly these of its `size` bytes, in pieces. With the `tail` of an
    earlier `directory` this is not read again. FileFormatError is raised when it is not a zip archive, is
    damaged or truncated, or is hostile.
    """

    def __init__(
        self, name: str, size: int, chunks: Chunks, tail: bytes = b"", *, local: bool = False
    ) -> None:
        self.name, self.local = name, local
        self.fresh = not tail and not local  # read just now from the network; no checksum protects it
        for attempt in range(1, _ATTEMPTS + 1):
            try:
                self._file = _RangeFile(name, size, chunks, tail)
                self._zip = SafeZip(self._file, _LIMITS, name)
                self._spans = self._find_spans()
                break
            except FileFormatError:
                if attempt == _ATTEMPTS:
                    raise
        self.directory, self.sizes = (size, self._file.tail), self._zip.sizes

    @classmethod
    def on_disk(cls, path: Path) -> Archive:
        """Open a file."""
        return cls(str(path), path.stat().st_size, partial(_read_file, path), local=True)

    @classmethod
    def verified(cls, path: Path) -> Archive:
        """Open a file that was downloaded whole, once every file in it has its checksum."""
        archive = cls.on_disk(path)
        for _ in archive.read(name for name, size in archive.sizes.items() if size <= LARGEST_FILE):
            pass
        return archive

    def crc32(self, name: str) -> int:
        """CRC32 of a file, as the directory claims it; `read` verifies it."""
        return self._zip.infos[name].CRC

    def cost(self, names: Iterable[str]) -> int:
        """Bytes that `read` requests."""
        return sum(stop - start for start, stop, _ in self._runs(names) if start < self._file.held)

    def read(self, names: Iterable[str]) -> Iterator[tuple[str, bytes]]:
        """Yield the wanted files' names and contents, verified by size and CRC32.

        Neighbours come in one request, each is yielded as soon as its bytes are here. A damaged file is
        requested again, up to three times in all, before DamagedError is raised. FileFormatError is raised
        for a file larger than 64 MiB.
        """
        wanted = list(names)
        for name in wanted:
            if self.sizes[name] > LARGEST_FILE:
                self._refuse(name, f"unpacks to {self.sizes[name]} bytes, more than {LARGEST_FILE}")
        for attempts_left in reversed(range(_ATTEMPTS)):
            damaged: list[str] = []
            yield from self._read_once(wanted, damaged, last=not attempts_left)
            wanted = damaged

    def _read_once(
        self, names: Iterable[str], damaged: list[str], *, last: bool
    ) -> Iterator[tuple[str, bytes]]:
        """Yield what is intact; list the `damaged` files, or raise DamagedError for the first."""
        for start, stop, run in self._runs(names):
            rest = self._file.request(start, stop - start)
            for name in run:
                try:
                    content = self._zip.read(name)  # zipfile checks the CRC
                except FileFormatError as error:
                    if last:
                        expected = f"{self.sizes[name]} bytes with CRC {self.crc32(name):08x}"
                        raise DamagedError(error.where, expected=expected, found=error.found) from None
                    damaged.append(name)
                    continue
                yield name, content
            for _ in rest:  # sees its end, so that the connection can serve the next run
                pass

    def _find_spans(self) -> dict[str, tuple[int, int]]:
        """Where each file begins, and where the next one does."""
        infos = self._zip.infos
        names = sorted(infos, key=lambda name: infos[name].header_offset)
        starts = [infos[name].header_offset for name in names]
        spans = dict(zip(names, pairwise([*starts, self._zip.directory_start]), strict=True))
        for name, (start, end) in spans.items():
            least = _HEADER + len(infos[name].orig_filename) + infos[name].compress_size
            if start < 0 or start + least > end:
                self._refuse(name, "overlaps its neighbour")
        return spans

    def _refuse(self, name: str, fault: str) -> None:
        raise FileFormatError(f"{self.name}: refused: file {name!r:.200} {fault}")

    def _runs(self, names: Iterable[str]) -> Iterator[tuple[int, int, list[str]]]:
        """Group files that are neighbours, to be fetched in one request of at most 2 MiB."""
        run: list[str] = []
        start = stop = 0
        for name in sorted(names, key=self._spans.__getitem__):
            offset, end = self._spans[name]
            if run and (offset - stop > _LONGEST_GAP or end - start > _LONGEST_RUN):
                yield start, stop, run
                run = []
            start, stop = (start if run else offset), end
            run.append(name)
        if run:
            yield start, stop, run


def _read_file(path: Path, start: int, length: int) -> Iterator[bytes]:
    with open(path, "rb") as stream:
        stream.seek(start)
        while block := stream.read(min(length, 1 << 20)):
            length -= len(block)
            yield block


class Packed(NamedTuple):
    """What KITTI packs into one zip: its address below raw_data, and where the files are when extracted.

    `names` are the wanted files in the folder. Only frames, which have none, are large: of the others a
    server without ranges may send all. Tracklets are missing for many drives.
    """

    zip: str
    folder: str
    names: tuple[str, ...] = ()
    optional: bool = False


def frames_of(drive: Drive) -> Packed:
    """Frames, timestamps and GPS/IMU packets of a drive."""
    return Packed(f"{drive.name}/{drive.name}_sync.zip", drive.folder)


@dataclass(frozen=True)
class TargetFolder:
    """The folder that `pull` fills, and what it keeps: licence, directories of zips, checksums of files.

    All of it is in ``.kt3dmoseg/`` inside the folder, but for ``located.toml``, which is meant for people.
    Nothing is written when it is `frozen`, for a dry run.
    """

    root: Path
    frozen: bool = False

    @property
    def state(self) -> Path:
        """Folder of what is kept."""
        return self.root / ".kt3dmoseg"

    def lock(self) -> AbstractContextManager[object]:
        """Hold the folder alone; when another process holds it, report that and wait."""
        waiting = f"another process works in {self.root}; waiting for it"
        return nullcontext() if self.frozen else hold_folder(self.state, lambda: print(waiting, flush=True))

    def directory(self, url: str) -> tuple[int, bytes] | None:
        """Return the size and the end of an archive, as kept; the size is 0 when the server has none."""
        path = self.path_for(url, "directory")
        head, _, tail = (read_bytes(path, LARGEST_FILE) if path.is_file() else b"").partition(b"\n")
        known = re.fullmatch(rb"\[(\d+), (\d+)\]", head)
        return (int(known[1]), tail) if known and int(known[2]) == zlib.crc32(tail) else None

    def keep_directory(self, url: str, size: int, tail: bytes) -> None:
        """Keep the end of an archive, or that it does not exist."""
        if not self.frozen:
            write_bytes(self.path_for(url, "directory"), b"[%d, %d]\n%b" % (size, zlib.crc32(tail), tail))

    def files(self) -> dict[str, tuple[int, int]]:
        """Files that were fetched, relative to the root, with size and CRC32."""
        path = self.state / "files.json"
        try:
            listed = parse_json(read_bytes(path, LARGEST_FILE), "", LARGEST_FILE) if path.is_file() else {}
            return {str(name): (int(size), int(crc, 16)) for name, (size, crc) in listed.items()}
        except (ValueError, TypeError, AttributeError):
            expected, fix = "a list of files", "remove it and pull again"
            raise FileFormatError(f"{path}", expected=expected, found="other data", fix=fix) from None

    def keep_files(self, fetched: Mapping[str, tuple[int, int]]) -> None:
        """Keep size and CRC32 of files that were fetched."""
        present = self.files()
        if fetched.items() - present.items():
            merged = sorted((present | dict(fetched)).items())
            text = json.dumps({name: [size, f"{crc:08x}"] for name, (size, crc) in merged}, indent=0)
            write_text(self.state / "files.json", f"{text}\n")

    def located(self) -> dict[str, Entry]:
        """Clips whose frame numbers were proved, by name."""
        path = self.root / LOCATED
        return catalog.load(path, built_in=False) if path.is_file() else {}

    def keep_located(self, clips: Iterable[Entry]) -> None:
        """Keep clips' frame numbers, in ``located.toml``."""
        present = self.located()
        merged = present | {clip.name: clip for clip in clips}
        if merged != present:
            catalog.save(self.root / LOCATED, [merged[name] for name in sorted(merged)], comment=_COMMENT)

    def check_space(self, needed: int) -> None:
        """Raise InputFileError when fewer bytes are free on the disk, with a reserve."""
        existing = next(path for path in (self.root, *self.root.absolute().parents) if path.exists())
        free = shutil.disk_usage(existing).free
        if needed > 0 and free < needed + _RESERVE:
            expected = f"{megabytes(needed + _RESERVE)} free"
            raise InputFileError(f"{self.root}: disk", expected=expected, found=megabytes(free))

    def path_for(self, url: str, suffix: str) -> Path:
        """Where something about an archive is kept: its ``directory``, or the ``zip`` when all of it came."""
        return self.state / f"{PurePosixPath(url).stem}.{zlib.crc32(url.encode()):08x}.{suffix}"


class Extracted:
    """Extracted files of a drive or a day; the interface is that of `Archive`."""

    local = True
    fresh = False

    def __init__(self, root: Path, folder: str) -> None:
        self.name, self._root = str(root / folder), root
        files = [f for f in (root / folder).rglob("[!.]*") if f.is_file()]
        self.sizes = {file.relative_to(root).as_posix(): file.stat().st_size for file in files}

    def crc32(self, name: str) -> int:
        """CRC32 of a file."""
        return crc32_file(self._root / name)

    def read(self, names: Iterable[str]) -> Iterator[tuple[str, bytes]]:
        """Yield names and contents."""
        return ((name, read_bytes(self._root / name, LARGEST_FILE)) for name in names)


FileSet: TypeAlias = Archive | Extracted


class Archives:
    """The archives of a server, of which the target folder keeps the directories, or those in a folder.

    `local` is that folder. When a server ignores ranges, all of a zip is fetched at once.
    """

    def __init__(
        self, origin: Origin, target: TargetFolder, traffic: Traffic | None, report: Callable[[str], object]
    ) -> None:
        self.local = Path(origin.local) if origin.local is not None else None
        if self.local is not None and not self.local.exists():
            raise InputFileError(f"{self.local}: no such file or folder")
        if self.local is None and not re.match(r"https?://[^/\s]", origin.mirror):
            expected = "an address http:// or https://"
            raise InvalidValueError("mirror", expected=expected, found=repr(origin.mirror))
        self._base, self._target, self._report = origin.mirror.rstrip("/"), target, report
        self._client = Client(origin, traffic)
        self.close = self._client.close

    def look(self, packed: Packed, look: Callable[[FileSet, bool], T], *, again: bool = False) -> T:
        """Return ``look(files, again)``; what is damaged is read once more from the server, with `again`.

        It raises AbsentError, and RangesIgnoredError in a dry run.
        """
        if not again:
            try:
                return look(self._open(packed, again=False), False)
            except DamagedError as error:
                if self.local is not None:
                    raise
                self._report(f"{error}; fetching it again")
        return look(self._open(packed, again=True), True)

    def _open(self, packed: Packed, *, again: bool) -> FileSet:
        """Open a zip; with `again`, what is kept of it may be damaged and is fetched once more."""
        if self.local is not None:
            return _find(self.local, packed)
        url = f"{self._base}/{packed.zip}"
        whole = self._target.path_for(url, "zip")
        with suppress(FileFormatError):
            if whole.is_file() and not again:
                return Archive.on_disk(whole)
        if not self._target.frozen:
            whole.unlink(missing_ok=True)
        try:
            return self._on_server(url, again=again)
        except RangesIgnoredError as error:
            if self._target.frozen:
                raise
            self._report(f"{error}; fetching all of the file")
            return self._download(url, error.size, whole)
        except AbsentError:
            if packed.optional:
                self._target.keep_directory(url, 0, b"")
            raise

    def _on_server(self, url: str, *, again: bool) -> Archive:
        known = None if again else self._target.directory(url)
        size, tail = known or (self._client.size(url), b"")
        if not size:
            raise AbsentError(f"{url}: the server had no such file before")
        self._client.sizes[url] = size
        archive = Archive(url, size, partial(self._client.chunks, url), tail)
        if archive.fresh:
            self._target.keep_directory(url, *archive.directory)
        return archive

    def _download(self, url: str, size: int | None, whole: Path) -> Archive:
        """Download all of a zip, resuming what is there of it; one that is not intact then is removed."""
        part = self._target.path_for(url, "part")
        self._target.check_space((size or 0) - (part.stat().st_size if part.is_file() else 0))
        self._client.download(url, part, "zip", size)
        try:
            archive = Archive.verified(part)
        except FileFormatError as error:
            part.unlink(missing_ok=True)
            raise DamagedError(error.where, expected=error.expected, found=error.found) from None
        self._target.keep_directory(url, *archive.directory)
        part.replace(whole)
        return Archive.on_disk(whole)


def _find(local: Path, packed: Packed) -> FileSet:
    probe, name = "".join(packed.names[:1]), PurePosixPath(packed.zip).name
    if (local / packed.folder / probe).exists():
        return Extracted(local, packed.folder)
    for path in (local / packed.zip, local / name, local / packed.folder[:10] / name):
        if path.is_file():
            return Archive.on_disk(path)
    raise AbsentError(f"{local}: neither {Path(packed.folder, probe)} nor {name} is there")


def crc32_file(path: Path) -> int:
    """CRC32 of a file of at most 64 MiB."""
    return zlib.crc32(read_bytes(path, LARGEST_FILE))


def megabytes(count: int) -> str:
    """Write a number of bytes for people."""
    return f"{count / 1e6:.1f} MB"
