"""What a pull remembers in its target folder: licence, directories of archives, files and their checksums.

Everything lies in ``.kt3dmoseg/`` inside the target, but for ``located.toml``, which people read. Nothing is
kept anywhere else.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from kt3dmoseg import catalog
from kt3dmoseg.catalog.entries import Entry
from kt3dmoseg.errors import FileFormatError, InputFileError
from kt3dmoseg.files import hold_folder, read_bytes, write_bytes, write_text

_FOLDER = ".kt3dmoseg"
LOCATED = "located.toml"
_LARGEST = 64 << 20
_COMMENT = """Frame numbers of clips in KITTI raw drives, and how they were proved.
Written by kt3dmoseg locate and pull; pull starts from them."""


@dataclass(frozen=True)
class Directory:
    """The remembered end of an archive; `size` is None when the server has no such archive."""

    size: int | None
    tail: bytes


@dataclass(frozen=True)
class Store:
    """The memory of one target folder.

    Parameters
    ----------
    root : path
        The target folder, a KITTI raw root.
    frozen : bool
        Whether nothing may be written, for a dry run.
    """

    root: Path
    frozen: bool = False

    @property
    def folder(self) -> Path:
        """Where the memory lies."""
        return self.root / _FOLDER

    @contextmanager
    def lock(self, waiting: str = "") -> Iterator[None]:
        """Hold the folder alone; print `waiting` when another process holds it, then wait for it.

        The system releases it when a process ends, however it ends. Where it has no ``flock`` (Windows), two
        pulls are still safe, but may fetch the same file twice.
        """
        if self.frozen:
            yield
            return
        with hold_folder(self.folder, busy=lambda: print(waiting, flush=True)):
            yield

    @property
    def licence_accepted(self) -> bool:
        """Whether the data's licence was acknowledged for this folder."""
        return (self.folder / "licence.txt").is_file()

    def accept_licence(self, text: str) -> None:
        """Remember that the licence was acknowledged."""
        if not self.frozen:
            write_text(self.folder / "licence.txt", text)

    def directory(self, url: str) -> Directory | None:
        """Return the remembered directory of an archive, None when there is none."""
        path = self._beside(url, "directory")
        if not path.is_file():
            return None
        head, _, tail = read_bytes(path, _LARGEST).partition(b"\n")
        try:
            fields = json.loads(head)
            if fields["url"] != url or fields["crc32"] != zlib.crc32(tail):
                return None
            return Directory(None if fields["size"] is None else int(fields["size"]), tail)
        except (ValueError, KeyError, TypeError):
            return None

    def keep_directory(self, url: str, directory: Directory) -> None:
        """Remember the end of an archive, or that it does not exist."""
        if not self.frozen:
            head = {"url": url, "size": directory.size, "crc32": zlib.crc32(directory.tail)}
            write_bytes(self._beside(url, "directory"), json.dumps(head).encode() + b"\n" + directory.tail)

    def forget_directory(self, url: str) -> None:
        """Drop what is remembered of an archive."""
        if not self.frozen:
            self._beside(url, "directory").unlink(missing_ok=True)

    def files(self) -> dict[str, tuple[int, int]]:
        """Files that were brought, relative to the root, with size and CRC32.

        Raises
        ------
        FileFormatError
            When the list is damaged.
        """
        path = self.folder / "files.json"
        if not path.is_file():
            return {}
        try:
            listed = json.loads(read_bytes(path, _LARGEST))
            return {str(name): (int(size), int(crc, 16)) for name, (size, crc) in listed.items()}
        except (ValueError, TypeError, AttributeError):
            raise FileFormatError(
                str(path), expected="a list of files", found="something else", fix="remove it and pull again"
            ) from None

    def keep_files(self, brought: Mapping[str, tuple[int, int]]) -> None:
        """Remember size and CRC32 of files that were brought."""
        present = self.files()
        if not self.frozen and brought.items() - present.items():
            merged = {
                name: [size, f"{crc:08x}"] for name, (size, crc) in sorted((present | dict(brought)).items())
            }
            write_text(self.folder / "files.json", json.dumps(merged, indent=0) + "\n")

    def located(self) -> dict[str, Entry]:
        """Clips whose frame numbers were proved, by name."""
        path = self.root / LOCATED
        return catalog.load(path, built_in=False) if path.is_file() else {}

    def keep_located(self, entries: Iterable[Entry]) -> None:
        """Remember clips' frame numbers, in ``located.toml``."""
        present = self.located()
        merged = present | {entry.name: entry for entry in entries}
        if not self.frozen and merged != present:
            ordered = [merged[name] for name in sorted(merged)]
            catalog.save(self.root / LOCATED, ordered, comment=_COMMENT)

    def zip_path(self, url: str) -> Path:
        """Where a zip that had to be downloaded whole is kept until its files are brought."""
        return self._beside(url, "zip")

    def drop_zips(self) -> None:
        """Remove zips that were downloaded whole, and parts of them; everything wanted is on disk."""
        for path in [*self.folder.glob("*.zip"), *self.folder.glob("*.part")]:
            path.unlink()

    def _beside(self, url: str, suffix: str) -> Path:
        return self.folder / f"{PurePosixPath(url).stem}.{zlib.crc32(url.encode()):08x}.{suffix}"


def crc32_file(path: Path) -> int:
    """CRC32 of a file's bytes."""
    crc = 0
    try:
        with open(path, "rb") as stream:
            while block := stream.read(1 << 20):
                crc = zlib.crc32(block, crc)
    except OSError as error:
        raise InputFileError(f"{path}: {error.strerror or error}") from None
    return crc


def holds(path: Path, size: int, crc32: int) -> bool:
    """Whether a file is there with this size and CRC32."""
    try:
        return path.stat().st_size == size and crc32_file(path) == crc32
    except OSError:
        return False
