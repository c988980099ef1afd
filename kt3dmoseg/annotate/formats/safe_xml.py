"""XML from strangers: no document type, hence no entities, internal or external."""

from __future__ import annotations

from xml.etree import ElementTree
from xml.parsers import expat

from kt3dmoseg.errors import FileFormatError

_MAX_DEPTH = 50


def parse(content: bytes, what: str) -> ElementTree.Element:
    """Parse XML after making sure that it defines nothing and does not nest deeply.

    Raises
    ------
    FileFormatError
        When it is not well-formed, has a document type, or nests deeper than 50 elements.
    """
    checker = expat.ParserCreate()
    depth = 0

    def refuse(*_: object) -> None:
        raise FileFormatError(what, expected="XML without a document type", found="<!DOCTYPE")

    def enter(*_: object) -> None:
        nonlocal depth
        depth += 1
        if depth > _MAX_DEPTH:
            raise FileFormatError(what, expected=f"at most {_MAX_DEPTH} nested elements", found="more")

    def leave(*_: object) -> None:
        nonlocal depth
        depth -= 1

    checker.StartDoctypeDeclHandler = refuse
    checker.StartElementHandler = enter
    checker.EndElementHandler = leave
    try:
        checker.Parse(content, True)
        return ElementTree.fromstring(content)
    except (expat.ExpatError, ElementTree.ParseError, ValueError, LookupError) as error:
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(what, expected="XML", found=str(error)[:100]) from error
