"""Make kt3dmoseg/catalog/catalog.toml: fingerprints of the 22 clips' frames; checksums only, no picture.

Usage: python tools/fingerprint_clips.py FRAMES [-o CATALOG], where FRAMES holds one folder per clip.
The frame numbers inside the drives were never published; `kt3dmoseg locate` finds them.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from kt3dmoseg import catalog
from kt3dmoseg.catalog import Drive, Entry
from kt3dmoseg.kitti.raw import fingerprint_folder

# The day of each drive that KT3DMoSeg uses; drive numbers are in the clips' names.
DAYS = {
    "2011_09_26": (5, 9, 11, 13, 20, 28, 59, 70, 84, 95, 113),
    "2011_09_28": (37, 38, 45),
    "2011_09_29": (71,),
}
COMMENT = """The 22 clips of KT3DMoSeg: drive, camera and the fingerprints of every frame.
Written by tools/fingerprint_clips.py. Camera 0: the frames are gray; locate tries the others."""


def describe(folder: Path) -> Entry:
    match = re.fullmatch(r"Seq(\d+)_[Cc]lip\d+", folder.name)
    drive = int(match[1]) if match else -1
    day = next((day for day, drives in DAYS.items() if drive in drives), "")
    frames, size = fingerprint_folder(folder)
    return Entry(folder.name, Drive(day, drive), 0, len(frames), size, frames=frames)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("frames", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=catalog.BUILT_IN)
    arguments = parser.parse_args()
    folders = sorted(path for path in arguments.frames.iterdir() if path.is_dir())
    catalog.save(arguments.output, [describe(folder) for folder in folders], comment=COMMENT)
    print(f"{arguments.output}: {len(folders)} clips")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
