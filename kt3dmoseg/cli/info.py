"""Say what is inside a clip, a folder of clips, a folder of frames, a video or a flow field."""

from __future__ import annotations

import argparse


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("path", metavar="PATH", help="file or folder")


def run(arguments: argparse.Namespace) -> None:
    """Print the description."""
    from kt3dmoseg.io.info import info

    print(info(arguments.path))
