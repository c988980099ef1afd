"""Annotations of clips: regions on key frames, labelling of trajectories, the browser labeller."""

from __future__ import annotations

from typing import TYPE_CHECKING

from kt3dmoseg.registry import lazy

if TYPE_CHECKING:
    from kt3dmoseg.annotate import agreement as agreement
    from kt3dmoseg.annotate import formats as formats
    from kt3dmoseg.annotate import model as model
    from kt3dmoseg.annotate.labelling import LabelledTracks, LabelRule, label_tracks, label_tracks_detailed
    from kt3dmoseg.annotate.model import (
        AnnotatedObject,
        Annotation,
        KeyFrame,
        Mark,
        load_annotation,
        save_annotation,
        save_revision,
    )
    from kt3dmoseg.annotate.propagation import FlowMotion, ImageMotion, Region, TrackMotion, propagate

_LABELLING = ("LabelRule", "LabelledTracks", "label_tracks", "label_tracks_detailed")
_PROPAGATION = ("FlowMotion", "ImageMotion", "Region", "TrackMotion", "propagate")

__all__ = [
    "AnnotatedObject",
    "Annotation",
    "FlowMotion",
    "ImageMotion",
    "KeyFrame",
    "LabelRule",
    "LabelledTracks",
    "Mark",
    "Region",
    "TrackMotion",
    "label_tracks",
    "label_tracks_detailed",
    "load_annotation",
    "propagate",
    "save_annotation",
    "save_revision",
]

_PUBLIC = dict.fromkeys(__all__, "model") | dict.fromkeys(_LABELLING, "labelling")
_PUBLIC |= dict.fromkeys(_PROPAGATION, "propagation")
_MODULES = {"agreement": "agreement", "formats": "formats", "model": "model"}

if not TYPE_CHECKING:  # a checker refuses names that do not exist
    __getattr__, __dir__ = lazy(__name__, _PUBLIC, _MODULES)
