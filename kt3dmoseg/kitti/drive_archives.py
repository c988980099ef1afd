"""Where drives are read from: KITTI's server, a mirror, a folder; and what the target folder keeps of it.

KITTI packs a drive's frames, a day's calibration and a drive's tracklets into one zip each. A server's zips
are read through ranges; a folder has the zips as downloaded, or the files extracted.
"""

from __future__ import annotations

import json
import re
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath
from typing import NamedTuple, TypeAlias, TypeVar

from tqdm import tqdm

from kt3dmoseg import catalog
from kt3dmoseg.catalog import Drive, Entry
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.files import hold_folder, parse_json, read_bytes, write_bytes, write_text
from kt3dmoseg.kitti.http import AbsentError, Client, RangesIgnoredError, Traffic
from kt3dmoseg.kitti.options import Origin
from kt3dmoseg.kitti.raw import LARGEST_FILE, LOCATED
from kt3dmoseg.kitti.remote_zip import Archive, DamagedError

T = TypeVar("T")

_COMMENT = """Frame numbers of clips in KITTI raw drives, and how they were proved.
Written by kt3dmoseg locate and pull; pull starts from them."""


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
        try:
            listed = parse_json(read_bytes(path, LARGEST_FILE), "", LARGEST_FILE) if path.is_file() else {}
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

    def cost(self, names: Iterable[str]) -> int:
        """Nothing: the files are here."""
        return 0

    def read(self, names: Iterable[str]) -> Iterator[tuple[str, bytes]]:
        """Yield names and contents."""
        return ((name, read_bytes(self._root / name, LARGEST_FILE)) for name in names)


FileSet: TypeAlias = Archive | Extracted


class Archives:
    """The archives of a server, of which the target folder keeps the directories, or those in a folder.

    `local` is that folder; it may be one zip. When a server ignores ranges, all of a zip is fetched at once
    if it is small or `whole` is true.
    """

    def __init__(
        self, origin: Origin, target: TargetFolder, traffic: Traffic | None,
        report: Callable[[str], object], *, whole: bool = False,
    ) -> None:  # fmt: skip
        self.local = Path(origin.local) if origin.local is not None else None
        if self.local is not None and not self.local.exists():
            raise InputFileError(f"{self.local}: no such file or folder")
        if self.local is None and not re.match(r"https?://[^/\s]", origin.mirror):
            expected = "an address http:// or https://"
            raise InvalidValueError("mirror", expected=expected, found=repr(origin.mirror))
        self._base, self._target = origin.mirror.rstrip("/"), target
        self._report, self._whole = report, whole
        self._client = Client(origin, traffic)
        self.close = self._client.close

    def look(self, packed: Packed, look: Callable[[FileSet, bool], T], *, again: bool = False) -> T:
        """Return ``look(files, again)``; what is damaged is read once more from the server, with `again`.

        It raises AbsentError, or RangesIgnoredError when all of the zip must be fetched by `download` first.
        """
        if not again:
            try:
                return look(self._open(packed, again=False), False)
            except DamagedError as error:
                if self.local is not None:
                    raise
                self._report(f"{error}; fetching it again")
        return look(self._open(packed, again=True), True)

    def download(self, url: str, size: int | None) -> Archive:
        """Download all of a zip whose server ignores ranges, resuming what is there of it.

        DamagedError when it is not intact then; it is removed.
        """
        copy, part = self._target.path_for(url, "zip"), self._target.path_for(url, "part")
        part.parent.mkdir(parents=True, exist_ok=True)
        with tqdm(total=size, unit="B", unit_scale=True, desc="zip", disable=None) as bar:
            self._client.download(url, part, bar.update)
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

    def _open(self, packed: Packed, *, again: bool) -> FileSet:
        """Open a zip; with `again`, what is kept of it may be damaged and is fetched once more."""
        if self.local is not None:
            return _find(self.local, packed)
        url = f"{self._base}/{packed.zip}"
        return self._copy(url, again=again) or self._on_server(packed, url, again=again)

    def _on_server(self, packed: Packed, url: str, *, again: bool) -> Archive:
        try:
            known = None if again else self._target.directory(url)
            size, tail = known or (self._client.size(url), b"")
            if not size:
                raise AbsentError(f"{url}: the server had no such file before")
            self._client.sizes[url] = size
            archive = Archive(url, size, partial(self._client.chunks, url), tail)
        except RangesIgnoredError as error:
            if self._target.frozen or not (self._whole or packed.names):
                raise
            self._report(f"{error}; fetching all of the file, which pull will use")
            return self.download(url, error.size)
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


def _find(local: Path, packed: Packed) -> FileSet:
    """Find the extracted files or their zip in a folder."""
    probe, name = "".join(packed.names[:1]), PurePosixPath(packed.zip).name
    if (local / packed.folder / probe).exists():
        return Extracted(local, packed.folder)
    places = [local / packed.zip, local / name, local / packed.folder[:10] / name]
    if local.is_file():
        places = [local] if local.name == name else []
    for path in places:
        if path.is_file():
            return Archive.on_disk(path)
    raise AbsentError(f"{local}: neither {Path(packed.folder, probe)} nor {name} is there")


def crc32_file(path: Path) -> int:
    """CRC32 of a file of at most 64 MiB."""
    return zlib.crc32(read_bytes(path, LARGEST_FILE))
