"""Publishing: a folder of clips becomes a named version of a dataset; versions are compared."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from kt3dmoseg.options import option
from kt3dmoseg.registry import lazy

if TYPE_CHECKING:
    from kt3dmoseg.publishing.versions import diff as diff
    from kt3dmoseg.publishing.versions import publish as publish
else:  # imported on first use: the help of commands reads only the options
    __getattr__, __dir__, __all__ = lazy(__name__, "PublishOptions")


@dataclass(frozen=True)
class PublishOptions:
    """What the card and the metadata say; texts may come from a file with --config."""

    name: str = option("", "name of the dataset", metavar="NAME")
    version: str = option("", "its version, as 1.0.0; a published version never changes", metavar="VERSION")
    license: str = option("", "SPDX identifier; of KITTI's frames always cc-by-nc-sa-3.0", metavar="ID")
    description: str = option("", "what it is, in a sentence or two", metavar="TEXT")
    date: str = option("", "day of publication, YYYY-MM-DD", metavar="DATE")
    citation: str = option("", "what to cite", metavar="TEXT")
    collection: str = option(
        "Image sequences filmed by a moving camera; the frames are not part of the dataset.",
        "how the frames came about",
        metavar="TEXT",
    )
    limitations: str = option(
        "Points lie where the picture has structure; small, distant and fast objects carry few of them.",
        "known limits and biases",
        metavar="TEXT",
    )
    sensitive: str = option(
        "Coordinates and labels of points only. People and licence plates may be visible in the frames, "
        "which are not part of the dataset.",
        "personal and sensitive information",
        metavar="TEXT",
    )
    uses: str = option(
        "Research on motion segmentation and point tracking; not for decisions about people.",
        "intended uses",
        metavar="TEXT",
    )
