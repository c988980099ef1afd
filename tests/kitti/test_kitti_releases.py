"""fetch-release: hashes, trust on first use, unpacking, and what is reported when a page is gone."""

from __future__ import annotations

import dataclasses
import hashlib
from pathlib import Path

import kitti_drives as drives
import pytest
from kitti_server import FaultyServer

from kt3dmoseg import cli
from kt3dmoseg.errors import FileFormatError, InputFileError, UnknownNameError
from kt3dmoseg.kitti import releases
from kt3dmoseg.kitti.releases import fetch_release

FILES = {f"S{k}_Tracks.mat": f"content {k}".encode() for k in range(3)}


@pytest.fixture
def small(server: FaultyServer, monkeypatch: pytest.MonkeyPatch) -> FaultyServer:
    """The release shrunk to three files, the first with a known checksum; MTPV62 without an address."""
    table = releases.releases()
    known = {"S0_Tracks.mat": hashlib.sha256(FILES["S0_Tracks.mat"]).hexdigest()}
    table = {name: dataclasses.replace(release, checksums={}) for name, release in table.items()}
    table["kt3dmoseg"] = dataclasses.replace(table["kt3dmoseg"], files=list(FILES), checksums=known)
    table["mtpv62"] = dataclasses.replace(table["mtpv62"], files=[], names=[])
    monkeypatch.setattr(releases, "releases", lambda: table)
    server.files |= {f"kt3dmoseg/{name}": content for name, content in FILES.items()}
    return server


def test_fetches_once_and_records_the_hashes_it_had_to_trust(small: FaultyServer, tmp_path: Path) -> None:
    lines: list[str] = []
    (paths,) = fetch_release(tmp_path, mirror=small.url, report=lines.append).values()
    assert {path.name: path.read_bytes() for path in paths} == FILES
    text = "\n".join(lines)
    assert text.count("trusted now") == 2
    assert "1 of them verified" in text
    for word in (
        "home: https://github.com/alex-xun-xu/MultiViewMoSeg",
        "CC BY-NC-SA 3.0",
        "if the page is gone",
    ):
        assert word in text
    small.reset()
    lines.clear()
    fetch_release(tmp_path, mirror=small.url, report=lines.append)
    assert small.requests == []
    assert "trusted now" not in "\n".join(lines)


def test_damaged_file_is_fetched_again_and_must_match_its_first_hash(
    small: FaultyServer, tmp_path: Path
) -> None:
    fetch_release(tmp_path, mirror=small.url, report=len)
    path = tmp_path / "kt3dmoseg/release/S1_Tracks.mat"
    path.write_bytes(b"damaged")
    fetch_release(tmp_path, mirror=small.url, report=len)
    assert path.read_bytes() == FILES["S1_Tracks.mat"]
    path.write_bytes(b"damaged")
    small.files["kt3dmoseg/S1_Tracks.mat"] = b"something else now"
    with pytest.raises(FileFormatError, match=r"S1_Tracks\.mat: expected SHA-256"):
        fetch_release(tmp_path, mirror=small.url, retries=0, report=len)


def test_wrong_content_of_a_known_file_is_refused(small: FaultyServer, tmp_path: Path) -> None:
    small.files["kt3dmoseg/S0_Tracks.mat"] = b"forged"
    with pytest.raises(FileFormatError, match=r"S0_Tracks\.mat: expected SHA-256"):
        fetch_release(tmp_path, mirror=small.url, retries=0, report=len)
    assert not list(tmp_path.rglob("*.mat"))


