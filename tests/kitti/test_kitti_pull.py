"""Pulling clips from a local server: what comes, how much traffic it takes, and what it keeps."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import kitti_drives as drives
import pytest
from kitti_world import CALIB, HIDDEN, QUICK, SYNC, TRACKLETS, World

from kt3dmoseg import cli
from kt3dmoseg.errors import InputFileError, InvalidValueError, UnknownNameError
from kt3dmoseg.kitti import RawDrive, pull

FOLDER = f"{drives.DATE}/{drives.NAME}_sync"


def test_pulls_the_clip_in_kittis_layout_and_nothing_else(world: World) -> None:
    report = world.pull()
    world.check()
    drive = RawDrive(world.root, drives.DATE, 5)
    assert drive.numbers.tolist() == list(HIDDEN)
    assert drive.timestamps(HIDDEN).shape == drive.poses(HIDDEN).shape[:1] == (len(HIDDEN),)
    assert drive.T_cam_imu.shape == (4, 4)
    assert len(drive.tracklet_boxes(11)) == 1
    visible = [p for p in world.root.rglob("*") if p.is_file() and ".kt3dmoseg" not in p.parts]
    # 6 frames, 6 packets, 2 timestamps, 3 calibration files, tracklets; and located.toml
    assert len(visible) == 18 + 1
    assert report.files == report.fetched == 18
    assert "Hidden: frames 11-16, camera 0, by crc32" in "\n".join(world.lines)


def test_traffic_stays_within_its_targets(world: World) -> None:
    world.pull()
    files = len(HIDDEN) * 2 + 2
    assert len(world.server.requests_for(SYNC)) <= 2 * files
    frames = sum(world.frame(n).stat().st_size for n in HIDDEN)
    directory = 400_000
    assert world.server.sent <= 1.10 * frames + directory
    assert world.traffic.bytes == world.server.sent
    # The laser scans were not touched: all but the frames and small files is directory.
    assert world.server.sent < frames + 150_000


def test_one_connection_serves_all(world: World) -> None:
    world.pull()
    assert world.server.connections == 1


def test_second_pull_transfers_nothing(world: World) -> None:
    world.pull()
    world.server.reset()
    report = world.pull()
    assert (world.server.requests, world.server.sent) == ([], 0)
    assert (report.files, report.fetched, report.requests, report.transferred) == (18, 0, 0, 0)


def test_second_clip_of_the_drive_reads_no_directory_again(world: World) -> None:
    world.pull()
    with world.catalog.open("a") as stream:
        stream.write(
            f'\n[clips.Next]\ndate = "{drives.DATE}"\ndrive = 5\ncamera = 0\nlength = 4\nnumbers = "15-18"\n'
        )
    world.server.reset()
    assert world.pull("Hidden", "Next").fetched == 4  # frames 17, 18 and their packets
    assert len(world.server.requests) == 2


def test_without_names_all_clips_of_the_given_catalog_are_pulled_and_no_others(world: World) -> None:
    given = {"mirror": world.server.url, "catalogs": [world.catalog], "report": world.lines.append}
    assert pull(world.root, **given, **QUICK).fetched == 18
    world.check()


def test_damaged_and_lost_files_are_replaced_and_only_those(world: World) -> None:
    world.pull()
    content = bytearray(world.frame(12).read_bytes())
    content[100] ^= 1
    world.frame(12).write_bytes(content)
    world.frame(14).unlink()
    with pytest.raises(InputFileError, match="2 of 18 files are damaged or missing"):
        world.pull(verify=True)
    assert [line.rpartition(": ")[2] for line in world.lines[-2:]] == ["damaged", "missing"]
    assert world.pull().fetched == 2
    world.check()
    world.server.reset()
    assert world.pull(verify=True).files == 18
    assert world.server.requests == []


def test_verify_reports_a_clip_that_was_never_pulled(world: World) -> None:
    with pytest.raises(InputFileError, match="Hidden was not pulled"):
        world.pull(verify=True)
    with pytest.raises(InputFileError, match="nothing was pulled to this folder"):
        pull(world.root, verify=True)


def test_dry_run_prints_the_plan_and_writes_nothing(world: World) -> None:
    world.pull(dry_run=True, accept_license=False)
    assert not world.root.exists()
    text = "\n".join(world.lines)
    assert re.search(r"plan: 18 files to .*root, \d+\.\d MB to transfer", text)
    assert "CC BY-NC-SA 3.0" in text


def test_licence_is_asked_for_once(world: World) -> None:
    with pytest.raises(InvalidValueError, match="accept_license=True"):
        world.pull(accept_license=False)
    assert world.server.requests == []
    assert not list(world.root.rglob("*.png"))
    world.pull(accept_license=True)
    world.lines.clear()
    world.pull(accept_license=False)
    assert "CC BY-NC-SA" not in "\n".join(world.lines)


def test_absent_tracklets_are_normal_and_asked_for_once(world: World) -> None:
    del world.server.files[TRACKLETS]
    assert world.pull().files == 17
    assert not RawDrive(world.root, drives.DATE, 5).has_tracklets
    world.server.reset()
    world.pull()
    assert world.server.requests == []


def test_forbidden_tracklets_are_absent_ones(world: World) -> None:
    world.server.fault = lambda count, path: "403" if "tracklets" in path else ""
    assert world.pull().files == 17


def test_absent_calibration_is_reported_after_the_frames_came(world: World) -> None:
    del world.server.files[CALIB]
    with pytest.raises(InputFileError, match=r"calib\.zip"):
        world.pull()
    world.check()
    assert world.pull(calibration=False).fetched == 0


def test_absent_drive_is_one_line(world: World) -> None:
    del world.server.files[SYNC]
    with pytest.raises(InputFileError, match=r"_sync\.zip: the server answered 404"):
        world.pull()


def test_drive_without_packets_is_pulled_and_the_lack_is_reported(world: World) -> None:
    world.serve({name: c for name, c in world.files.items() if "/oxts/" not in name})
    report = world.pull()
    world.check()
    assert len(report.lacking) == 7
    assert "lacks 7" in world.lines[-1]
    world.server.reset()
    world.pull()
    assert world.server.requests == []


def test_clip_by_numbers_from_another_camera(world: World) -> None:
    frame = drives.encode(drives.picture(3))
    world.serve(world.files | {f"{FOLDER}/image_02/data/0000000003.png": frame})
    with world.catalog.open("a") as stream:
        stream.write(
            f'\n[clips.C]\ndate = "{drives.DATE}"\ndrive = 5\ncamera = 2\nlength = 1\nnumbers = "3"\n'
        )
    world.pull("C")
    assert (world.root / FOLDER / "image_02/data/0000000003.png").read_bytes() == frame


def test_numbers_outside_the_drive_name_what_is_there(world: World) -> None:
    with world.catalog.open("a") as stream:
        stream.write(
            f'\n[clips.C]\ndate = "{drives.DATE}"\ndrive = 5\ncamera = 0\nlength = 3\nnumbers = "28-30"\n'
        )
    with pytest.raises(ValueError, match="expected frames 30 of camera 0, found frames 0-29"):
        world.pull("C")


def test_one_clip_that_is_not_there_does_not_stop_the_others(world: World) -> None:
    text = world.catalog.read_text()
    other = text.replace("clips.Hidden", "clips.Other").replace('crc32 = "', 'crc32 = "').splitlines()
    other = [re.sub(r'crc32 = "......', 'crc32 = "000000', line) for line in other]
    world.catalog.write_text(text + "\n" + "\n".join(other) + "\n")
    with pytest.raises(LookupError, match="Other: no match"):
        world.pull("Hidden", "Other")
    world.check()


def test_unknown_clip_proposes_the_nearest(world: World) -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'Hidden'"):
        world.pull("hiden")


@pytest.mark.parametrize("mirror", ["ftp://example.invalid/x", "nowhere", ""])
def test_mirror_must_be_an_address(world: World, mirror: str) -> None:
    with pytest.raises(InvalidValueError, match="mirror"):
        world.pull(mirror=mirror)


def test_mirror_may_end_with_a_slash(world: World) -> None:
    world.pull(mirror=world.server.url + "/")
    world.check()


def _unpack(world: World, folder: Path) -> Path:
    drives.write_files(folder, world.files | drives.calibration_files())
    return folder


def _zips(world: World, folder: Path) -> Path:
    for name in (SYNC, CALIB, TRACKLETS):
        target = folder / Path(name).name
        target.parent.mkdir(exist_ok=True)
        target.write_bytes(world.server.files[name])
    return folder


@pytest.mark.parametrize("lay", [_unpack, _zips])
def test_local_copies_serve_as_well_without_any_request(world: World, tmp_path: Path, lay) -> None:
    world.pull(local=str(lay(world, tmp_path / "here")))
    world.check()
    assert RawDrive(world.root, drives.DATE, 5).K[0, 0] == drives.FOCAL
    assert world.server.requests == []


def test_target_that_is_an_extracted_tree_already_is_only_verified(world: World) -> None:
    _unpack(world, world.root)
    before = world.frame(11).stat().st_mtime_ns
    report = world.pull(local=str(world.root))
    assert report.fetched == 0
    assert world.frame(11).stat().st_mtime_ns == before
    assert world.pull(verify=True).files == 17


def test_local_folder_without_the_drive_names_what_is_missing(world: World, tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    with pytest.raises(InputFileError, match=r"neither .*_sync nor .*_sync\.zip is there"):
        world.pull(local=str(tmp_path / "here"))
    with pytest.raises(InputFileError, match="no such"):
        world.pull(local=str(tmp_path / "nowhere"))


def test_full_disk_is_seen_before_the_transfer(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda path: shutil._ntuple_diskusage(10, 9, 1))
    with pytest.raises(InputFileError, match=r"disk: expected .* MB free, found 0\.0 MB"):
        world.pull()
    assert not list(world.root.rglob("*.png"))


def test_command_line(world: World, capsys: pytest.CaptureFixture[str]) -> None:
    line = world.command("pull")
    assert cli.main([*line, "--wait", "0"]) == 2
    captured = capsys.readouterr()
    assert "CC BY-NC-SA" in captured.out
    assert captured.err.count("\n") == 1
    assert cli.main([*line, "--accept-license"]) == 0
    assert "complete and verified: 18 files" in capsys.readouterr().out
    assert cli.main([*line, "--verify"]) == 0
    assert "verified 18 files" in capsys.readouterr().out
