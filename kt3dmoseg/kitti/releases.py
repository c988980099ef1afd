"""The published benchmarks, fetched from their homes: small files with hashes, through pooch."""

from __future__ import annotations

import os
import re
import sys
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from kt3dmoseg.errors import FileFormatError, InputFileError, MissingDependencyError
from kt3dmoseg.files import read_bytes, sha256_file, write_bytes, write_text
from kt3dmoseg.kitti.remote_zip import Archive
from kt3dmoseg.registry import unknown_name

_HERE = Path(__file__).parent
_SUMS = "SHA256SUMS"


@dataclass(frozen=True)
class Release:
    """A published benchmark: where it is, what may be done with it, what to do when it is gone."""

    name: str
    title: str
    home: str
    licence: str
    cite: str
    folder: str
    base: str
    files: tuple[str, ...]
    by_hand: str
    names: tuple[str, ...] = ()
    members: str = ""
    target: str = ""

    def downloads(self) -> dict[str, str]:
        """Addresses by the name that the file gets."""
        return {
            name: self.base + file for name, file in zip(self.names or self.files, self.files, strict=True)
        }


def releases() -> dict[str, Release]:
    """All releases by name."""
    tables = tomllib.loads((_HERE / "releases.toml").read_text())
    made = {}
    for name, table in tables.items():
        lists = {key: tuple(value) for key, value in table.items() if isinstance(value, list)}
        made[name] = Release(name=name, **(table | lists))
    return made


def known_digests(name: str) -> dict[str, str]:
    """SHA-256 of the files of a release that this project has seen, by path below its folder."""
    table = tomllib.loads((_HERE / "release_digests.toml").read_text())
    return {str(path): str(digest) for path, digest in table.get(name, {}).items()}


def fetch_release(
    root: str | os.PathLike[str],
    names: Iterable[str] = ("kt3dmoseg",),
    *,
    mirror: str | None = None,
    retries: int = 2,
    say: Callable[[str], object] = print,
) -> dict[str, list[Path]]:
    """Fetch published benchmarks into ``ROOT``, in the layout that the readers know.

    Files that are there and match are not fetched again. A file whose hash nobody told us is trusted on
    first download; its hash is kept in ``SHA256SUMS`` beside it and demanded from then on.

    Parameters
    ----------
    root : path
        Folder that gets ``kt3dmoseg/release``, ``hopkins155``, ``hopkins12``, ``mtpv62``.
    names : iterable of str
        Which releases.
    mirror : str, optional
        Address of a folder that has the same files, one sub-folder per release.
    retries : int
        How often a failed download is repeated.
    say : callable
        Takes the lines of the report.

    Returns
    -------
    dict of str to list of path
        The benchmark's files, by release.

    Raises
    ------
    InputFileError
        When a page is gone; the message says what to do by hand.
    FileFormatError
        When a file has not the hash that it must have.
    """
    table = releases()
    fetched = {}
    for name in names:
        if name not in table:
            raise unknown_name("release", name, table)
        release = table[name]
        folder = Path(root) / release.folder
        say(f"{release.title}\n  home: {release.home}\n  licence: {release.licence}\n  cite: {release.cite}")
        say(f"  if the page is gone: {release.by_hand} ({folder})")
        fetched[name] = _fetch(release, folder, mirror, retries, say)
    return fetched


def _fetch(
    release: Release, folder: Path, mirror: str | None, retries: int, say: Callable[[str], object]
) -> list[Path]:
    known, kept = known_digests(release.name), _read_sums(folder)
    expected = kept | known
    for name, url in release.downloads().items():
        address = f"{mirror.rstrip('/')}/{release.name}/{name}" if mirror else url
        digest = expected.get(name)
        if not _right(folder / name, digest):
            _download(address, folder / name, digest, release, retries)
        if digest is None:
            expected[name] = sha256_file(folder / name)
            say(f"  {name}: no published hash; trusted now, SHA-256 {expected[name]} from now on")
        if release.members:
            _unpack(release, folder / name, folder, expected)
    return _check(release, folder, expected, known, say)


def _right(path: Path, digest: str | None) -> bool:
    return path.is_file() and digest in (None, sha256_file(path))


def _download(url: str, path: Path, digest: str | None, release: Release, retries: int) -> None:
    try:
        import pooch
        import requests
    except ImportError:
        raise MissingDependencyError(
            "downloads need the package pooch", fix="pip install 'kt3dmoseg[pull]'"
        ) from None
    pooch.get_logger().setLevel("ERROR")
    loader = pooch.HTTPDownloader(timeout=60, progressbar=sys.stderr.isatty())
    known = f"sha256:{digest}" if digest else None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        files = pooch.create(
            path.parent, "", registry={path.name: known}, urls={path.name: url}, retry_if_failed=retries
        )
        files.fetch(path.name, downloader=loader)
    except (requests.exceptions.RequestException, OSError) as error:
        status = getattr(getattr(error, "response", None), "status_code", None)
        found = f"status {status}" if status else type(error).__name__
        raise InputFileError(
            f"{url}: cannot be fetched", found=found, fix=f"by hand: {release.by_hand}"
        ) from None
    except ValueError:
        raise FileFormatError(url, expected=f"SHA-256 {digest}", found="other content") from None


def _unpack(release: Release, path: Path, folder: Path, expected: Mapping[str, str]) -> None:
    """Unpack the wanted members that are not there, or not right, under names of our own making."""
    archive = Archive.on_disk(path)
    matches = {name: match for name in archive.names() if (match := re.fullmatch(release.members, name))}
    targets = {name: match.expand(release.target) for name, match in matches.items()}
    missing = [name for name, target in targets.items() if not _right(folder / target, expected.get(target))]
    for name, content in archive.read(missing):
        write_bytes(folder / targets[name], content)


def _check(
    release: Release,
    folder: Path,
    expected: Mapping[str, str],
    known: Mapping[str, str],
    say: Callable[[str], object],
) -> list[Path]:
    """Compare every file with the hash that is expected of it, and keep the hashes."""
    paths = sorted(folder.rglob("*.mat")) if folder.is_dir() else []
    if not paths:
        raise InputFileError(f"{folder}: no files, and no address is known", fix=release.by_hand)
    found = {path.relative_to(folder).as_posix(): sha256_file(path) for path in paths}
    for name, digest in found.items():
        if digest != expected.get(name, digest):
            raise FileFormatError(
                f"{folder / name}",
                expected=f"SHA-256 {expected[name]}",
                found=digest,
                fix="remove it and fetch it again",
            )
    _write_sums(folder, {**expected, **found})
    proved = sum(name in known for name in found)
    say(f"  {len(found)} files in {folder}; {proved} of them proved by a digest that this project knows")
    return paths


def _read_sums(folder: Path) -> dict[str, str]:
    path = folder / _SUMS
    if not path.is_file():
        return {}
    lines = [line.split("  ", 1) for line in read_bytes(path, 1 << 20).decode(errors="replace").splitlines()]
    return {parts[1]: parts[0] for parts in lines if len(parts) == 2}


def _write_sums(folder: Path, sums: Mapping[str, str]) -> None:
    here = {name: digest for name, digest in sorted(sums.items()) if (folder / name).is_file()}
    if _read_sums(folder) != here:
        write_text(folder / _SUMS, "".join(f"{digest}  {name}\n" for name, digest in here.items()))
