"""Annotations of clips: regions on key frames, labelling of trajectories, the browser labeller."""

from typing import TYPE_CHECKING

from kt3dmoseg.registry import lazy

if TYPE_CHECKING:
    from kt3dmoseg.annotate import agreement as agreement
    from kt3dmoseg.annotate import formats as formats
    from kt3dmoseg.annotate import model as model
    from kt3dmoseg.annotate.labelling import LabelledTracks as LabelledTracks
    from kt3dmoseg.annotate.labelling import label_tracks as label_tracks
    from kt3dmoseg.annotate.labelling import label_tracks_detailed as label_tracks_detailed
    from kt3dmoseg.annotate.model import AnnotatedObject as AnnotatedObject
    from kt3dmoseg.annotate.model import Annotation as Annotation
    from kt3dmoseg.annotate.model import KeyFrame as KeyFrame
    from kt3dmoseg.annotate.model import Mark as Mark
    from kt3dmoseg.annotate.model import load_annotation as load_annotation
    from kt3dmoseg.annotate.model import save_annotation as save_annotation
    from kt3dmoseg.annotate.model import save_revision as save_revision
    from kt3dmoseg.annotate.propagation import Region as Region
    from kt3dmoseg.annotate.propagation import TrackMotion as TrackMotion
    from kt3dmoseg.annotate.propagation import propagate as propagate
else:
    __getattr__, __dir__, __all__ = lazy(__name__)
