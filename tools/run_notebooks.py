"""Execute the notebooks of the docs in place: every cell, from the top, in one fresh kernel each.

python tools/run_notebooks.py [NOTEBOOK ...]        needs the extra `test`
"""

from __future__ import annotations

import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "notebooks"


def executed(path: Path) -> nbformat.NotebookNode:
    """Return a notebook with the outputs of a fresh run; raises CellExecutionError where a cell fails."""
    notebook = nbformat.read(path, as_version=4)
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    small = ["--InlineBackend.figure_formats=jpeg", "--InlineBackend.rc=figure.dpi=80"]
    where = {"metadata": {"path": str(path.parent)}}
    NotebookClient(notebook, timeout=120, resources=where, extra_arguments=small).execute()
    notebook.metadata = nbformat.NotebookNode(kernelspec=kernel)
    for cell in notebook.cells:
        cell.metadata = nbformat.NotebookNode()  # no times: the same run gives the same file
    return notebook


if __name__ == "__main__":
    for each in map(Path, sys.argv[1:] or sorted(map(str, FOLDER.glob("*.ipynb")))):
        nbformat.write(executed(each), each)
        print(f"{each.name}: {each.stat().st_size >> 10} kB")
