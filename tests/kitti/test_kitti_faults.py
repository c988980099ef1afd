"""Every fault of the network, from a local server: complete and verified, or one line."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import kitti_drives as drives
import pytest
from kitti_world import CALIB, HIDDEN, SYNC, World, faults

from kt3dmoseg.errors import FileFormatError, InputFileError, KT3DMoSegError
from kt3dmoseg.kitti import Origin
from kt3dmoseg.kitti.http import Client, Traffic

SHORT = {"timeout": 0.6}


@pytest.mark.parametrize(
    "kinds",
    [
        *[["drop"], ["500"], ["503"], ["cut"], ["short"], ["shifted"], ["long"], ["redirect"], ["flip"]],
        ["drop", "500", "503", "cut", "short", "long", "redirect"],
    ],
    ids="-".join,
)
def test_three_requests_in_ten_failing_is_survived(world: World, kinds: list[str]) -> None:
    world.server.fault = faults(0.3, kinds, seed=len(kinds))
    assert world.pull().files == 18
    world.check()


def test_failing_requests_cost_little(world: World) -> None:
    world.pull()
    clean, world.server.sent = world.server.sent, 0
    for path in sorted(world.root.rglob("*"), reverse=True):
        path.unlink() if path.is_file() else path.rmdir()
    world.server.fault = faults(0.3, ["drop", "500", "503", "cut"], seed=3)
    world.pull()
    world.check()
    assert world.server.sent <= 1.6 * clean


@pytest.mark.parametrize("kind", ["stall", "trickle"])
def test_stalled_and_trickling_bodies_are_given_up_and_resumed(world: World, kind: str) -> None:
    asked: list[str] = []

    def first_of_each(count: int, path: str) -> str:
        asked.append(path)
        return kind if asked.count(path) == 3 else ""

    world.server.fault = first_of_each
    world.pull(**SHORT)
    world.check()


@pytest.mark.parametrize(
    ("kind", "after"),
    [("drop", 0), ("drop", 1), ("drop", 6), ("500", 4), ("cut", 4), ("stall", 4), ("shifted", 4)],
)
def test_server_that_never_recovers_is_one_line_after_bounded_requests(
    world: World, kind: str, after: int
) -> None:
    world.server.fault = lambda count, path: kind if count > after else ""
    with pytest.raises(InputFileError, match="gave up after 4 attempts") as caught:
        world.pull(retries=3, timeout=0.1)
    assert "\n" not in str(caught.value)
    assert len(world.server.requests) <= 40
    world.server.fault = lambda count, path: ""
    world.pull()
    world.check()


def test_file_that_stays_damaged_never_takes_its_name(world: World) -> None:
    world.server.fault = lambda count, path: "flip" if "_sync" in path and count > 4 else ""
    with pytest.raises(KT3DMoSegError, match=r"\.png|_sync\.zip"):
        world.pull()
    for path in world.root.rglob("*.png"):
        assert path.read_bytes() == world.files[path.relative_to(world.root).as_posix()]
    world.server.fault = lambda count, path: ""
    world.pull()
    world.check()


@pytest.mark.parametrize("seed", range(4))
def test_flipped_bytes_in_the_directory_are_noticed(world: World, seed: int) -> None:
    directory = world.server.files[SYNC].rindex(b"PK\x01\x02")
    content = bytearray(world.server.files[SYNC])
    # The name, the checksum or the offset of a wanted frame in the directory.
    name = f"{HIDDEN[seed]:010d}.png".encode()
    at = content.rindex(name, 0, directory)
    content[at + (0, -70, 5, -57)[seed]] ^= 1
    world.server.files["bad"] = bytes(content)
    good = world.server.files[SYNC]
    world.server.files[SYNC] = bytes(content)

    def heal(count: int, path: str) -> str:
        if count == 3:
            world.server.files[SYNC] = good
        return ""

    world.server.fault = heal
    world.pull()
    world.check()


def test_redirects_in_a_circle_are_one_line(world: World) -> None:
    world.server.fault = lambda count, path: "loop"
    with pytest.raises(InputFileError, match="redirected more than 5 times"):
        world.pull()


def test_server_that_ignores_ranges_gives_the_whole_zip_once(world: World) -> None:
    world.server.ranges = False
    world.pull()
    world.check()
    assert "whole files only" in "\n".join(world.lines)
    assert not list(world.root.rglob("*.zip"))
    world.server.reset()
    assert world.pull().fetched == 0
    assert world.server.requests == []


def test_whole_zip_resumes_where_it_stopped(world: World) -> None:
    size = len(world.server.files[SYNC])
    world.server.ranges = False
    world.server.fault = lambda count, path: "cut" if "_sync" in path else ""
    with pytest.raises(InputFileError, match="gave up"):
        world.pull(retries=2)
    (part,) = (world.root / ".kt3dmoseg").glob("*_sync.*.part")
    assert part.read_bytes() == world.server.files[SYNC][: part.stat().st_size]
    assert part.stat().st_size >= size // 2
    # Now the server answers ranges: only the rest is sent, and less when the directory is enough.
    world.server.ranges, world.server.fault = True, lambda count, path: ""
    world.pull()
    world.check()


def test_download_appends_what_is_missing_and_passes_over_what_is_there(world: World, tmp_path: Path) -> None:
    content, url, path = world.server.files[SYNC], f"{world.server.url}/{SYNC}", tmp_path / "zip.part"
    path.write_bytes(content[:1000])
    traffic = Traffic()
    client = Client(Origin(wait=0), traffic)
    client.download(url, path, "zip")
    assert path.read_bytes() == content
    assert traffic.bytes == len(content) - 1000
    world.server.ranges = False
    path.write_bytes(content[:1000])
    client.download(url, path, "zip")
    client.close()
    assert path.read_bytes() == content


@pytest.mark.parametrize("keep", [0.3, 0.999])
def test_truncated_zip_is_one_line(world: World, keep: float) -> None:
    content = world.server.files[SYNC]
    world.server.files[SYNC] = content[: int(len(content) * keep)]
    with pytest.raises(FileFormatError, match="expected a zip archive"):
        world.pull()


def test_zip_that_changed_since_the_last_pull_is_read_again(world: World) -> None:
    world.pull()
    world.frame(13).unlink()
    world.serve({"readme.txt": b"moved everything" * 100} | world.files)
    assert world.pull().fetched == 1
    world.check()


def test_zip64_is_read(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zipfile, "ZIP64_LIMIT", 1000)
    monkeypatch.setattr(zipfile, "ZIP_FILECOUNT_LIMIT", 10)
    world.serve()
    assert b"PK\x06\x06" in world.server.files[SYNC]
    monkeypatch.undo()
    world.pull()
    world.check()


def test_full_disk_during_the_pull_is_one_line_and_leaves_no_half_file(world: World) -> None:
    # The largest file that the process may write is smaller than a frame.
    code = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000));"
    run = subprocess.run(command(world, before=code), capture_output=True, text=True, check=False)
    assert run.returncode == 2, run.stderr
    assert "cannot write" in run.stderr
    assert run.stderr.strip().count("\n") == 0
    assert not list(world.root.rglob("*.png"))
    world.pull()
    world.check()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_interrupted_pull_keeps_what_it_has_and_continues(world: World, number: signal.Signals) -> None:
    # The fourth request for the zip (first byte, directory, timestamps, frames) stops half-way.
    def stall(count: int, path: str) -> str:
        return "stall" if "_sync" in path and len(world.server.requests_for("_sync")) == 4 else ""

    world.server.fault = stall
    process = subprocess.Popen(command(world), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    _wait(lambda: bool(list(world.root.rglob("*.png"))))
    process.send_signal(number)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == (130 if number == signal.SIGINT else -number)
    if number == signal.SIGINT:
        assert errors.strip().splitlines()[-1] == "kt3dmoseg: interrupted; what was finished is kept"
    kept = {path: path.stat().st_mtime_ns for path in _brought(world)}
    for path in world.root.rglob("*.png"):
        assert path.read_bytes() == world.files[path.relative_to(world.root).as_posix()]
    world.server.fault = lambda count, path: ""
    (world.frame(11).parent / ".0000000012.png.abcd.part").write_bytes(b"left over by a kill")
    world.server.reset()
    report = world.pull()
    world.check()
    assert report.fetched == 18 - len(kept)
    assert kept.items() <= {path: path.stat().st_mtime_ns for path in _brought(world)}.items()
    assert not [r for r in world.server.requests_for(SYNC) if r[1] == "bytes=0-0"]  # the directory was kept


def test_two_pulls_at_once_fetch_nothing_twice(world: World) -> None:
    world.pull(accept_license=True, dry_run=True)
    world.server.reset()
    processes = [
        subprocess.Popen(command(world), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    outputs = [process.communicate(timeout=60) for process in processes]
    assert [process.returncode for process in processes] == [0, 0], outputs
    world.check()
    assert sorted(out.count("fetched 0,") for out, _ in outputs) == [0, 1]
    asked = world.server.requests_for(SYNC)
    assert len(asked) == len(set(asked))
    assert len(world.server.requests_for(CALIB)) == 2


def test_memory_stays_small(world: World) -> None:
    big = {f"{drives.DATE}/{drives.NAME}_sync/x/{k}.bin": os.urandom(1 << 20) for k in range(40)}
    world.serve(big | world.files)
    code = "import atexit; atexit.register(lambda: print(open('/proc/self/status').read()));"
    run = subprocess.run(command(world, before=code), capture_output=True, text=True, check=True)
    peak = re.search(r"VmHWM:\s+(\d+) kB", run.stdout)
    assert peak is not None
    assert int(peak[1]) < 200_000


def command(world: World, before: str = "") -> list[str]:
    arguments = ["pull", "Hidden", "-o", str(world.root), "--catalog", str(world.catalog), "--accept-license"]
    arguments += ["--mirror", world.server.url, "--wait", "0"]
    code = f"{before}import sys; from kt3dmoseg import cli; sys.exit(cli.main({arguments!r}))"
    return [sys.executable, "-c", code]


def _brought(world: World) -> list[Path]:
    folder = world.root / drives.DATE
    return [path for path in folder.rglob("*") if path.is_file() and path.suffix != ".part"]


def _wait(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < deadline, "nothing happened for 30 s"
        time.sleep(0.01)
