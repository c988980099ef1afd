"""A world for the tests of pull: a server with a synthetic drive, and a catalog with a clip hidden in it."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import kitti_drives as drives
from kitti_server import FaultyServer

from kt3dmoseg.kitti.http import Traffic
from kt3dmoseg.kitti.pulling import PullReport, pull

FRAMES = 30
HIDDEN = tuple(range(11, 17))
SYNC = f"{drives.NAME}/{drives.NAME}_sync.zip"
TRACKLETS = f"{drives.NAME}/{drives.NAME}_tracklets.zip"
CALIB = f"{drives.DATE}_calib.zip"
QUICK: dict[str, Any] = {"wait": 0.0, "timeout": 5.0, "accept_license": True}


@dataclass
class World:
    """A server, what it serves, and where pulls go."""

    server: FaultyServer
    folder: Path
    files: dict[str, bytes]
    lines: list[str] = field(default_factory=list)

    @property
    def root(self) -> Path:
        return self.folder / "root"

    @property
    def catalog(self) -> Path:
        return self.folder / "mine.toml"

    def serve(self, files: dict[str, bytes] | None = None) -> None:
        self.files = files or self.files
        path = drives.write_zip(self.folder / "sync.zip", self.files)
        self.server.files[SYNC] = path.read_bytes()

    def pull(self, *clips: str, **options: Any) -> PullReport:
        self.traffic = Traffic()
        return pull(
            self.root,
            clips or ("Hidden",),
            catalogs=[self.catalog],
            traffic=self.traffic,
            report=self.lines.append,
            **{"mirror": self.server.url} | QUICK | options,
        )

    def command(self, name: str) -> list[str]:
        place = ["-o", str(self.root), "--catalog", str(self.catalog), "--mirror", self.server.url]
        return [name, "Hidden", *place]

    def check(self) -> None:
        """Every frame of the clip is on disk with the bytes that the drive has."""
        for number in HIDDEN:
            name = f"{drives.DATE}/{drives.NAME}_sync/image_00/data/{number:010d}.png"
            assert (self.root / name).read_bytes() == self.files[name]
        assert not list(self.root.rglob("*.part"))

    def frame(self, number: int) -> Path:
        return self.root / drives.DATE / f"{drives.NAME}_sync/image_00/data" / f"{number:010d}.png"


def faults(rate: float, names: list[str], seed: int = 0) -> Callable[[int, str], str]:
    """Return a fault function: a random one of these at this rate."""
    generator = random.Random(seed)
    return lambda count, path: generator.choice(names) if generator.random() < rate else ""
