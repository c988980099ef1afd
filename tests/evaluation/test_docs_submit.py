"""Every command and every piece of Python of the page runs, in its order, in an empty folder."""

import os
import re
import subprocess
import sys
from pathlib import Path

from mseg.cli import main

PAGE = Path(__file__).parents[2] / "docs" / "submit.md"


def test_the_page_runs(tmp_path):
    script = ["set -eu"]
    for kind, block in re.findall(r"```(bash|python)\n(.*?)```", PAGE.read_text(), re.DOTALL):
        script.append(block if kind == "bash" else f"python - <<'END'\n{block}\nEND\n")
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(
        ["bash", "-c", "\n".join(script)],
        cwd=tmp_path,
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(script) > 10
    assert "valid: 2 clips" in done.stdout
    assert "Left and right" in done.stdout
    assert (tmp_path / "report.html").exists()
    assert (tmp_path / "board.html").exists()


def test_commands_outside_the_blocks_exist(capsys):
    """Commands named in the text have the options that it gives them."""
    text = re.sub(r"```.*?```", "", PAGE.read_text(), flags=re.DOTALL)
    for command in ("score", "report", "example-submission"):
        assert main([command, "--help"]) == 0
        shown = capsys.readouterr().out
        for flag in {
            "score": ["--force", "--markdown", "--latex", "--csv"],
            "report": ["--frames", "--csv"],
        }.get(command, ["--from"]):
            assert flag in shown
            assert flag in text
