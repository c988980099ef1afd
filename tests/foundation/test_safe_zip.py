from __future__ import annotations

import io
import stat
import struct
import warnings
import zipfile

import pytest

from kt3dmoseg.errors import FileFormatError, InputFileError
from kt3dmoseg.files import SafeZip, ZipLimits, zip_bytes

LIMITS = ZipLimits(files=5, file_bytes=3 << 20, total_bytes=6 << 20, ratio=200, free_bytes=1 << 20, depth=3)


def codes(content, **options):
    faults = []
    with SafeZip(content, LIMITS, "x.zip", faults=faults, **options) as archive:
        return [(fault.code, fault.file) for fault in faults], list(archive.sizes)


def entry(content, name, attributes=0):
    """Add a file to a zip; names are kept as they are."""
    buffer = io.BytesIO(content)
    info = zipfile.ZipInfo("placeholder")
    info.filename, info.external_attr = name, attributes
    with warnings.catch_warnings(), zipfile.ZipFile(buffer, "a", zipfile.ZIP_DEFLATED) as archive:
        warnings.simplefilter("ignore", UserWarning)  # a duplicate name
        archive.writestr(info, b"bad")
    return buffer.getvalue()


GOOD = zip_bytes({"b.txt": b"two", "a/a.txt": b"one"})


def test_a_good_archive_gives_names_sizes_and_contents(tmp_path):
    (tmp_path / "x.zip").write_bytes(GOOD)
    for source in (GOOD, tmp_path / "x.zip"):
        with SafeZip(source, LIMITS, "x.zip") as archive:
            assert archive.sizes == {"a/a.txt": 3, "b.txt": 3}
            assert list(archive.sizes) == ["a/a.txt", "b.txt"]
            assert archive.read("a/a.txt") == b"one"
            with archive.open("b.txt") as stream:
                assert stream.read(2) == b"tw"


def test_folders_of_windows_are_folders():
    with SafeZip(entry(GOOD, "c\\d\\x.txt"), LIMITS, "x.zip") as archive:
        assert list(archive.sizes) == ["a/a.txt", "b.txt", "c/d/x.txt"]
        assert archive.read("c/d/x.txt") == b"bad"


@pytest.mark.parametrize(
    "name",
    [
        "",
        "\\abs",
        "C:\\evil",
        "../evil",
        "/abs",
        "a/../../evil",
        "C:/evil",
        "a\\..\\evil",
        "a\nb",
        "nul\0l",
        "1/2/3/4",
        ".",
    ],
)
def test_a_path_that_leads_out_is_refused(name):
    content = entry(GOOD, name)
    found, names = codes(content)
    assert [code for code, _ in found] == ["unsafe-path"]
    assert names == ["a/a.txt", "b.txt"]
    with pytest.raises(FileFormatError, match=r"^x\.zip: .*path inside the archive"):
        SafeZip(content, LIMITS, "x.zip")


def test_links_duplicates_encrypted_files_and_other_methods_are_refused():
    link = entry(GOOD, "link", (stat.S_IFLNK | 0o777) << 16)
    assert codes(link) == ([("symlink", "link")], ["a/a.txt", "b.txt"])
    assert codes(entry(GOOD, "./b.txt"))[0] == [("duplicate-name", "b.txt")]
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("packed", bytes(100))
    assert codes(buffer.getvalue()) == ([("unreadable", "packed")], [])
    locked = bytearray(GOOD)
    locked[locked.find(b"PK\x01\x02") + 8] |= 1
    assert codes(bytes(locked)) == ([("encrypted", "b.txt")], ["a/a.txt"])


def test_a_bomb_is_refused_by_what_it_claims():
    assert codes(zip_bytes({"bomb": bytes(2 << 20)}))[0] == [("too-large", "bomb")]
    content = b"".join(struct.pack("<I", k * 2654435761 % 2**32) for k in range(1 << 20))
    assert codes(zip_bytes({"long": content}))[0] == [("too-large", "long")]
    assert codes(zip_bytes({str(k): content[: 5 << 19] for k in range(3)}))[0] == [("too-large", "")]
    assert codes(zip_bytes({str(k): b"" for k in range(6)}))[0] == [("too-large", "")]


def test_an_archive_larger_than_all_that_may_be_in_it_is_not_opened(tmp_path):
    (tmp_path / "x.zip").write_bytes(bytes((6 << 20) + 1) + GOOD)
    assert codes(tmp_path / "x.zip") == ([("too-large", "")], [])


def test_a_packed_size_beyond_the_archive_earns_no_larger_limit():
    content = bytearray(zip_bytes({"bomb": bytes(2 << 20)}))
    at = content.rfind(b"PK\x01\x02")
    content[at + 20 : at + 24] = struct.pack("<I", 1 << 28)
    assert codes(bytes(content))[0] == [("too-large", "bomb")]


def test_a_wrong_size_shows_when_the_file_is_read():
    for claimed in (2, 4):
        content = bytearray(GOOD)
        at = content.rfind(b"PK\x01\x02")
        content[at + 24 : at + 28] = struct.pack("<I", claimed)
        with SafeZip(bytes(content), LIMITS, "x.zip") as archive:
            assert archive.read("b.txt") == b"two"
            with pytest.raises(FileFormatError, match=r"^x\.zip: a/a\.txt: expected"):
                archive.read("a/a.txt")


def test_damaged_content_is_one_line():
    content = bytearray(GOOD)
    content[33] ^= 255
    with pytest.raises(FileFormatError, match=r"^x\.zip: b\.txt: expected an intact file") as caught:
        SafeZip(bytes(content), LIMITS, "x.zip").read("b.txt")
    assert "\n" not in str(caught.value)


def test_what_is_no_zip_is_refused(tmp_path):
    for content in (b"", b"\x1f\x8b nothing", GOOD[:-10]):
        assert codes(content) == ([("not-a-zip", "")], [])
        with pytest.raises(FileFormatError, match=r"x\.zip: expected a zip archive"):
            SafeZip(content, LIMITS, "x.zip")
    with pytest.raises(InputFileError, match="No such file"):
        SafeZip(tmp_path / "none.zip", LIMITS, "none.zip")


def test_files_that_are_not_wanted_are_passed_over_unchecked():
    content = entry(zip_bytes({"a.txt": b"one", "bomb": bytes(2 << 20)}), "../evil")
    assert codes(content, wanted=lambda name: name.endswith(".txt")) == ([], ["a.txt"])
