"""Find the frame numbers of clips in their KITTI drives.

The directory of a drive's zip tells CRC32 and size of every frame; that is enough when the clip's frames
are KITTI's own files, and costs a few hundred kB. Otherwise the drive's frames are read and compared by
pixels; and, when the clip's own frames are given, by correlation. What is proved goes to located.toml in
the output folder, where `kt3dmoseg pull` finds it.
"""

from __future__ import annotations

import argparse

from kt3dmoseg import options
from kt3dmoseg.kitti.locating import LocateOptions, locate


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``kt3dmoseg locate``."""
    parser.add_argument("clips", nargs="*", metavar="CLIP", help="clips of the catalog (default: all)")
    parser.add_argument(
        "-o", "--output", "--root", default="kitti_raw", help="folder of located.toml (default: kitti_raw)"
    )
    parser.add_argument(
        "--catalog", action="append", default=[], help="a catalog of your own; may be repeated"
    )
    options.add_arguments(parser, LocateOptions)


def run(arguments: argparse.Namespace) -> None:
    """Run ``kt3dmoseg locate``."""
    chosen = vars(options.from_namespace(LocateOptions, arguments))
    locate(arguments.output, arguments.clips, catalogs=arguments.catalog, **chosen)
