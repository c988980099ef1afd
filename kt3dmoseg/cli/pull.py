"""Fetch the clips' frames from KITTI raw, and nothing else.

Only the needed members of KITTI's zips are read: frames, their timestamps and GPS/IMU packets, the
calibration, and tracklets where there are any. Run it again after an interruption: it continues, and
fetches nothing twice. A second run that finds everything in place makes no request.
"""

from __future__ import annotations

import argparse

from kt3dmoseg.cli import clips_of_kitti
from kt3dmoseg.kitti.options import PullOptions
from kt3dmoseg.kitti.pulling import pull


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``kt3dmoseg pull``."""
    clips_of_kitti.add_arguments(parser, PullOptions, "KITTI raw root to fill")


def run(arguments: argparse.Namespace) -> None:
    """Run ``kt3dmoseg pull``."""
    pull(arguments.output, arguments.clips, **clips_of_kitti.keywords(arguments, PullOptions))
