"""Hashes of source: what was computed by other code is never taken for the present code's."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from functools import cache
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path


@cache
def source_hash(*names: str) -> str:
    """Hash of the source of some modules and sub-packages of mseg, 16 hexadecimal digits.

    Parameters
    ----------
    *names : str
        Files or folders of this package, ``"types.py"`` or ``"geometry"``.
    """
    return _hash([Path(str(files("mseg").joinpath(name))) for name in names])


@cache
def foreign_hash(module: str) -> str:
    """Hash of the source of the package that a module belongs to; empty for our own, or where there is none.

    Parameters
    ----------
    module : str
        The module's full name, ``"their_package.velocity"``.
    """
    package = module.partition(".")[0]
    spec = find_spec(package) if package != __name__.partition(".")[0] else None
    places = [] if spec is None else spec.submodule_search_locations or [spec.origin or ""]
    return _hash([Path(place) for place in places]) if places else ""


def _hash(roots: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for root in roots:
        for path in [root] if root.is_file() else sorted(root.glob("**/*.py")):
            digest.update(path.name.encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
