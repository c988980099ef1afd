"""Where drives are read from: KITTI's server, a mirror, a folder; and what the target folder keeps of it.

KITTI packs a drive's frames, a day's calibration and a drive's tracklets into one zip each. A server's zips
are read through ranges; a folder has the zips as downloaded, or the files extracted.
"""

from __future__ import annotations

import json
import re
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path, PurePosixPath
from typing import NamedTuple, TypeAlias

from kt3dmoseg import catalog
from kt3dmoseg.catalog import Drive, Entry
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.files import hold_folder, parse_json, read_bytes, write_bytes, write_text
from kt3dmoseg.kitti.http import AbsentError, Client, RangesIgnoredError, Traffic
from kt3dmoseg.kitti.options import Origin
from kt3dmoseg.kitti.raw import LOCATED
from kt3dmoseg.kitti.remote_zip import LARGEST_FILE, Archive, DamagedError

_COMMENT = """Frame numbers of clips in KITTI raw drives, and how they were proved.
Written by kt3dmoseg locate and pull; pull starts from them."""


class Packed(NamedTuple):
    """What KITTI packs into one zip: its address below raw_data, and where the files are when extracted.

    `probe` is a file that is there when it was extracted. Only frames, without one, are large: of the others
    a server without ranges may send all. Tracklets are missing for many drives.
    """

    zip: str
    folder: str
    probe: str = ""
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
        """Hold the folder alone; when another process holds it, report that and wait.

        Where the system has no ``flock`` (Windows), two pulls are safe, but may fetch the same file twice.
        """
        waiting = f"another process works in {self.root}; waiting for it"
        return nullcontext() if self.frozen else hold_folder(self.state, lambda: print(waiting, flush=True))

    def directory(self, url: str) -> tuple[int, bytes] | None:
        """Return the size and the end of an archive, as kept; the size is 0 when the server has none."""
        path = self.path_for(url, "directory")
        if not path.is_file():
            return None
        head, _, tail = read_bytes(path, LARGEST_FILE).partition(b"\n")
        try:
            size, crc = parse_json(head, "directory")
        except (ValueError, TypeError):
            return None
        return (size, tail) if crc == zlib.crc32(tail) else None

    def keep_directory(self, url: str, size: int, tail: bytes) -> None:
        """Keep the end of an archive, or that it does not exist."""
        if not self.frozen:
            head = json.dumps([size, zlib.crc32(tail)]).encode()
            write_bytes(self.path_for(url, "directory"), head + b"\n" + tail)

    def files(self) -> dict[str, tuple[int, int]]:
        """Files that were fetched, relative to the root, with size and CRC32."""
        path = self.state / "files.json"
        if not path.is_file():
            return {}
        try:
            listed = parse_json(read_bytes(path, LARGEST_FILE), "files", LARGEST_FILE)
            return {str(name): (int(size), int(crc, 16)) for name, (size, crc) in listed.items()}
        except (ValueError, TypeError, AttributeError):
            fix = "remove it and pull again"
            raise FileFormatError(
                str(path), expected="a list of files", found="other data", fix=fix
            ) from None

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

    def path_for(self, url: str, suffix: str) -> Path:
        """Where something about an archive is kept: its ``directory``, or the ``zip`` when all of it came."""
        return self.state / f"{PurePosixPath(url).stem}.{zlib.crc32(url.encode()):08x}.{suffix}"

    def downloaded(self, url: str) -> int:
        """Bytes that are here of a whole zip, from an interrupted download."""
        part = self.path_for(url, "part")
        return part.stat().st_size if part.is_file() else 0

    def drop_zips(self) -> None:
        """Remove downloaded zips, and parts of them; everything wanted is on disk."""
        for path in [*self.state.glob("*.zip"), *self.state.glob("*.part")]:
            path.unlink()


class Extracted:
    """Extracted files of a drive or a day; the interface is that of `Archive`."""

    local = True
    fresh = False

    def __init__(self, root: Path, folder: str) -> None:
        self.name, self._root = str(root / folder), root
        files = [f for f in (root / folder).rglob("[!.]*") if f.is_file()]
        self.sizes = {file.relative_to(root).as_posix(): file.stat().st_size for file in files}
        self.crc32 = cache(lambda name: crc32_file(root / name))

    def cost(self, names: Iterable[str]) -> int:
        """Nothing: the files are here."""
        return 0

    def read(self, names: Iterable[str]) -> Iterator[tuple[str, bytes]]:
        """Yield names and contents."""
        return ((name, read_bytes(self._root / name, LARGEST_FILE)) for name in names)