def test_page_that_is_gone_gives_what_to_do_by_hand(
    small: FaultyServer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    small.files.clear()
    with pytest.raises(InputFileError, match="answered 404 Not Found; by hand: git clone"):
        fetch_release(tmp_path, mirror=small.url, retries=0, report=len)
    assert cli.main(["fetch-release", "-o", str(tmp_path), "mtpv62"]) == 2
    captured = capsys.readouterr()
    assert "no address is known" in captured.err
    assert "ICCV 2013" in captured.out


def test_files_put_there_by_hand_are_checked(small: FaultyServer, tmp_path: Path) -> None:
    folder = tmp_path / "mtpv62"
    folder.mkdir()
    (folder / "MTPV_data_Boat_Tracks.mat").write_bytes(b"x")
    fetch_release(tmp_path, ["mtpv62"], report=len)
    (folder / "MTPV_data_Boat_Tracks.mat").write_bytes(b"y")
    with pytest.raises(FileFormatError, match="Boat"):
        fetch_release(tmp_path, ["mtpv62"], report=len)


def test_zip_is_unpacked_to_the_layout_of_the_readers(small: FaultyServer, tmp_path: Path) -> None:
    files = {"Hopkins155/cars1/cars1_truth.mat": b"1", "Hopkins155/cars1/cars1.avi": b"no"}
    files |= {"Hopkins155/cars2/cars2_truth.mat": b"2", "Hopkins155/cars2/other_truth.mat": b"no"}
    path = drives.write_zip(tmp_path / "h.zip", files)
    small.files["hopkins155/Hopkins155.zip"] = path.read_bytes()
    fetch_release(tmp_path, ["hopkins155"], mirror=small.url, report=len)
    found = {p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*.mat")}
    assert found == {"hopkins155/cars1/cars1_truth.mat", "hopkins155/cars2/cars2_truth.mat"}


@pytest.mark.parametrize("arrived", [False, True], ids=["on the way", "on the disk"])
def test_a_damaged_zip_is_fetched_again(small: FaultyServer, tmp_path: Path, arrived: bool) -> None:
    content = {"Hopkins155/cars1/cars1_truth.mat": bytes(range(256)) * 9}
    good = drives.write_zip(tmp_path / "h.zip", content).read_bytes()
    bad = good[:300] + bytes([good[300] ^ 0x55]) + good[301:]
    if arrived:
        (tmp_path / "hopkins155").mkdir()
        (tmp_path / "hopkins155/Hopkins155.zip").write_bytes(bad)

    def heal(count: int, path: str) -> str:
        small.files["hopkins155/Hopkins155.zip"] = good if arrived or count > 1 else bad
        return ""

    small.fault = heal
    (found,) = fetch_release(tmp_path, ["hopkins155"], mirror=small.url, report=len)["hopkins155"]
    assert found.read_bytes() == content["Hopkins155/cars1/cars1_truth.mat"]


@pytest.mark.parametrize("head", [{"Content-Length": "9" * 5000}, {"Transfer-Encoding": "chunked"}, {}])
def test_a_body_of_any_stated_or_unstated_length_ends(
    small: FaultyServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, head: dict[str, str]
) -> None:
    monkeypatch.setattr("kt3dmoseg.kitti.http._UNSTATED", 1 << 20)
    small.endless = head
    with pytest.raises(InputFileError, match="at most 1048576 bytes"):
        fetch_release(tmp_path, mirror=small.url, retries=0, report=len)
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_unknown_release_proposes_the_nearest(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'hopkins155'"):
        fetch_release(tmp_path, ["hopkins15"])


def test_every_release_has_address_licence_and_what_to_do_by_hand() -> None:
    for release in releases.releases().values():
        assert release.home.startswith("http")
        assert release.licence
        assert release.cite
        assert release.by_hand
        assert release.files
        assert all(url.startswith("http") for url in release.downloads().values())


@pytest.mark.data
def test_known_checksums_are_those_of_the_real_files(data_root: Path, tmp_path: Path) -> None:
    counts = {"kt3dmoseg": 14, "hopkins155": 100, "hopkins12": 8, "mtpv62": 7}
    for name, release in releases.releases().items():
        known = release.checksums
        assert len(known) == counts[name]
        path, checksum = next(iter(known.items()))
        content = (data_root / release.folder / path).read_bytes()
        assert hashlib.sha256(content).hexdigest() == checksum
        assert release.name != "kt3dmoseg" or set(known) <= set(release.files)
