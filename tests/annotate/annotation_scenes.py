"""Annotations and clips that several test files use."""

from __future__ import annotations

import io
import zipfile

import cv2
import numpy as np
from hypothesis import strategies as st

from kt3dmoseg.annotate import AnnotatedObject, Annotation, KeyFrame, Mark, formats, save_revision
from kt3dmoseg.annotate.formats.masks import label_images
from kt3dmoseg.annotate.model import KINDS, REJECT
from kt3dmoseg.types import Clip, Labels, Trajectories

SIZE = (96, 64)
FRAMES = 5


def box(x, y, w=20.0, h=16.0):
    return ((x, y), (x + w, y), (x + w, y + h), (x, y + h))


def scene() -> Annotation:
    """Two parts of one motion, one that leaves and comes back, a rejected one, a hidden one, a mark."""
    far = tuple(
        KeyFrame(f, polygons=(box(60.25 - 3 * f, 8), box(60 - 3 * f, 40.5, 9, 9))) for f in range(FRAMES)
    )
    away = (
        KeyFrame(0, polygons=(box(4, 4),)),
        KeyFrame(2, "outside"),
        KeyFrame(4, polygons=(box(10, 4),)),
    )
    hidden = (KeyFrame(0, polygons=(box(30, 30),)), KeyFrame(3, "occluded", (box(32, 30),)))
    return Annotation(
        "scene",
        SIZE,
        FRAMES,
        (
            AnnotatedObject(1, "van & Söhne", "van", 1, far, "its <trailer> too"),
            AnnotatedObject(3, "walker", "pedestrian", 2, away),
            AnnotatedObject(4, "shadow", "other", "reject", hidden),
        ),
        (Mark(1, 0, box(1, 1, 5, 5)),),
        annotator="tester",
        revision=7,
    )


_coordinate = st.integers(-2000, 11600).map(lambda v: v / 100)
polygons = st.lists(
    st.lists(st.tuples(_coordinate, _coordinate), min_size=3, max_size=7).map(tuple), min_size=1, max_size=3
).map(tuple)


@st.composite
def key_frames(draw):
    frames = draw(st.lists(st.integers(0, FRAMES - 1), min_size=1, max_size=FRAMES, unique=True))
    keys = []
    for frame in frames:
        visibility = draw(st.sampled_from(["visible", "occluded", "outside"]))
        keys.append(KeyFrame(frame, visibility, () if visibility == "outside" else draw(polygons)))
    return tuple(keys)


_text = st.text(
    st.characters(codec="utf-8", exclude_categories=("Cc", "Cs")), min_size=1, max_size=12
).filter(lambda t: t == t.strip() and t)


@st.composite
def annotations(draw):
    count = draw(st.integers(0, 4))
    objects = tuple(
        AnnotatedObject(
            number,
            draw(_text),
            draw(st.sampled_from(KINDS)),
            draw(st.one_of(st.integers(0, 6), st.just("reject"))),
            draw(key_frames()),
            draw(st.one_of(st.just(""), _text)),
        )
        for number in range(1, count + 1)
    )
    return Annotation("scene", SIZE, FRAMES, objects, annotator="x")


def write_clip(folder, name="clip", size=(320, 200), frames=6, tracks=400, seed=0):
    """Write frames and a file of trajectories: a textured ground and a box that drifts 4 px per frame."""
    rng = np.random.default_rng(seed)
    ground = cv2.GaussianBlur(rng.integers(0, 255, (size[1], size[0]), dtype=np.uint8), (0, 0), 1.5)
    patch = cv2.GaussianBlur(rng.integers(100, 255, (60, 80), dtype=np.uint8), (0, 0), 1.5)
    (folder / "frames" / name).mkdir(parents=True)
    for k in range(frames):
        frame = ground.copy()
        frame[70:130, 60 + 4 * k : 140 + 4 * k] = patch
        cv2.imwrite(str(folder / "frames" / name / f"{k + 1:06d}.png"), frame)
    start = rng.uniform((2, 2), (size[0] - 3, size[1] - 3), (tracks, 2))
    on = (start[:, 0] > 62) & (start[:, 0] < 138) & (start[:, 1] > 72) & (start[:, 1] < 128)
    xy = start[:, None] + np.where(on[:, None, None], np.arange(frames)[None, :, None] * (4.0, 0.0), 0.0)
    trajectories = Trajectories(xy, np.ones(xy.shape[:2], bool), image_size=size)
    clip = Clip(name, trajectories, np.arange(tracks), Labels(np.zeros(tracks, int)))
    (folder / "tracks").mkdir(exist_ok=True)
    from kt3dmoseg import io

    io.save(clip, folder / "tracks" / f"{name}.npz")
    return on


def motions(annotation):
    """The motion of every pixel in every frame, 99 = rejected."""
    values = {o.id: 99 if o.motion == REJECT else int(o.motion) for o in annotation.objects}
    regions = formats.regions(annotation)
    return [image.tolist() for image in label_images(annotation, regions, values)]


def drawn_by_hand(path, name, corners, motion=1, clip="one", frames=6, annotator=""):
    """Save an annotation of one object with one key frame, as somebody would draw it."""
    key = KeyFrame(0, polygons=(tuple(corners),))
    item = AnnotatedObject(1, name, "car", motion, (key,))
    return save_revision(path, Annotation(clip, (320, 200), frames, (item,), annotator=annotator))


def zipped(**files):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, content in files.items():
            archive.writestr(name.replace("__", "/"), content)
    return out.getvalue()
