"""The command line `kt3dmoseg`: one module per command."""

from __future__ import annotations

from collections.abc import Sequence

from kt3dmoseg import program

COMMANDS = {
    "demo": (
        "kt3dmoseg.cli.demo",
        "the whole way on a synthetic drive: build, label, segment, score, report",
    ),
    "pull": ("kt3dmoseg.cli.pull", "fetch the clips' frames from KITTI raw, and nothing else"),
    "locate": ("kt3dmoseg.cli.locate", "find a clip's frame numbers in a KITTI drive"),
    "build": ("kt3dmoseg.cli.build", "frames to dataset files: track, label, subsample"),
    "track": ("kt3dmoseg.cli.track", "frames to dense point trajectories"),
    "label": ("kt3dmoseg.cli.label", "outline the moving objects of a clip in the browser"),
    "show": ("kt3dmoseg.cli.show", "draw trajectories on the frames, as pictures or a video"),
    "info": ("kt3dmoseg.cli.info", "say what is inside a file or folder"),
    "convert": ("kt3dmoseg.cli.convert", "from one format to another"),
    "fetch-release": ("kt3dmoseg.cli.fetch_release", "fetch the 2018 release and the other benchmarks"),
    "catalog": ("kt3dmoseg.cli.catalog", "list, check and add clips"),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run `kt3dmoseg` and return its exit code."""
    purpose = "Build, label and read KT3DMoSeg, the 3D motion segmentation dataset cut from KITTI raw."
    return program.main("kt3dmoseg", purpose, COMMANDS, argv)
