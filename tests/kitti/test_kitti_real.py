"""Real frames, hidden at unknown numbers of drives assembled here: located, pulled, targets kept."""

from __future__ import annotations

import random
import zipfile
from pathlib import Path
from typing import Any

import cv2
import kitti_drives as drives
import numpy as np
import pytest
from kitti_server import FaultyServer
from kitti_world import CALIB, QUICK, SYNC, TRACKLETS, faults

from kt3dmoseg import catalog
from kt3dmoseg.catalog import fingerprint
from kt3dmoseg.kitti import RawDrive, locate, pull
from kt3dmoseg.kitti.http import Traffic
from kt3dmoseg.kitti.raw import decode_frame

FOLDER = f"{drives.DATE}/{drives.NAME}_sync"
CLIP, LENGTH = "Seq005_Clip01", 20
FIRST = 17  # unknown to the code under test

pytestmark = pytest.mark.data


def _clip(data_root: Path, name: str) -> list[bytes]:
    return [path.read_bytes() for path in sorted((data_root / "kt3dmoseg/frames" / name).glob("*.png"))]


@pytest.fixture
def drive(data_root: Path, server: FaultyServer, tmp_path: Path) -> dict[str, bytes]:
    """A drive of 60 frames with the clip at 17..36, and, as KITTI's have, much else in its directory."""
    others = _clip(data_root, "Seq011_Clip01") + _clip(data_root, "Seq020_Clip01")
    before, after = others[:FIRST], others[FIRST:]
    frames = dict(enumerate([*before, *_clip(data_root, CLIP), *after]))
    files = drives.drive_files(frames, len(frames))
    files |= {f"{FOLDER}/velodyne_points/data/{k:010d}.bin": b"" for k in range(2000)}
    return files


def _serve(server: FaultyServer, folder: Path, files: dict[str, bytes]) -> None:
    path = drives.write_zip(folder / "sync.zip", files, method=zipfile.ZIP_STORED)
    server.files[SYNC] = path.read_bytes()
    path.unlink()
    calibration = drives.write_zip(folder / "calib.zip", drives.calibration_files())
    server.files[CALIB] = calibration.read_bytes()


def _pull(server: FaultyServer, root: Path, **options: Any) -> Traffic:
    traffic = Traffic()
    pull(root, [CLIP], traffic=traffic, report=len, mirror=server.url, **(QUICK | options))
    return traffic


def test_clip_of_the_built_in_catalog_is_located_and_pulled_within_the_targets(
    drive: dict[str, bytes], server: FaultyServer, tmp_path: Path, data_root: Path
) -> None:
    _serve(server, tmp_path, drive)
    root = tmp_path / "root"
    found = locate(root, [CLIP], mirror=server.url, report=len, wait=0.0)[CLIP]
    assert found.numbers == tuple(range(FIRST, FIRST + LENGTH))
    assert server.sent <= 400_000
    traffic = _pull(server, root)
    assert TRACKLETS not in server.files
    frames = sum(mark.bytes for mark in found.frames)
    files = 2 * LENGTH + 2
    assert server.sent <= 1.10 * frames + 400_000
    assert len(server.requests) <= 2 * files
    assert traffic.bytes <= server.sent
    kitti = RawDrive(root, drives.DATE, 5)
    assert kitti.numbers.tolist() == list(found.numbers)
    source = data_root / "kt3dmoseg/frames" / CLIP
    np.testing.assert_array_equal(
        kitti.frame(FIRST), cv2.imread(str(source / "000001.png"), cv2.IMREAD_GRAYSCALE)
    )
    server.reset()
    _pull(server, root)
    assert server.requests == []


def test_three_requests_in_ten_failing_cost_less_than_1_6_times_the_bytes(
    drive: dict[str, bytes], server: FaultyServer, tmp_path: Path
) -> None:
    _serve(server, tmp_path, drive)
    for seed, root in enumerate((tmp_path / "a", tmp_path / "b", tmp_path / "c")):
        server.reset()
        server.fault = faults(0.3, ["drop", "500", "503", "cut", "flip"], seed)
        _pull(server, root)
        server.fault = lambda count, path: ""
        sizes = sum(path.stat().st_size for path in root.rglob("*.png"))
        assert len(list(root.rglob("*.png"))) == LENGTH
        assert server.sent <= 1.6 * (sizes + 400_000)
        pull(root, [CLIP], verify=True, report=len)


@pytest.mark.parametrize("kind", ["pixels", "correlation"])
def test_recoded_frames_are_still_located(
    drive: dict[str, bytes], server: FaultyServer, tmp_path: Path, data_root: Path, kind: str
) -> None:
    recoded = {}
    for name, content in drive.items():
        if not name.endswith(".png"):
            recoded[name] = content
            continue
        if not FIRST - 4 <= int(name[-14:-4]) < FIRST + LENGTH + 4:
            continue  # a shorter drive, for the tests' time
        image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
        if kind == "correlation":
            image = (255 * (image / 255.0) ** 0.8).astype(np.uint8)
        recoded[name] = drives.encode(image, level=1)
    _serve(server, tmp_path, recoded)
    frames = str(data_root / "kt3dmoseg/frames") if kind == "correlation" else None
    found = locate(tmp_path / "root", [CLIP], mirror=server.url, report=len, wait=0.0, frames=frames)[CLIP]
    assert (found.proof, found.numbers) == (kind, tuple(range(FIRST, FIRST + LENGTH)))


def test_built_in_catalog_describes_the_frames(data_root: Path) -> None:
    clips = catalog.load()
    folders = sorted(path.name for path in (data_root / "kt3dmoseg/frames").iterdir())
    assert sorted(clips) == folders
    assert sum(clip.length for clip in clips.values()) == 384
    name = random.Random(0).choice(folders)
    paths = sorted((data_root / "kt3dmoseg/frames" / name).glob("*.png"))
    for path, mark in zip(paths, clips[name].frames, strict=True):
        assert fingerprint(path.read_bytes(), decode_frame(path.read_bytes(), path.name)) == mark
