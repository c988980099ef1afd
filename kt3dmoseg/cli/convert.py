"""Convert a clip (.h5, .mat, .npz, .dat) or a flow field (.flo, .png, .npy, .npz).

The suffix of OUT names the format; IN is recognised by its content. What the format of OUT cannot
hold is said.
"""

from __future__ import annotations

import argparse


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("source", metavar="IN", help="file to read")
    parser.add_argument("target", metavar="OUT", help="file to write")


def run(arguments: argparse.Namespace) -> None:
    """Convert, and say what did not survive."""
    from kt3dmoseg.io.formats import convert

    lost = convert(arguments.source, arguments.target)
    print(
        f"{arguments.target}: written" + (f"; this format does not keep: {', '.join(lost)}" if lost else "")
    )
