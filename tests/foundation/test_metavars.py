"""Values have the same names in the help of every command; a path is FOLDER, FILE, or PATH for either."""

from __future__ import annotations

import re

import pytest

from kt3dmoseg import cli

PATHS = (
    "--frames",
    "--local",
    "--output",
    "--annotations",
    "--masks",
    "--cache",
    "--pred",
    "--catalog",
    "--kitti",
)


@pytest.mark.parametrize("command", sorted(cli.COMMANDS))
def test_a_path_is_a_folder_a_file_or_either(command, capsys):
    assert cli.main([command, "--help"]) == 0
    found = re.findall(r"(--[a-z]+)(?:, --[a-z]+)* ([A-Z_]+)", capsys.readouterr().out)
    shown = {name for flag, name in found if flag in PATHS}
    assert shown <= {"FOLDER", "FILE", "PATH"} | ({"N"} if command == "demo" else set())  # a count there