FileSet: TypeAlias = Archive | Extracted


class Server:
    """KITTI's server, or a mirror; the target folder keeps the directories of its zips."""

    def __init__(self, address: str, client: Client, target: TargetFolder) -> None:
        if not re.match(r"https?://[^/\s]", address):
            raise InvalidValueError("mirror", expected="an address http:// or https://", found=repr(address))
        self._base, self._client, self._target = address.rstrip("/"), client, target

    def open(self, packed: Packed, *, again: bool = False) -> Archive:
        """Open a zip; with `again`, what is kept of it may be damaged and is fetched once more."""
        url = f"{self._base}/{packed.zip}"
        if copy := self._copy(url, again=again):
            return copy
        try:
            known = None if again else self._target.directory(url)
            size, tail = known or (self._client.size(url), b"")
            if not size:
                raise AbsentError(f"{url}: the server had no such file before")
            self._client.sizes[url] = size
            archive = Archive(url, size, partial(self._client.chunks, url), tail)
        except RangesIgnoredError:
            if not packed.probe or self._target.frozen:
                raise
            return self.download(url)
        except AbsentError:
            if packed.optional:
                self._target.keep_directory(url, 0, b"")
            raise
        if archive.fresh:
            self._target.keep_directory(url, *archive.directory)
        return archive

    def _copy(self, url: str, *, again: bool) -> Archive | None:
        """Open the whole zip of an earlier download; one that is not intact is removed."""
        path = self._target.path_for(url, "zip")
        try:
            if path.is_file() and not again:
                return Archive.on_disk(path)
        except FileFormatError:
            pass
        if not self._target.frozen:
            path.unlink(missing_ok=True)
        return None

    def download(self, url: str, progress: Callable[[int], object] = lambda count: None) -> Archive:
        """Download all of a zip whose server ignores ranges, resuming what is there of it.

        DamagedError when it is not intact then; it is removed.
        """
        copy = self._target.path_for(url, "zip")
        part = copy.with_suffix(".part")
        part.parent.mkdir(parents=True, exist_ok=True)
        self._client.download(url, part, progress)
        try:
            archive = Archive.on_disk(part)
            for _ in archive.read(name for name, size in archive.sizes.items() if size <= LARGEST_FILE):
                pass  # every file has its checksum
        except FileFormatError as error:
            part.unlink(missing_ok=True)
            raise DamagedError(error.where, expected=error.expected, found=error.found) from None
        self._target.keep_directory(url, *archive.directory)
        part.replace(copy)
        return Archive.on_disk(copy)


class LocalFolder:
    """A folder on disk with zips as downloaded from KITTI, or with extracted drives; or one zip."""

    def __init__(self, path: Path) -> None:
        if not path.exists():
            raise InputFileError(f"{path}: no such file or folder")
        self._path = path

    def open(self, packed: Packed, *, again: bool = False) -> FileSet:
        """Find the extracted files or their zip."""
        if (self._path / packed.folder / packed.probe).exists():
            return Extracted(self._path, packed.folder)
        name = PurePosixPath(packed.zip).name
        paths = [self._path / packed.zip, self._path / name, self._path / packed.folder[:10] / name]
        if self._path.is_file():
            paths = [self._path] if self._path.name == name else []
        for path in paths:
            if path.is_file():
                return Archive.on_disk(path)
        raise AbsentError(f"{self._path}: neither {Path(packed.folder, packed.probe)} nor {name} is there")

    def download(self, url: str, progress: Callable[[int], object] = lambda count: None) -> Archive:
        """Nothing is downloaded."""
        raise AssertionError(f"{url}: local folders have no address")


@contextmanager
def open_origin(
    origin: Origin, target: TargetFolder, traffic: Traffic | None = None
) -> Iterator[Server | LocalFolder]:
    """Give what the options name; connections are closed at the end."""
    if origin.local is not None:
        yield LocalFolder(Path(origin.local))
        return
    with closing(Client(origin, traffic)) as client:
        yield Server(origin.mirror, client, target)


def crc32_file(path: Path) -> int:
    """CRC32 of a file of at most 64 MiB."""
    return zlib.crc32(read_bytes(path, LARGEST_FILE))
