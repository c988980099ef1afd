"""Fetch the 2018 release of KT3DMoSeg, and the other benchmarks, from their public homes.

Prints for each where it comes from, its licence, and what to do by hand when the page is gone.
"""

from __future__ import annotations

import argparse


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``kt3dmoseg fetch-release``."""
    help_names = "kt3dmoseg (default), hopkins155, hopkins12, mtpv62"
    parser.add_argument("names", nargs="*", metavar="NAME", default=["kt3dmoseg"], help=help_names)
    parser.add_argument(
        "-o", "--output", "--root", metavar="FOLDER", default="data", help="folder to fill (default: data)"
    )
    parser.add_argument(
        "--mirror", metavar="URL", help="address of a folder with the same files, one sub-folder per name"
    )


def run(arguments: argparse.Namespace) -> None:
    """Run ``kt3dmoseg fetch-release``."""
    from kt3dmoseg.kitti.releases import fetch_release

    fetch_release(arguments.output, arguments.names, mirror=arguments.mirror)
