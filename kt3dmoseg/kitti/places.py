"""Where drives are to be had: KITTI's server or a mirror, or a folder with zips or extracted drives."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Protocol

from kt3dmoseg.catalog.entries import Drive
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.files import read_bytes
from kt3dmoseg.kitti import layout
from kt3dmoseg.kitti.archive import Archive
from kt3dmoseg.kitti.http import Client
from kt3dmoseg.kitti.member import LARGEST_MEMBER
from kt3dmoseg.kitti.network import AbsentError, RangesIgnoredError, Traffic
from kt3dmoseg.kitti.options import Origin
from kt3dmoseg.kitti.source import FileSource, HttpSource
from kt3dmoseg.kitti.store import Directory, Store, crc32_file


class Holding(Protocol):
    """Files of a drive, named by their path below the KITTI raw root."""

    @property
    def name(self) -> str:
        """Address or path, for messages."""

    @property
    def local(self) -> bool:
        """Whether reading it transfers nothing."""

    def names(self) -> Iterable[str]:
        """Names of all files."""

    def size(self, name: str) -> int:
        """Size of a file in bytes."""

    def crc32(self, name: str) -> int:
        """CRC32 of a file."""

    def cost(self, names: Iterable[str]) -> int:
        """Bytes that reading these files transfers."""

    def read(self, names: Iterable[str]) -> Iterator[tuple[str, bytes]]:
        """Yield names and verified contents, in any order."""


class Place(Protocol):
    """Somewhere that has drives."""

    def frames(self, drive: Drive) -> Holding:
        """Frames, timestamps and GPS/IMU packets of a drive."""

    def calibration(self, date: str) -> Holding:
        """Calibration of a day."""

    def tracklets(self, drive: Drive) -> Holding | None:
        """Tracklets of a drive, None when it has none."""

    def forget(self, holding: Holding) -> None:
        """Drop what is remembered of a holding that turned out to be damaged."""

    def trusted(self, holding: Holding) -> bool:
        """Whether the holding's directory was read in an earlier run."""

    def whole(self, url: str) -> Holding:
        """Download a whole zip whose server ignores ranges."""


class Tree:
    """Extracted files below a KITTI raw root."""

    def __init__(self, root: Path, folder: PurePosixPath) -> None:
        self._root, self._folder = root, folder
        self._sums: dict[str, int] = {}

    @property
    def name(self) -> str:
        """The folder's path."""
        return str(self._root / self._folder)

    @property
    def local(self) -> bool:
        """Always true."""
        return True

    @cached_property
    def _sizes(self) -> dict[str, int]:
        found = {}
        for folder, _, files in os.walk(self._root / self._folder):
            for file in files:
                path = Path(folder, file)
                if not file.startswith("."):
                    found[path.relative_to(self._root).as_posix()] = path.stat().st_size
        return found

    def names(self) -> Iterable[str]:
        """Names of all files."""
        return self._sizes.keys()

    def size(self, name: str) -> int:
        """Size of a file in bytes."""
        return self._sizes[name]

    def crc32(self, name: str) -> int:
        """CRC32 of a file, read once."""
        if name not in self._sums:
            self._sums[name] = crc32_file(self._root / name)
        return self._sums[name]

    def cost(self, names: Iterable[str]) -> int:
        """Nothing: the files are here."""
        return 0

    def read(self, names: Iterable[str]) -> Iterator[tuple[str, bytes]]:
        """Yield names and contents."""
        for name in names:
            yield name, read_bytes(self._root / name, LARGEST_MEMBER)


