"""Names complete in editors; errors speak of arguments as in Python, commands as they are typed."""

from __future__ import annotations

import ast
import re
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import kt3dmoseg
import mseg
from kt3dmoseg.app import typed
from kt3dmoseg.cli import main as kt3dmoseg_main
from kt3dmoseg.errors import InvalidValueError
from mseg.cli import main as mseg_main

ROOT = Path(__file__).resolve().parents[2]
COMMANDS = {"cli.py", "cli", "app.py", "demo.py", "server"}  # what only command lines and the page say
COMMANDS |= {"site.py"}  # which runs git
NAMES = (
    "build --propose",
    "--name",
    "--range",
    "--colour",
)  # of who made an annotation; parts of the command on a page
FLAG = re.compile(r"(?<![\w-])--[a-z]")


def texts(path: Path) -> list[tuple[str, int, str]]:
    """The string literals of a module that are no docstrings."""
    tree = ast.parse(path.read_text())
    scopes = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    first = [node.body[0] for node in ast.walk(tree) if isinstance(node, scopes) and node.body]
    docs = {id(each.value) for each in first if isinstance(each, ast.Expr)}
    strings = (node for node in ast.walk(tree) if isinstance(node, ast.Constant) and id(node) not in docs)
    return [(path.name, node.lineno, node.value) for node in strings if isinstance(node.value, str)]


def test_no_message_of_a_function_names_a_flag():
    files = [file for package in ("kt3dmoseg", "mseg") for file in sorted((ROOT / package).rglob("*.py"))]
    files = [file for file in files if not COMMANDS & set(file.relative_to(ROOT).parts)]
    assert len(files) > 100
    found = [text for file in files for text in texts(file) if FLAG.search(text[2])]
    assert [text for text in found if text[2] not in NAMES] == []


def test_the_same_mistake_is_named_in_python_and_on_the_command_line(tmp_path, capsys):
    xy = np.random.default_rng(0).uniform(0, 90, (9, 3, 2))
    with pytest.raises(InvalidValueError, match=r"give n_motions=N$"):
        mseg.segment(xy, "lsa")
    with pytest.raises(InvalidValueError, match=r"^rate: expected"):
        kt3dmoseg.show(tmp_path / "no.h5", rate=0)
    assert kt3dmoseg_main(["show", str(tmp_path / "no.h5"), "--rate", "0"]) == 2
    assert capsys.readouterr().err.startswith("kt3dmoseg: --rate: expected")


def test_only_arguments_of_the_running_command_are_typed_as_flags(monkeypatch, capsys):
    text = "a/seeds=3.csv: seeds=N, colour='luma', p=2, (parameter=None)"

    def run(*_, **__):
        raise InvalidValueError("it", fix=text)

    monkeypatch.setattr("mseg.benchmark.run", run)
    assert mseg_main(["benchmark", "kt3dmoseg"]) == 2
    said = "mseg: it; a/seeds=3.csv: --seeds N, colour='luma', p=2, (--parameter none)\n"
    assert capsys.readouterr().err == said
    assert typed(text) == text


@pytest.mark.parametrize("package", ["kt3dmoseg", "mseg", "mseg.evaluation", "kt3dmoseg.annotate"])
def test_editors_see_every_public_name_though_it_is_imported_when_used(package):
    module = import_module(package)
    tree = ast.parse(Path(module.__file__).read_text())
    found = [node for node in ast.walk(tree) if isinstance(node, (ast.Import, ast.ImportFrom))]
    seen = {alias.asname or alias.name for node in found for alias in node.names}
    seen |= {node.name for node in tree.body if isinstance(node, (ast.FunctionDef, ast.ClassDef))}
    seen |= {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
    assert set(module.__all__) <= seen
    assert set(module.__all__) <= set(dir(module))
    assert (ROOT / package.partition(".")[0] / "py.typed").is_file()
