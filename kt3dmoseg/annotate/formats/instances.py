"""Objects gathered from masks, one at a time: only outlines are kept, so that no file fills the memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from kt3dmoseg.annotate.formats.archive import unpack
from kt3dmoseg.annotate.formats.masks import check_shape, polygons_of
from kt3dmoseg.annotate.formats.objects import key_frames_of, known_kind
from kt3dmoseg.annotate.model import MAX_OBJECTS, AnnotatedObject, Annotation, KeyFrame, Motion, Polygon
from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.io.images import decode_indices
from kt3dmoseg.types import BoolArray


class Instances:
    """The regions of numbered objects in the frames of a clip.

    Parameters
    ----------
    like : Annotation
        An empty annotation of the clip.
    """

    def __init__(self, like: Annotation) -> None:
        self.like = like
        self._outlines: dict[int, dict[int, list[Polygon]]] = {}

    @property
    def numbers(self) -> list[int]:
        """Numbers of the objects that have a pixel somewhere, ascending."""
        return sorted(self._outlines)

    def add(self, number: int, frame: int, mask: BoolArray, where: str) -> None:
        """Add the pixels of an object in one frame; what is there already stays.

        Raises
        ------
        FileFormatError
            When there are more objects than an annotation may have.
        """
        polygons = polygons_of(mask)
        if not polygons:
            return
        if number not in self._outlines and len(self._outlines) == MAX_OBJECTS:
            raise FileFormatError(where, expected=f"at most {MAX_OBJECTS} objects", found="more")
        self._outlines.setdefault(number, {}).setdefault(frame, []).extend(polygons)

    def annotation(
        self,
        motions: Mapping[int, Motion],
        *,
        kinds: Mapping[int, str] | None = None,
        names: Mapping[int, str] | None = None,
    ) -> Annotation:
        """Build the annotation; objects come in the order of their numbers, with ids from 1 on.

        Parameters
        ----------
        motions : mapping of number to motion
            The motion of each object.
        kinds, names : mapping of number to str, optional
            By default ``"other"`` and ``"object 3"``.
        """
        objects = []
        for identity, number in enumerate(self.numbers, start=1):
            kind = known_kind((kinds or {}).get(number, "other"))
            name = (names or {}).get(number) or f"object {number}"
            seen = {f: KeyFrame(f, "visible", tuple(p)) for f, p in self._outlines[number].items()}
            keys = key_frames_of(seen, self.like.n_frames)
            objects.append(AnnotatedObject(identity, name, kind, motions[number], keys))
        return replace(self.like, objects=tuple(objects))


def from_images(
    content: bytes, like: Annotation, names: Sequence[str], what: str, *, bits: int, largest: int
) -> Instances:
    """Gather the objects of a zip file of PNGs whose pixels are object numbers, 0 = background.

    Parameters
    ----------
    content : bytes
        The zip file, an image per frame.
    like : Annotation
        An empty annotation of the clip.
    names : sequence of str
        File names of the clip's frames; see `frame_indices`.
    what : str
        Name of the format, for messages.
    bits : int
        Refuse deeper images.
    largest : int
        Larger numbers are taken as this one.

    Raises
    ------
    FileFormatError
        When it is no such file, or does not fit the clip.
    """
    found = Instances(like)
    for frame, png in unpack(content, ".png", like, names, what).items():
        where = f"{what}, frame {frame}"
        image, depth = decode_indices(png, where)
        if depth > bits:
            expected = f"an indexed or gray PNG of {bits} bits"
            raise FileFormatError(where, expected=expected, found=f"{depth} bits")
        check_shape(image.shape, like, where)
        image = np.minimum(image, largest)
        for value in np.unique(image[image > 0]).tolist():
            found.add(value, frame, image == value, where)
    return found
