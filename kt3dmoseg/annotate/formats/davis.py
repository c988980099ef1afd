"""DAVIS: a zip of indexed PNGs, ``00000.png`` on; the index is the motion, 0 background, 254 rejected.

Kept: which pixels have which motion in which frame. Not kept: names and kinds, objects that share a motion,
key frames, what is hidden, motions above 253, marks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from kt3dmoseg.annotate.formats.instances import from_images
from kt3dmoseg.annotate.formats.masks import label_image
from kt3dmoseg.annotate.model import REJECT, Annotation, Motion
from kt3dmoseg.annotate.propagation import Region
from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.files import zip_bytes
from kt3dmoseg.io.images import encode_indices
from kt3dmoseg.types import ByteArray

_VOID = 254


class Davis:
    """See the module."""

    suffix = ".zip"
    media_type = "application/zip"

    def dump(
        self, annotation: Annotation, regions: Mapping[int, list[Region]], names: Sequence[str] = ()
    ) -> bytes:
        """Write one indexed PNG per frame; see `AnnotationFormat`."""
        del names
        largest = max(annotation.motions, default=0)
        if largest >= _VOID:
            expected = f"at most {_VOID - 1}, as DAVIS can hold"
            raise InvalidValueError("motion", expected=expected, found=str(largest))
        values = {o.id: _VOID if o.motion == REJECT else int(o.motion) for o in annotation.objects}
        images = (label_image(annotation, regions, k, values) for k in range(annotation.n_frames))
        palette = davis_palette()
        return zip_bytes(
            {
                f"{frame:05d}.png": encode_indices(image.astype(np.uint8), palette)
                for frame, image in enumerate(images)
            }
        )

    def parse(self, content: bytes, like: Annotation, names: Sequence[str] = ()) -> Annotation:
        """Read a zip of indexed or gray PNGs; see `AnnotationFormat`. 254 and 255 are rejected."""
        found = from_images(content, like, names, "DAVIS masks", bits=8, largest=_VOID)
        motions: dict[int, Motion] = {value: REJECT if value == _VOID else value for value in found.numbers}
        titles = {value: "rejected" if value == _VOID else f"motion {value}" for value in found.numbers}
        return found.annotation(motions, names=titles)


DAVIS = Davis()


def davis_palette() -> ByteArray:
    """Return the palette of PASCAL VOC and DAVIS, (256, 3) RGB.

    The bits of the index are spread over the high bits of the channels.
    """
    palette = np.zeros((256, 3), dtype=np.uint8)
    for index in range(256):
        for bit in range(8):
            palette[index, bit % 3] |= ((index >> bit) & 1) << (7 - bit // 3)
    return palette