class Server:
    """KITTI's server, or a mirror with the same layout; directories are remembered in the store."""

    def __init__(self, address: str, client: Client, store: Store) -> None:
        if not address.startswith(("http://", "https://")):
            raise InvalidValueError("mirror", expected="an address http:// or https://", found=repr(address))
        self._base, self._client, self._store = address.rstrip("/"), client, store
        self._fresh: set[str] = set()

    def frames(self, drive: Drive) -> Archive:
        """Open the drive's zip through ranges."""
        return self._open(layout.sync_zip(drive))

    def calibration(self, date: str) -> Archive:
        """Open the day's zip, which is small."""
        return self._open(layout.calibration_zip(date), small=True)

    def tracklets(self, drive: Drive) -> Archive | None:
        """Open the drive's tracklets; None, and remembered as such, when the server has none."""
        address = layout.tracklet_zip(drive)
        known = self._store.directory(f"{self._base}/{address}")
        if known and known.size is None:
            return None
        try:
            return self._open(address, small=True)
        except AbsentError:
            self._store.keep_directory(f"{self._base}/{address}", Directory(None, b""))
            return None

    def forget(self, holding: Holding) -> None:
        """Drop the remembered directory."""
        self._store.forget_directory(holding.name)

    def trusted(self, holding: Holding) -> bool:
        """Whether the directory was remembered, and so has been through the doubts of another run."""
        return holding.name not in self._fresh

    def whole(self, url: str) -> Archive:
        """Download a whole zip, resuming what is there of it."""
        copy = self._store.zip_path(url)
        part = copy.with_suffix(".part")
        self._client.download(url, part)
        try:
            archive = Archive(FileSource(part))
        except FileFormatError:
            part.unlink(missing_ok=True)
            raise
        self._store.keep_directory(url, Directory(archive.source.size, archive.tail))
        part.replace(copy)
        return Archive(FileSource(copy))

    def _open(self, address: str, *, small: bool = False) -> Archive:
        url = f"{self._base}/{address}"
        copy = self._store.zip_path(url)
        if copy.is_file():
            return Archive(FileSource(copy))
        known = self._store.directory(url)
        if known and known.size is not None:
            return Archive(HttpSource(self._client, url, known.size), known.tail)
        self._fresh.add(url)
        try:
            archive = Archive(HttpSource(self._client, url, self._client.size(url)))
        except RangesIgnoredError:
            if not small or self._store.frozen:
                raise
            return self.whole(url)
        self._store.keep_directory(url, Directory(archive.source.size, archive.tail))
        return archive


class Folder:
    """A folder on disk with zips as downloaded from KITTI, or with extracted drives, or one zip."""

    def __init__(self, path: Path) -> None:
        if not path.exists():
            raise InputFileError(f"{path}: no such file or folder")
        self._path = path

    def frames(self, drive: Drive) -> Holding:
        """Find the extracted drive or its zip."""
        return self._find(layout.drive_folder(drive), layout.sync_zip(drive))

    def calibration(self, date: str) -> Holding:
        """Find the day's extracted calibration or its zip."""
        return self._find(PurePosixPath(date), layout.calibration_zip(date), layout.CALIBRATION_FILES[0])

    def tracklets(self, drive: Drive) -> Holding | None:
        """Find the drive's tracklets, None when they are not here."""
        try:
            return self._find(layout.drive_folder(drive), layout.tracklet_zip(drive), layout.TRACKLET_FILE)
        except AbsentError:
            return None

    def forget(self, holding: Holding) -> None:
        """Nothing is remembered of local files."""

    def trusted(self, holding: Holding) -> bool:
        """Local files are what they are."""
        return True

    def whole(self, url: str) -> Holding:
        """Nothing is downloaded."""
        raise AssertionError(f"{url}: local places have no address")

    def _find(self, folder: PurePosixPath, address: str, token: str = "") -> Holding:
        if (self._path / folder / token).exists():
            return Tree(self._path, folder)
        name = PurePosixPath(address).name
        places = [self._path / address, self._path / name, self._path / folder.parts[0] / name]
        if self._path.is_file():
            places = [self._path] if self._path.name == name else []
        for path in places:
            if path.is_file():
                return Archive(FileSource(path))
        raise AbsentError(f"{self._path}: neither {folder / token} nor {name} is there")


@contextmanager
def open_place(origin: Origin, store: Store, traffic: Traffic | None = None) -> Iterator[Place]:
    """Give the place that the options name; connections are closed at the end."""
    if origin.local is not None:
        yield Folder(Path(origin.local))
        return
    with closing(Client(origin, traffic)) as client:
        yield Server(origin.mirror, client, store)
