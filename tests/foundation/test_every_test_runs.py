"""No test file lies where pytest does not look: a folder named `build` was passed over in silence."""

from __future__ import annotations

from fnmatch import fnmatch
from pathlib import Path

TESTS = Path(__file__).parents[1]


def test_no_folder_of_tests_is_passed_over(request):
    ignored = request.config.getini("norecursedirs")
    folders = {folder for file in TESTS.rglob("test_*.py") for folder in file.relative_to(TESTS).parts[:-1]}
    assert not [folder for folder in folders if any(fnmatch(folder, pattern) for pattern in ignored)]


def test_every_test_file_has_a_name_of_its_own():
    names = [file.name for file in TESTS.rglob("test_*.py")]
    assert len(names) == len(set(names))
