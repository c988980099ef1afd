"""A hash of our own source: what was computed by other code is never taken for the present code's."""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.resources import files
from pathlib import Path


@cache
def source_hash(*names: str) -> str:
    """Hash of the source of some modules and sub-packages of mseg, 16 hexadecimal digits.

    Parameters
    ----------
    *names : str
        Files or folders of this package, ``"types.py"`` or ``"geometry"``.
    """
    digest = hashlib.sha256()
    for name in names:
        root = Path(str(files("mseg").joinpath(name)))
        for path in [root] if root.is_file() else sorted(root.glob("**/*.py")):
            digest.update(path.name.encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
