"""Whole zips that arrive damaged, files that change, slow headers, bodies of redirects, room on disk."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from kitti_world import CALIB, SYNC, World

from kt3dmoseg.errors import FileFormatError, InputFileError
from kt3dmoseg.kitti import Origin, archives, locate
from kt3dmoseg.kitti.http import ChangedError, Client, Traffic
from kt3dmoseg.kitti.releases import fetch_release


def spoil(world: World, name: str) -> bytes:
    """Flip a bit of a frame's packed bytes on the server; return what was there."""
    good = world.server.files[name]
    content = bytearray(good)
    content[content.index(b"PK\x01\x02") // 2] ^= 1
    world.server.files[name] = bytes(content)
    return good


def kept(world: World) -> list[str]:
    return sorted(path.suffix for path in (world.root / ".kt3dmoseg").iterdir() if "sync" in path.name)


@pytest.mark.parametrize("name", [SYNC, CALIB])
def test_a_whole_zip_that_arrives_damaged_is_dropped_and_fetched_again(world: World, name: str) -> None:
    world.server.ranges = False
    good, asked = spoil(world, name), []

    def heal(count: int, path: str) -> str:
        asked.append(path)
        if sum(name in path for path in asked) > 2:  # its size, and the first download
            world.server.files[name] = good
        return ""

    world.server.fault = heal
    assert world.pull().files == 18
    world.check()


def test_a_zip_that_always_arrives_damaged_fails_in_one_line_and_is_not_kept(world: World) -> None:
    world.server.ranges = False
    good = spoil(world, SYNC)
    for _ in range(2):
        with pytest.raises(FileFormatError, match="bytes with CRC"):
            world.pull()
        assert ".zip" not in kept(world)
        assert ".part" not in kept(world)
    world.server.files[SYNC] = good
    world.pull()
    world.check()


@pytest.mark.parametrize("part", [0.4, 0.9999])
def test_a_kept_zip_that_decayed_on_disk_is_fetched_again(world: World, part: float) -> None:
    world.server.ranges = False
    world.server.fault = lambda count, path: "500" if CALIB in path else ""  # so that the zip is kept
    with pytest.raises(InputFileError):
        world.pull(retries=0)
    world.server.fault = lambda count, path: ""
    url = f"{world.server.url}/{SYNC}"
    copy = archives.TargetFolder(world.root).path_for(url, "zip")
    content = bytearray(world.server.files[SYNC])
    content[int(part * len(content)) - 22 * (part > 0.9)] ^= 0x55
    copy.write_bytes(content)
    for path in world.root.rglob("*.png"):
        path.unlink()
    world.pull()
    world.check()


def test_locate_fetches_a_damaged_zip_again(world: World) -> None:
    world.server.ranges = False
    good, lines = spoil(world, SYNC), []

    def heal(count: int, path: str) -> str:
        if count > 2:
            world.server.files[SYNC] = good
        return ""

    world.server.fault = heal
    options = {"mirror": world.server.url, "wait": 0.0, "catalogs": [world.catalog], "report": lines.append}
    assert locate(world.root, ["Hidden"], **options)["Hidden"].numbers == tuple(range(11, 17))
    assert any("fetching it again" in line for line in lines)


def test_bodies_of_redirects_are_not_read(world: World) -> None:
    world.server.fault = lambda count, path: "fat redirect" if "_sync" in path else ""
    world.pull()
    world.check()
    assert world.traffic.bytes < 2 * sum(map(len, world.server.files.values()))


def test_redirects_of_releases_are_followed_without_their_bodies(world: World, tmp_path: Path) -> None:
    world.server.fault = lambda count, path: "fat redirect"
    with pytest.raises(InputFileError, match="404 Not Found; by hand"):
        fetch_release(tmp_path, mirror=world.server.url, retries=0, report=len)


def test_headers_that_trickle_are_given_up_after_the_time_out(world: World) -> None:
    asked: list[str] = []

    def first_of_each(count: int, path: str) -> str:
        asked.append(path)
        return "slow headers" if asked.count(path) == 2 else ""

    world.server.fault = first_of_each
    world.pull(timeout=1.0)
    world.check()
    world.server.fault = lambda count, path: "slow headers"
    world.frame(13).unlink()
    with pytest.raises(InputFileError, match="gave up after 3 attempts, the last: headers timed out"):
        world.pull(retries=2, timeout=0.1)


def test_a_file_that_changes_under_an_interrupted_download_is_fetched_from_its_beginning(
    world: World, tmp_path: Path
) -> None:
    old, url, path = world.server.files[SYNC], f"{world.server.url}/{SYNC}", tmp_path / "zip.part"
    new = old[::-1]
    world.server.versions[SYNC] = '"old"'

    def change(count: int, asked: str) -> str:
        if count == 2:
            world.server.files[SYNC], world.server.versions[SYNC] = new, '"new"'
        return "cut" if count == 1 else ""

    world.server.fault = change
    traffic = Traffic()
    client = Client(Origin(wait=0), traffic)
    client.download(url, path, "zip")
    assert path.read_bytes() == new
    client.close()


def test_a_range_of_a_file_that_changed_is_refused_though_its_size_is_the_same(world: World) -> None:
    url = f"{world.server.url}/{SYNC}"
    world.server.versions[SYNC] = '"old"'
    client = Client(Origin(wait=0))
    assert b"".join(client.chunks(url, 0, 10)) == world.server.files[SYNC][:10]
    world.server.files[SYNC] = world.server.files[SYNC][::-1]
    world.server.versions[SYNC] = '"new"'
    with pytest.raises(ChangedError, match='expected version "old" as before, found "new"'):
        list(client.chunks(url, 10, 10))
    assert client.size(url) == len(world.server.files[SYNC])
    assert b"".join(client.chunks(url, 10, 10)) == world.server.files[SYNC][10:20]
    client.close()


def free(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    usage = shutil.disk_usage("/")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=count))


def test_the_free_space_asked_for_is_what_is_needed(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    free(monkeypatch, 0)
    with pytest.raises(InputFileError, match=r"disk: expected ([\d.]+) MB free, found 0.0 MB") as caught:
        world.pull()
    asked = float(str(caught.value).split("expected ")[1].split()[0])
    free(monkeypatch, int((asked + 0.1) * 1e6))
    world.pull()
    world.check()


def test_room_for_a_whole_zip_is_checked_before_it_is_fetched(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    world.server.ranges = False
    size = len(world.server.files[SYNC])
    free(monkeypatch, (16 << 20) + size - 1)
    with pytest.raises(InputFileError, match="disk: expected"):
        world.pull()
    assert len(world.server.requests_for(SYNC)) == 1  # its size
    assert not list((world.root / ".kt3dmoseg").glob("*sync*.part"))
