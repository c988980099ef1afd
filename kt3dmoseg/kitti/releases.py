"""The published benchmarks, fetched from their homes: small files with hashes."""

import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from kt3dmoseg.errors import FileFormatError, InputFileError
from kt3dmoseg.files import PathLike, atomic_path, read_bytes, sha256_file, write_bytes, write_text
from kt3dmoseg.kitti import Origin
from kt3dmoseg.kitti.archives import Archive
from kt3dmoseg.kitti.http import Client
from kt3dmoseg.registry import unknown_name

_SUMS = "SHA256SUMS"


@dataclass(frozen=True)
class Release:
    """A published benchmark: where it is, what may be done with it, what to do when it is gone.

    `wanted` matches the wanted files of a zip, `target` gives it its path; `checksums` are the SHA-256 of the
    files that this project has seen, by path below the folder.
    """

    name: str
    title: str
    home: str
    licence: str
    cite: str
    folder: str
    base: str
    files: list[str]
    by_hand: str
    names: list[str] = field(default_factory=list)
    wanted: str = ""
    target: str = ""
    checksums: dict[str, str] = field(default_factory=dict)

    def downloads(self, mirror: str | None = None) -> dict[str, str]:
        """Addresses, at home or in a mirror, by the name that the file gets."""
        addresses = dict(
            zip(self.names or self.files, [self.base + file for file in self.files], strict=True)
        )
        there = f"{(mirror or '').rstrip('/')}/{self.name}/"
        return {file: there + file for file in addresses} if mirror else addresses


def releases() -> dict[str, Release]:
    """All releases by name."""
    here = Path(__file__).parent
    tables, checksums = (
        tomllib.loads((here / file).read_text()) for file in ("releases.toml", "release_checksums.toml")
    )
    return {n: Release(n, **table, checksums=checksums.get(n, {})) for n, table in tables.items()}


def fetch_release(
    root: PathLike,
    names: Iterable[str] = ("kt3dmoseg",),
    *,
    mirror: str | None = None,
    retries: int = 2,
    report: Callable[[str], object] = print,
) -> dict[str, list[Path]]:
    """Fetch published benchmarks into ``ROOT``, in the layout that the readers expect.

    Files that are there and match are not fetched again. A file whose SHA-256 is not known is trusted on
    first download; it is kept in ``SHA256SUMS`` next to the file and demanded from then on.

    `root` gets ``kt3dmoseg/release``, ``hopkins155``, ``hopkins12``, ``mtpv62``, as the `names` say. `mirror`
    is the address of a folder that has the same files, one sub-folder per release; a failed download is
    repeated `retries` times; `report` takes lines. The benchmark's files are returned by release.
    InputFileError, with what to do by hand, when a page is gone; FileFormatError when a file has not the
    SHA-256 that it must have.
    """
    table = releases()
    fetched = {}
    for name in names:
        if name not in table:
            raise unknown_name("release", name, table)
        release = table[name]
        folder = Path(root) / release.folder
        report(f"{release.title}\n  home: {release.home}\n  licence: {release.licence}")
        report(f"  cite: {release.cite}\n  if the page is gone: {release.by_hand} ({folder})")
        expected = _read_sums(folder) | release.checksums
        with closing(Client(Origin(retries=retries, timeout=60))) as client:
            for file, url in release.downloads(mirror).items():
                if not _is_right(folder / file, expected.get(file), packed=bool(release.wanted)):
                    _download(client, url, folder / file, expected.get(file), release)
                if file not in expected:
                    expected[file] = sha256_file(folder / file)
                    report(f"  {file}: no published hash; trusted now, SHA-256 {expected[file]} from now on")
                if release.wanted:
                    _unpack(release, folder / file, folder, expected)
        fetched[name] = _check(release, folder, expected, report)
    return fetched


def _is_right(path: Path, checksum: str | None, *, packed: bool = False) -> bool:
    """Whether a file is there with this SHA-256; where that is not known, whether it is no damaged zip."""
    if not path.is_file() or checksum is not None:
        return path.is_file() and checksum == sha256_file(path)
    try:
        return not packed or bool(Archive.verified(path))
    except FileFormatError:
        return False


def _download(client: Client, url: str, path: Path, checksum: str | None, release: Release) -> None:
    """Download a file; what arrives damaged is fetched once more."""
    wanted = f"SHA-256 {checksum}" if checksum else "an intact zip"
    with atomic_path(path) as temporary:
        for _ in range(2):
            temporary.write_bytes(b"")
            try:
                client.download(url, temporary, path.name)
            except InputFileError as error:
                raise InputFileError(f"{error}", fix=f"by hand: {release.by_hand}") from None
            if _is_right(temporary, checksum, packed=bool(release.wanted)):
                return
        raise FileFormatError(url, expected=wanted, found="other content")


def _unpack(release: Release, path: Path, folder: Path, expected: Mapping[str, str]) -> None:
    """Unpack the wanted files that are not there, or not right, under fixed names."""
    archive = Archive.on_disk(path)
    matches = {name: match for name in archive.sizes if (match := re.fullmatch(release.wanted, name))}
    targets = {name: match.expand(release.target) for name, match in matches.items()}
    wanted = (name for name, to in targets.items() if not _is_right(folder / to, expected.get(to)))
    for name, content in archive.read(wanted):
        write_bytes(folder / targets[name], content)


def _check(
    release: Release, folder: Path, expected: Mapping[str, str], report: Callable[[str], object]
) -> list[Path]:
    """Compare every file with the SHA-256 that is expected of it, and keep the new ones."""
    found = {path.relative_to(folder).as_posix(): sha256_file(path) for path in sorted(folder.rglob("*.mat"))}
    if not found:
        raise InputFileError(f"{folder}: no files, and no address is known", fix=release.by_hand)
    for name, checksum in found.items():
        if checksum != expected.get(name, checksum):
            wanted, fix = f"SHA-256 {expected[name]}", "remove it and fetch it again"
            raise FileFormatError(f"{folder / name}", expected=wanted, found=checksum, fix=fix)
    sums = sorted((dict(expected) | found).items())
    here = {name: checksum for name, checksum in sums if (folder / name).is_file()}
    if _read_sums(folder) != here:
        write_text(folder / _SUMS, "".join(f"{checksum}  {name}\n" for name, checksum in here.items()))
    proved = sum(name in release.checksums for name in found)
    report(f"  {len(found)} files in {folder}; {proved} of them verified by a recorded SHA-256")
    return [folder / name for name in found]


def _read_sums(folder: Path) -> dict[str, str]:
    """Read what ``sha256sum`` would write: two blanks between checksum and name."""
    if not (folder / _SUMS).is_file():
        return {}
    lines = read_bytes(folder / _SUMS, 1 << 20).decode(errors="replace").splitlines()
    return {name: checksum for checksum, gap, name in (line.partition("  ") for line in lines) if gap}
