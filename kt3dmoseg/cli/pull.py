"""Fetch the clips' frames from KITTI raw, and nothing else.

Only the needed members of KITTI's zips are read: frames, their timestamps and GPS/IMU packets, the
calibration, and tracklets where there are any. Run it again after an interruption: it continues, and
fetches nothing twice. A second run that finds everything in place makes no request.
"""

from __future__ import annotations

import argparse

from kt3dmoseg import options
from kt3dmoseg.kitti.pulling import PullOptions, pull


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``kt3dmoseg pull``."""
    parser.add_argument("clips", nargs="*", metavar="CLIP", help="clips of the catalog (default: all)")
    parser.add_argument(
        "-o", "--output", "--root", default="kitti_raw", help="KITTI raw root to fill (default: kitti_raw)"
    )
    parser.add_argument(
        "--catalog", action="append", default=[], help="a catalog of your own; may be repeated"
    )
    options.add_arguments(parser, PullOptions)


def run(arguments: argparse.Namespace) -> None:
    """Run ``kt3dmoseg pull``."""
    chosen = vars(options.from_namespace(PullOptions, arguments))
    pull(arguments.output, arguments.clips, catalogs=arguments.catalog, **chosen)
