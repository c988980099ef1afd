"""What the commands that work on KITTI's drives share: which clips, in which folder, of which catalogs."""

from __future__ import annotations

import argparse
from typing import Any

from kt3dmoseg import options


def add_arguments(parser: argparse.ArgumentParser, cls: type, output: str) -> None:
    """Add clips, folder and catalogs, and the fields of an options class; `output` is the folder's help."""
    parser.add_argument("clips", nargs="*", metavar="CLIP", help="clips of the catalog (default: all)")
    parser.add_argument(
        "-o",
        "--output",
        "--root",
        metavar="FOLDER",
        default="kitti_raw",
        help=f"{output} (default: kitti_raw)",
    )
    parser.add_argument(
        "--catalog",
        action="append",
        default=[],
        metavar="FILE",
        help="a catalog of your own; may be repeated",
    )
    options.add_arguments(parser, cls)


def keywords(arguments: argparse.Namespace, cls: type) -> dict[str, Any]:
    """Return the catalogs and options given, as keywords of the command's function."""
    return {"catalogs": arguments.catalog} | vars(options.from_namespace(cls, arguments))
