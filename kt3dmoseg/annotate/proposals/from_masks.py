"""Regions from masks that somebody else made, with the same readers as the import."""

from __future__ import annotations

from typing import TYPE_CHECKING

from kt3dmoseg.annotate.formats import load
from kt3dmoseg.annotate.model import AnnotatedObject
from kt3dmoseg.errors import FileFormatError, InputFileError
from kt3dmoseg.files import read_bytes, zip_bytes

if TYPE_CHECKING:
    from kt3dmoseg.annotate.proposals import Request

_MAX_FILE = 64 << 20
_FORMATS = ("davis", "mots_png")


def propose(request: Request) -> list[AnnotatedObject]:
    """Read ``<masks>/<clip>/*.png`` (DAVIS or MOTS) or ``<masks>/<clip>.txt`` (MOTS).

    Raises
    ------
    InputFileError
        When no folder of masks was given, or it has none for this clip.
    FileFormatError
        When they are of neither format.
    """
    if request.masks is None:
        raise InputFileError("masks", found="no folder of masks", fix="start with --masks FOLDER")
    text = request.masks / f"{request.clip}.txt"
    empty = request.annotation.emptied()
    if text.is_file():
        return list(load("mots_txt").parse(read_bytes(text, _MAX_FILE), empty, ()).objects)
    files = sorted((request.masks / request.clip).glob("*.png"))
    if not files:
        raise InputFileError(f"{request.masks / request.clip}", expected="masks, *.png", found="none")
    content = zip_bytes({file.name: read_bytes(file, _MAX_FILE) for file in files})
    names = [frame.name for frame in request.frames]
    problem: FileFormatError | None = None
    for name in _FORMATS:
        try:
            return list(load(name).parse(content, empty, names).objects)
        except FileFormatError as error:
            problem = problem or error
    assert problem is not None
    raise problem
