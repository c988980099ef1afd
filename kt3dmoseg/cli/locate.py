"""Find the frame numbers of clips in their KITTI drives.

The directory of a drive's zip tells CRC32 and size of every frame; that is enough when the clip's frames
are KITTI's own files, and costs a few hundred kB. Otherwise the drive's frames are read and compared by
pixels; and, when the clip's own frames are given, by correlation. What is proved goes to located.toml in
the output folder, where `kt3dmoseg pull` and `kt3dmoseg build` find it.
"""

from __future__ import annotations

import argparse

from kt3dmoseg.cli import clips_of_kitti
from kt3dmoseg.kitti.locating import locate
from kt3dmoseg.kitti.options import LocateOptions


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``kt3dmoseg locate``."""
    clips_of_kitti.add_arguments(parser, LocateOptions, "folder of located.toml")


def run(arguments: argparse.Namespace) -> None:
    """Run ``kt3dmoseg locate``."""
    locate(arguments.output, arguments.clips, **clips_of_kitti.keywords(arguments, LocateOptions))
