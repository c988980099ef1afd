"""The commands printed in the README and the docs exist, with the flags they are printed with."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
LINE = re.compile(r"^\s*(?:\$ )?(kt3dmoseg|mseg) ([a-z][a-z-]*)\b(.*)$")


def printed() -> list[tuple[str, str, str, str]]:
    found = []
    for page in PAGES:
        text = page.read_text()
        blocks = re.findall(r"^```[a-z]*\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)
        blocks += re.findall(r"(?<!`)`((?:kt3dmoseg|mseg) [a-z][^`]*)`", text)  # in sentences and tables
        for line in "\n".join(blocks).splitlines():
            if match := LINE.match(line.split("#")[0]):
                found.append((page.name, *match.groups()))
    return found


def test_pages_print_commands():
    assert len(printed()) > 30


@pytest.mark.parametrize(("page", "program", "command", "rest"), printed())
def test_printed_command_exists_with_its_flags(page, program, command, rest, capsys):
    cli = import_module(f"{program}.cli")
    assert command in cli.COMMANDS, page
    words = rest.split()
    nested = [
        word for word in words[:1] if command in ("annotations", "catalog", "leaderboard") and word[0] != "-"
    ]
    assert cli.main([command, *nested, "--help-all"]) == 0
    text = capsys.readouterr().out
    for flag in re.findall(r"(?<!\S)--?[a-z][a-z-]*", rest):
        assert re.search(rf"(?<![\w-]){flag}(?![\w-])", text), f"{page}: {program} {command} has no {flag}"
