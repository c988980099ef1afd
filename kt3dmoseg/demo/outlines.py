"""An annotation as a person would draw it, made from what a synthetic scene knows."""

from __future__ import annotations

import cv2
import numpy as np

from kt3dmoseg.annotate import AnnotatedObject, Annotation, KeyFrame
from kt3dmoseg.annotate.model import Polygon
from kt3dmoseg.synthetic import Scene
from kt3dmoseg.types import ByteArray

_KEY_EVERY = 3  # frames between key frames
_LEAST_AREA = 24.0  # pixels; a smaller piece of an object is not outlined


def outline(scene: Scene, body: int, frame: int) -> KeyFrame:
    """Outline a vehicle in one frame, as a person would: the visible pieces, or hidden, or gone.

    Parameters
    ----------
    scene : Scene
        The scene.
    body : int
        Id of the vehicle in ``scene.ids``.
    frame : int
        Frame.
    """
    mask: ByteArray = (scene.ids(frame) == body).astype(np.uint8)
    found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    pieces = [cv2.approxPolyDP(c, 0.7, closed=True)[:, 0] for c in found if cv2.contourArea(c) >= _LEAST_AREA]
    polygons: tuple[Polygon, ...] = tuple(tuple((float(x), float(y)) for x, y in p) for p in pieces)
    if polygons:
        return KeyFrame(frame, "visible", polygons)
    return KeyFrame(frame, "occluded" if mask.any() else "outside")


def annotation_of(scene: Scene, clip: str) -> Annotation:
    """Annotate a scene from its own knowledge of the vehicles' outlines, on every third frame."""
    last = scene.n_frames - 1
    keys = sorted({*range(0, scene.n_frames, _KEY_EVERY), last})
    objects = []
    for number, vehicle in enumerate(scene.vehicles, start=1):
        frames = tuple(outline(scene, number + 1, frame) for frame in keys)
        objects.append(AnnotatedObject(number, vehicle.name, vehicle.kind, number, frames))
    return Annotation(clip, scene.image_size, scene.n_frames, tuple(objects), annotator="demo")
