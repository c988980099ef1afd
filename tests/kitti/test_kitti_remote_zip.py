"""Zip archives: what is read, and what hostile ones are refused for."""

from __future__ import annotations

import io
import stat
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from kitti_world import World

from kt3dmoseg.errors import FileFormatError, KT3DMoSegError
from kt3dmoseg.kitti.archives import Archive, DamagedError

CONTENT = {"a/one.txt": b"first " * 100, "a/two.txt": b"second", "b.bin": bytes(range(256)) * 300}


def pack(files: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED, comment: bytes = b"") -> bytes:
    buffer = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(buffer, "w", method) as archive:
        warnings.simplefilter("ignore")
        for name, content in files.items():
            archive.writestr(name, content)
        archive.comment = comment
    return buffer.getvalue()


def opened(tmp_path: Path, content: bytes) -> Archive:
    path = tmp_path / "test.zip"
    path.write_bytes(content)
    return Archive.on_disk(path)


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
@pytest.mark.parametrize("comment", [b"", b"note " * 1000])
def test_reads_files_in_any_order(tmp_path: Path, method: int, comment: bytes) -> None:
    content = pack(CONTENT, method, comment)
    archive = opened(tmp_path, content)
    assert dict(archive.read(["b.bin", "a/one.txt"])) == {
        name: CONTENT[name] for name in ("a/one.txt", "b.bin")
    }
    size, tail = archive.directory
    again = Archive("again", size, lambda start, length: iter([content[start : start + length]]), tail)
    assert dict(again.read(CONTENT)) == CONTENT


def test_bytes_before_the_archive_do_no_harm(tmp_path: Path) -> None:
    archive = opened(tmp_path, b"#!/bin/sh\n" * 50 + pack(CONTENT))
    assert dict(archive.read(CONTENT)) == CONTENT


def _entry(name: str, attributes: int = 0) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        info = zipfile.ZipInfo(name)
        info.external_attr = attributes << 16
        archive.writestr(info, b"content")
    return buffer.getvalue()


def _renamed(old: bytes, new: bytes) -> bytes:
    return pack({"safe/name.txt": b"x", old.decode(): b"y"}).replace(old, new)


def _edited(offset: int, form: str, value: int, which: bytes = b"PK\x01\x02") -> bytes:
    """Change one field of the first record of a kind."""
    content = bytearray(pack(CONTENT))
    struct.pack_into(form, content, content.index(which) + offset, value)
    return bytes(content)


def _duplicate() -> bytes:
    return _renamed(b"safe/nam2.txt", b"safe/name.txt")


def _overlap() -> bytes:
    content = bytearray(pack({"a": b"x" * 50, "b": b"y" * 50}, zipfile.ZIP_STORED))
    second = content.rindex(b"PK\x01\x02")
    struct.pack_into("<L", content, second + 42, 0)
    return bytes(content)


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda: _entry("/etc/passwd"), "absolute path"),
        (lambda: _renamed(b"c_windows.txt", b"C:windows.txt"), "absolute path"),
        (lambda: _renamed(b"x_up_name.txt", b"..\\..\\ame.txt"), "absolute path"),
        (lambda: _entry("../outside.txt"), "path inside the archive"),
        (lambda: _entry("a/../../outside.txt"), "path inside the archive"),
        (lambda: _entry("link", stat.S_IFLNK | 0o777), "symbolic link"),
        (_duplicate, "twice"),
        (_overlap, "overlaps|twice"),
        (lambda: _edited(24, "<L", 0x7FFFFFFF), "packed at most 1100 to 1, found 2147483647 bytes"),
        (lambda: _edited(20, "<L", 0x00FFFFFF), "overlaps"),
        (lambda: pack(CONTENT)[:-40], "expected a zip archive"),
        (lambda: pack(CONTENT)[:100], "expected a zip archive"),
        (lambda: b"", "expected a zip archive"),
        (lambda: b"no zip at all" * 100, "expected a zip archive"),
        (lambda: _edited(12, "<L", 0x7FFFFFFF, b"PK\x05\x06"), "expected a zip archive|directory"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_hostile_archives_are_refused(tmp_path: Path, make: Callable[[], bytes], reason: str) -> None:
    with pytest.raises(FileFormatError, match=reason):
        opened(tmp_path, make())


@pytest.mark.parametrize(
    ("offset", "form", "value"),
    [(16, "<L", 12345), (10, "<H", 0), (24, "<L", 599), (24, "<L", 601)],
    ids=["checksum", "method", "smaller", "larger"],
)
def test_wrong_claims_of_the_directory_are_noticed_when_the_file_is_read(
    tmp_path: Path, offset: int, form: str, value: int
) -> None:
    with pytest.raises(FileFormatError):
        dict(opened(tmp_path, _edited(offset, form, value)).read(["a/one.txt"]))


def test_bomb_is_not_unpacked_further_than_its_claim(tmp_path: Path) -> None:
    bomb = pack({"a/one.txt": bytes(50 << 20)})
    content = bytearray(bomb)
    struct.pack_into("<L", content, content.index(b"PK\x01\x02") + 24, 1000)
    with pytest.raises(DamagedError, match="expected 1000 bytes"):
        dict(opened(tmp_path, bytes(content)).read(["a/one.txt"]))


def test_enormous_file_is_refused_before_it_is_asked_for(tmp_path: Path) -> None:
    archive = opened(tmp_path, pack({"a": bytes(65 << 20), "b": b"fine"}))
    with pytest.raises(FileFormatError, match="unpacks to 68157440 bytes"):
        next(archive.read(["a"]))
    assert dict(archive.read(["b"])) == {"b": b"fine"}


def test_encrypted_and_oddly_packed_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="encrypted"):
        next(opened(tmp_path, _edited(8, "<H", 1)).read(["a/one.txt"]))
    with pytest.raises(FileFormatError, match="method 12"):
        next(opened(tmp_path, pack(CONTENT, zipfile.ZIP_BZIP2)).read(["a/one.txt"]))


def test_flipped_byte_of_a_file_is_found_by_its_checksum(tmp_path: Path) -> None:
    content = bytearray(pack(CONTENT, zipfile.ZIP_STORED))
    content[content.index(b"second")] ^= 1
    archive = opened(tmp_path, bytes(content))
    with pytest.raises(DamagedError, match=f"CRC {zlib.crc32(b'second'):08x}"):
        dict(archive.read(["a/two.txt"]))
    assert dict(archive.read(["b.bin"]))


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_damage_gives_right_content_or_one_error(tmp_path: Path, data: st.DataObject) -> None:
    content = bytearray(pack(CONTENT))
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    try:
        archive = opened(tmp_path, bytes(content[: data.draw(st.integers(0, len(content)))]))
        for name, unpacked in archive.read([name for name in archive.sizes if name in CONTENT]):
            assert zlib.crc32(unpacked) == archive.crc32(name)
    except KT3DMoSegError as error:
        assert "\n" not in str(error)


def test_hostile_zip_on_a_server_writes_nothing(world: World) -> None:
    world.serve(world.files | {"../../outside.txt": b"x"})
    with pytest.raises(FileFormatError, match=r"\.\./\.\./outside\.txt: expected a path inside the archive"):
        world.pull()
    assert not list(world.root.rglob("*.png"))
    assert not list(world.folder.parent.rglob("outside.txt"))
