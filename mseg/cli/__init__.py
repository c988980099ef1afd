"""The command line `mseg`: one module per command."""

from __future__ import annotations

from collections.abc import Sequence

from kt3dmoseg import program

COMMANDS = {
    "methods": ("mseg.cli.methods", "list the methods, or describe one"),
    "run": ("mseg.cli.run", "segment clips with a method and write the predictions"),
    "example-submission": ("mseg.cli.example_submission", "write a valid submission to start from"),
    "validate": ("mseg.cli.validate", "say everything that is wrong with a submission"),
    "score": ("mseg.cli.score", "score a submission"),
    "compare": ("mseg.cli.compare", "compare submissions, with paired statistics"),
    "report": ("mseg.cli.report", "write one self-contained HTML page about a submission"),
    "leaderboard": ("mseg.cli.leaderboard", "keep and rank scored submissions"),
    "benchmark": ("mseg.cli.benchmark", "methods x sequences x seeds, as a table"),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run `mseg` and return its exit code."""
    purpose = "3D motion segmentation of point trajectories: methods, benchmarks, scores."
    return program.main("mseg", purpose, COMMANDS, argv)
