"""The command line `mseg`: one function per command."""

from __future__ import annotations

from functools import partial

from kt3dmoseg import app

COMMANDS = {
    "methods": "mseg.cli.runs:methods",
    "run": "mseg.cli.runs:run",
    "example-submission": "mseg.cli.scores:example_submission",
    "validate": "mseg.cli.scores:validate",
    "score": "mseg.cli.scores:score",
    "compare": "mseg.cli.scores:compare",
    "report": "mseg.cli.scores:report",
    "leaderboard": "mseg.cli.scores:leaderboard",
    "benchmark": "mseg.cli.runs:benchmark",
}
_PURPOSE = "3D motion segmentation of point trajectories: methods, benchmarks, scores."

program = app.application("mseg", _PURPOSE, COMMANDS)
main = partial(app.main, program)  # (argv=None) -> exit code
