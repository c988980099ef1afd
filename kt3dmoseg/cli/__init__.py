"""The command line `kt3dmoseg`: one function per command."""

from functools import partial

from kt3dmoseg import app

COMMANDS = {
    "demo": "kt3dmoseg.cli.clips:demo",
    "pull": "kt3dmoseg.cli.kitti:pull",
    "locate": "kt3dmoseg.cli.kitti:locate",
    "choose": "kt3dmoseg.cli.clips:choose",
    "build": "kt3dmoseg.cli.clips:build",
    "track": "kt3dmoseg.cli.clips:track",
    "label": "kt3dmoseg.viewing:label",
    "annotations": "kt3dmoseg.annotate.exchange:notes",
    "show": "kt3dmoseg.viewing:show",
    "publish": "kt3dmoseg.cli.clips:publish",
    "diff": "kt3dmoseg.cli.clips:diff",
    "synth": "kt3dmoseg.cli.clips:synth",
    "info": "kt3dmoseg.cli.clips:info",
    "convert": "kt3dmoseg.cli.clips:convert",
    "fetch-release": "kt3dmoseg.cli.kitti:fetch_release",
    "catalog": "kt3dmoseg.cli.kitti:catalog",
}
_PURPOSE = "Build, label and read KT3DMoSeg, the 3D motion segmentation dataset cut from KITTI raw."

program = app.application("kt3dmoseg", _PURPOSE, COMMANDS)
main = partial(app.main, program)  # (argv=None) -> exit code
