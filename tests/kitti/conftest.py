"""The world as fixtures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import kitti_drives as drives
import pytest
from kitti_server import FaultyServer, serving
from kitti_world import CALIB, FRAMES, HIDDEN, TRACKLETS, World

from kt3dmoseg import catalog
from kt3dmoseg.catalog import Drive, Entry, fingerprint


@pytest.fixture
def server() -> Iterator[FaultyServer]:
    with serving() as running:
        yield running


@pytest.fixture
def world(server: FaultyServer, tmp_path: Path) -> World:
    size = (320, 96)
    pictures = {k: drives.picture(k, size=size) for k in range(FRAMES)}
    frames = {k: drives.encode(picture) for k, picture in pictures.items()}
    files = drives.drive_files(frames, FRAMES)
    folder = f"{drives.DATE}/{drives.NAME}_sync"
    # What a pull must not fetch: the laser scans, between the wanted files.
    files |= {f"{folder}/velodyne_points/data/{k:010d}.bin": frames[k][::-1] for k in range(FRAMES)}
    made = World(server, tmp_path, files)
    made.serve()
    text = drives.tracklets(10, [(20.0, 0.0, 0.0)] * 4).encode()
    tracklets = drives.write_zip(tmp_path / "tracklets.zip", {f"{folder}/tracklet_labels.xml": text})
    calibration = drives.write_zip(tmp_path / "calib.zip", drives.calibration_files())
    server.files |= {TRACKLETS: tracklets.read_bytes(), CALIB: calibration.read_bytes()}
    marks = tuple(fingerprint(frames[k], pictures[k]) for k in HIDDEN)
    entry = Entry("Hidden", Drive(drives.DATE, drives.DRIVE), 0, len(marks), size, frames=marks)
    catalog.save(made.catalog, [entry])
    return made
