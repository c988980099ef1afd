"""Files that people bring from other tools: right labels, or one line on why not."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from annotation_scenes import zipped

from kt3dmoseg.annotate import Annotation, formats, label_tracks
from kt3dmoseg.annotate.formats.foreign import SkippedWarning
from kt3dmoseg.annotate.formats.masks import encode_rle
from kt3dmoseg.annotate.model import Choices
from kt3dmoseg.errors import KT3DMoSegError
from kt3dmoseg.types import Trajectories

W, H, F = 320, 240, 8
LIKE = Annotation("clip", (W, H), F)
NAMES = [f"{k:06d}.png" for k in range(F)]
FROM_ONE = [f"{k + 1:06d}.png" for k in range(F)]
KITTI = [f"{k + 3:010d}.png" for k in range(F)]
CAR = "car"


def outline(k, scale=1, dx=0, dy=0):
    """The object in frame k, from the outer corner of the picture: it moves by 5 pixels a frame."""
    x, y = 60 + 5 * k + dx, 80 + dy
    return [(scale * a, scale * b) for a, b in ((x, y), (x + 100, y), (x + 100, y + 80), (x, y + 80))]


@pytest.fixture(scope="module")
def tracks():
    """Trajectories on a grid: those on the object ride along, the others drift by -1 pixel a frame."""
    x, y = (v.ravel() for v in np.meshgrid(np.arange(12.0, W - 8, 9), np.arange(5.0, H - 5, 9)))
    on = (x >= 64) & (x < 156) & (y >= 84) & (y < 156)
    near = (x >= 46) & (x < 205) & (y >= 70) & (y < 170) & ~on
    xy = np.stack([x, y], axis=1)[~near, None] + np.arange(F)[None, :, None] * np.where(
        on[~near, None, None], (5.0, 0.0), (-1.0, 0.0)
    )
    return Trajectories(xy, np.ones(xy.shape[:2], bool), image_size=(W, H)), on[~near]


def check_labels(annotation, tracks, motions=1):
    trajectories, on = tracks
    label = label_tracks(trajectories, annotation).label
    assert len(annotation.motions) == motions
    assert (label[on] == 2).mean() > 0.97
    assert (label[~on] > 1).mean() < 0.01
    points = [p for item in annotation.objects for key in item.key_frames for o in key.polygons for p in o]
    assert np.min(points) >= -0.5
    assert (np.max(points, axis=0) <= (W, H)).all()


# CVAT


def shape(frame, points, outside=0, key=1, more=""):
    text = ";".join(f"{x:.2f},{y:.2f}" for x, y in points)
    flags = f'frame="{frame}" keyframe="{key}" outside="{outside}" occluded="0" z_order="0"'
    return f'<polygon {flags} points="{text}">{more}</polygon>'


def track(number, *shapes, label=CAR, more=""):
    return f'<track id="{number}" label="{label}" source="manual"{more}>{"".join(shapes)}</track>'


def cvat(*body, meta=""):
    root = f"<annotations><version>1.1</version><meta>{meta}</meta>{''.join(body)}</annotations>"
    return f'<?xml version="1.0" encoding="utf-8"?>\n{root}'.encode()


def task(name="clip", number=5, size=F, more="", pictures=(W, H)):
    sides = f"<width>{pictures[0]}</width><height>{pictures[1]}</height>"
    size = f"<size>{size}</size>" if size else ""
    return (
        f"<task><id>{number}</id><name>{name}</name>{size}{more}<original_size>{sides}</original_size></task>"
    )


def image(k, *shapes, name="{:06d}.png", size=(W, H)):
    """An image of "CVAT for images"."""
    sides = f'width="{size[0]}" height="{size[1]}"'
    return f'<image id="{k}" name="{name.format(k)}" {sides}>{"".join(shapes)}</image>'


def drawn(points, more="", label=CAR, tag="polygon"):
    text = ";".join(f"{x:.2f},{y:.2f}" for x, y in points)
    return f'<{tag} label="{label}" occluded="0" points="{text}" z_order="0" {more}/>'


def project(*tasks):
    return f"<project><id>1</id><name>p</name><tasks>{''.join(tasks)}</tasks></project>"


def half(k, top):
    a, b, c, d = outline(k)
    return [a, b, c] if top else [a, c, d]


def rle_of(frame):
    left, top = outline(frame)[0]
    return f'<mask label="car" occluded="0" rle="0,8000" left="{left}" top="{top}" width="100" height="80"/>'


ENDS = shape(0, outline(0)), shape(7, outline(7))
OTHER = track(1, shape(0, [(10, 10), (40, 10), (40, 200), (10, 200)]), more=' task_id="6"')
RANGE = "<start_frame>40</start_frame><stop_frame>47</stop_frame>"
STEP = "<start_frame>0</start_frame><stop_frame>39</stop_frame><frame_filter>step=5</frame_filter>"
EVERY_OTHER = "<start_frame>0</start_frame><stop_frame>7</stop_frame><frame_filter>step=2</frame_filter>"
SEGMENT = "<start_frame>2</start_frame><stop_frame>6</stop_frame>"
ID = '<attribute name="track_id">7</attribute>'
LONG = [shape(40, outline(0)), shape(47, outline(7))]
RIGHT_CVAT = {
    "a track": cvat(track(0, *ENDS)),
    "for images": cvat(*[image(k, drawn(outline(k))) for k in range(F)]),
    "for images, in folders of Windows": cvat(
        *[image(k, drawn(outline(k)), name=r"left\{:06d}.png") for k in range(F)]
    ),
    "for images, masks": cvat(*[image(k, rle_of(k)) for k in range(F)]),
    "for images of a video": cvat(*[image(k, drawn(outline(k)), name="frame_{:06d}") for k in range(F)]),
    "for images, another size": cvat(
        *[image(k, drawn(outline(k, scale=2)), size=(2 * W, 2 * H)) for k in range(F)]
    ),
    "for images, two of them": cvat(*[image(k, drawn(outline(k))) for k in (0, 7)]),
    "for images, two annotated": cvat(*[image(k, drawn(outline(k)) * (k in (0, 7))) for k in range(F)]),
    "for images, groups": cvat(
        *[
            image(
                k,
                *(
                    drawn(points, 'group_id="4"')
                    for points in (outline(k)[:3], outline(k)[2:] + outline(k)[:1])
                ),
            )
            for k in range(F)
        ]
    ),
    "original size": cvat(
        track(0, shape(0, outline(0, 2)), shape(7, outline(7, 2))), meta=task(pictures=(640, 480))
    ),
    "start frame": cvat(track(0, *LONG), meta=task(more=RANGE)),
    "start frame, counted within the task": cvat(track(0, *ENDS), meta=task(more=RANGE)),
    "step, the clip subsampled": cvat(
        track(0, shape(0, outline(0)), shape(35, outline(7))), meta=task(more=STEP)
    ),
    "step, the clip is the video": cvat(
        track(0, shape(0, outline(0)), shape(6, outline(6))), meta=task(size=4, more=EVERY_OTHER)
    ),
    "a job of the task": cvat(
        track(0, shape(2, outline(2)), shape(6, outline(6)), more=""),
        meta=f"<job><id>3</id><size>5</size>{SEGMENT}</job>",
    ),
    "the second job of the task": cvat(
        track(0, shape(4, outline(4)), shape(7, outline(7))),
        meta="<job><id>3</id><size>4</size><start_frame>4</start_frame><stop_frame>7</stop_frame></job>",
    ),
    "two tasks": cvat(track(0, *ENDS, more=' task_id="5"'), OTHER, meta=project(task(), task("other", 6))),
    "two tasks, another size": cvat(
        track(0, shape(0, outline(0, 2)), shape(7, outline(7, 2)), more=' task_id="5"'),
        OTHER,
        meta=project(task(pictures=(640, 480)), task("other", 6, pictures=(100, 100))),
    ),
    "split track": cvat(
        track(0, shape(0, outline(0)), shape(3, outline(3)), shape(4, outline(4), outside=1)),
        track(1, shape(4, outline(4)), shape(7, outline(7))),
    ),
    "split twice": cvat(
        track(0, shape(0, outline(0)), shape(2, outline(2), outside=1)),
        track(1, shape(2, outline(2)), shape(5, outline(5), outside=1)),
        track(2, shape(5, outline(5)), shape(7, outline(7))),
    ),
    "comes back with its id": cvat(
        track(0, shape(0, outline(0), more=ID), shape(2, outline(2), outside=1, more=ID)),
        track(1, shape(3, outline(3), more=ID), shape(7, outline(7), more=ID)),
    ),
    "no key frame": cvat(track(0, *[shape(k, outline(k), key=0) for k in range(F)])),
}


@pytest.mark.parametrize("case", RIGHT_CVAT)
def test_cvat_gives_right_labels(case, tracks):
    check_labels(formats.load("cvat").parse(RIGHT_CVAT[case], LIKE, NAMES), tracks)


@pytest.mark.parametrize("end", [7, None])
def test_key_frames_that_a_subsampled_clip_has_not_are_not_lost(end, tracks):
    """The clip is every second frame of the video; the object turns in frame 5, and leaves in frame 7."""
    last, keys = end or 15, (0, 5, 15)
    shapes = [shape(j, outline(j / 2), key=int(j in keys)) for j in range(last + (not end))]
    shapes += [shape(end, outline(3), outside=1)] * bool(end)
    names = [f"{2 * k:06d}.png" for k in range(F)]
    plan = formats.plan("cvat", cvat(track(0, *shapes), meta=task(size=16)), LIKE, names)
    (item,) = plan.annotation.objects
    found = [(key.frame, key.visibility) for key in item.key_frames]
    assert found == [(k, "visible") for k in range(4 if end else F)] + [(4, "outside")] * bool(end)
    assert item.key_frames[3].polygons[0][0] == (74.5, 79.5)


REFUSED_CVAT = {
    "other proportions": (cvat(track(0, *ENDS), meta=task(pictures=(640, 360))), "640x360"),
    "frames that the clip has not": (cvat(track(0, *LONG)), "40, 47"),
    "some frames that the clip has not": (cvat(track(0, *ENDS, shape(8, outline(8)))), "frames 8"),
    "a longer task": (cvat(track(0, *ENDS), meta=task(size=200)), "frames 0 to 199"),
    "a part of a longer task": (
        cvat(track(0, *ENDS), meta=task(size=8, more=RANGE.replace("47", "99"))),
        "frames 40 to 99",
    ),
    "no task of that name": (
        cvat(OTHER, meta=project(task("a", 5), task("other", 6))),
        "a, other",
    ),
    "two tasks of that name": (cvat(OTHER, meta=project(task("clip", 5), task("clip", 6))), "clip, clip"),
    "boxes": (cvat(track(0, '<box frame="0" xtl="1" ytl="1" xbr="9" ybr="9"/>')), "box"),
    "skeletons": (cvat(track(0, '<skeleton frame="0"><points/></skeleton>')), "skeleton"),
    "polylines for images": (cvat(image(0, drawn(outline(0), tag="polyline"))), "polyline"),
    "unknown size, far out": (cvat(track(0, shape(0, outline(0, 2)), shape(7, outline(7, 2)))), "390, 320"),
    "images of another clip": (cvat(image(0, drawn(outline(0)), name="street_{:03d}9.png")), "street_0009"),
    "two of one label, no groups": (
        cvat(*[image(k, drawn(outline(k)), drawn([(1, 1), (9, 1), (9, 9)])) for k in range(F)]),
        "2 shapes of 'car'",
    ),
}


@pytest.mark.parametrize("case", REFUSED_CVAT)
def test_cvat_says_why_it_is_not_read(case):
    content, word = REFUSED_CVAT[case]
    with pytest.raises(KT3DMoSegError, match=word):
        formats.load("cvat").parse(content, LIKE, NAMES)


# COCO


def flat(k, scale=1, dy=0):
    return [np.ravel(outline(k, scale, dy=dy)).tolist()]


def coco(
    ids, *, first=1, names="{:06d}.png", size=(W, H), frames=range(F), listed=range(F), segment=flat, **more
):
    shapes = []
    for k in frames:
        place = {"bbox": [60 + 5 * k, 80, 100, 80], "segmentation": segment(k), "area": 8000}
        shapes.append({"id": k + 1, "image_id": k + first, "category_id": 1, "iscrowd": 0} | place | ids)
    sides = {"width": size[0], "height": size[1]} if size else {}
    images = [{"id": k + first, "file_name": names.format(k)} | sides for k in listed]
    data = {"images": images, "categories": [{"id": 1, "name": CAR}], "annotations": shapes} | more
    return json.dumps(data).encode()


def crowd(k, scale=1):
    """Uncompressed run lengths, as COCO has them where iscrowd is 1."""
    picture = np.zeros((H * scale, W * scale), bool)
    picture[80 * scale : 160 * scale, (60 + 5 * k) * scale : (160 + 5 * k) * scale] = True
    flat = picture.ravel(order="F")
    ends = np.flatnonzero(np.diff(flat)) + 1
    return {"size": list(picture.shape), "counts": np.diff([0, *ends, flat.size]).tolist()}


RIGHT_COCO = {
    "attributes.track_id": coco({"attributes": {"occluded": False, "track_id": 0, "keyframe": True}}),
    "track_id": coco({"track_id": 0}),
    "track_id as text": coco({"track_id": "car-7"}),
    "track_id null and in attributes": coco({"track_id": None, "attributes": {"track_id": 0}}),
    "image ids as texts": re.sub(rb'("(?:image_)?id": )(\d+)', rb'\1"u\2"', coco({"track_id": 1})),
    "instance_id": coco({"instance_id": 5}),
    "ids of pandas": coco({"track_id": 5.0}),
    "a mark of the byte order": b"\xef\xbb\xbf" + coco({"track_id": 5}),
    "no id, one of a category": coco({}),
    "image ids from 0": coco({"track_id": 1}, first=0),
    "image ids of no order": coco({"track_id": 1}, first=900),
    "folders": coco({"track_id": 1}, names="images/left/{:06d}.png"),
    "folders of Windows": coco({"track_id": 1}, names=r"C:\images\{:06d}.png"),
    "frames of CVAT": coco({"track_id": 1}, names="frame_{:06d}.PNG"),
    "names of Roboflow": coco({"track_id": 1}, names="{:06d}_png.rf.0a1b2c3d4e5f67890.jpg"),
    "another size": coco({"track_id": 1}, size=(640, 480), segment=lambda k: flat(k, 2)),
    "run lengths": coco({"track_id": 1, "iscrowd": 1}, segment=crowd),
    "run lengths of another size": coco(
        {"track_id": 1}, size=(640, 480), segment=lambda k: crowd(k, scale=2)
    ),
    "zipped": zipped(**{"annotations__instances_default.json": coco({"track_id": 1})}),
    "two frames listed": coco({"track_id": 1}, frames=(0, 7), listed=(0, 7)),
    "two frames annotated": coco({"track_id": 1}, frames=(0, 7)),
    "two videos": json.dumps(
        {
            "videos": [{"id": 1, "name": "other"}, {"id": 2, "name": "clip"}],
            "images": [
                {"id": 10 * v + k, "video_id": v, "file_name": f"{k:06d}.png"}
                for v in (1, 2)
                for k in range(F)
            ],
            "annotations": [
                {
                    "image_id": 10 * v + k,
                    "track_id": v,
                    "segmentation": [np.ravel(outline(k, dy=30 * (v == 1))).tolist()],
                }
                for v in (1, 2)
                for k in range(F)
            ],
        }
    ).encode(),
}


@pytest.mark.parametrize("case", RIGHT_COCO)
def test_coco_gives_right_labels(case, tracks):
    found = formats.load("coco").parse(RIGHT_COCO[case], LIKE, NAMES)
    assert len(found.objects) == 1
    check_labels(found, tracks)


LABEL_STUDIO = json.dumps([{"id": 1, "annotations": [{"result": [{"type": "polygonlabels"}]}]}]).encode()
YOUTUBE_VIS = json.dumps(
    {"videos": [{"id": 1}], "annotations": [{"video_id": 1, "segmentations": [crowd(0), None]}]}
).encode()
REFUSED_COCO = {
    "Label Studio": (LABEL_STUDIO, "found JSON of Label Studio; write COCO"),
    "YouTube-VIS": (YOUTUBE_VIS, "found YouTube-VIS; write COCO"),
    "shares": (coco({"track_id": 1}, segment=lambda k: flat(k, 1 / 320)), "0 to 1"),
    "boxes": (coco({"track_id": 1}, segment=lambda k: []), "a box only"),
    "numbers from 1": (
        coco({"track_id": 1}, names="frame_{:06d}.png", listed=range(1, F + 1), frames=[1]),
        "000008",
    ),
    "other names": (coco({"track_id": 1}, names="a{:03d}9.png"), "a0009"),
    "other proportions": (coco({"track_id": 1}, size=(640, 360)), "640x360"),
    "unknown size, far out": (
        coco({"track_id": 1}, size=None, segment=lambda k: flat(k, 3)),
        "scale them if they were drawn on others",
    ),
    "larger than the size that is stated": (coco({"track_id": 1}, segment=lambda k: flat(k, 2)), "390, 320"),
    "ids of shapes": (
        re.sub(rb'(?<="track_id": )1', lambda found: b"%d" % found.start(), coco({"track_id": 1})),
        "every object is in one frame only",
    ),
    "pairs": (coco({"track_id": 1}, segment=lambda k: [outline(k)]), r"expected \[\[x, y, x, y"),
    "one list": (coco({"track_id": 1}, segment=lambda k: flat(k)[0]), r"expected \[\[x, y, x, y"),
    "a list of shapes": (b"[1]", "expected images, annotations, categories"),
    "two without ids": (
        coco({}, frames=[0, 1, 2, 0]),
        "frame 0 has 2 shapes of 'car'",
    ),
    "400 digits": (
        coco({"track_id": 1}, segment=lambda k: [[10**400, 1, 5, 5, 9, 9]]),
        "401 digits",
    ),
    "no images": (coco({"track_id": 1}, listed=()), "image_id"),
    "an image id twice": (coco({}).replace(b'"id": 2, "file', b'"id": 1, "file'), "each once, found 1 twice"),
    "an image twice": (coco({}, names="000003.png"), "found '000003.png' twice"),
    "one id for two kinds": (
        coco({"track_id": 1}, frames=[0, 1, 2, 0]).replace(b'"category_id": 1', b'"category_id": 2', 1),
        "shapes of several labels have one id, 1: car, other",
    ),
}


@pytest.mark.parametrize("case", REFUSED_COCO)
def test_coco_says_why_it_is_not_read(case):
    content, word = REFUSED_COCO[case]
    with pytest.raises(KT3DMoSegError, match=word) as caught:
        formats.load("coco").parse(content, LIKE, NAMES)
    assert len(str(caught.value)) < 500


# LabelMe


def labelme(k, scale=1, size=(W, H), points=None, **fields):
    points = outline(k, scale) if points is None else points
    item = {"label": "car", "points": points, "group_id": None, "shape_type": "polygon", "flags": {}} | fields
    sides = {"imageHeight": size[1], "imageWidth": size[0]} if size else {}
    return json.dumps({"version": "5.5.0", "shapes": [item], "imagePath": rf"..\left\{k:06d}.png"} | sides)


RIGHT_LABELME = {
    "labels only": zipped(**{f"{k:06d}.json": labelme(k) for k in range(F)}),
    "groups as floats": zipped(**{f"{k:06d}.json": labelme(k, group_id=(3, 3.0)[k % 2]) for k in range(F)}),
    "folders of Windows": zipped(**{f"clip\\{k:06d}.JSON": labelme(k) for k in range(F)}),
    "groups": zipped(**{f"{k:06d}.json": labelme(k, group_id=3, label=f"car {k}") for k in range(F)}),
    "two files": zipped(**{f"{k:06d}.json": labelme(k) for k in (0, 7)}),
    "rectangles": zipped(
        **{f"{k:06d}.json": labelme(k, points=outline(k)[::2], shape_type="rectangle") for k in range(F)}
    ),
    "another size": zipped(**{f"{k:06d}.json": labelme(k, 2, (640, 480)) for k in range(F)}),
    "folders and hidden files": zipped(
        **{f"clip__{k:06d}.json": labelme(k) for k in range(F)}, **{"__MACOSX__._000001.json": "x"}
    ),
    "one file": labelme(0).encode(),
}


@pytest.mark.parametrize("case", RIGHT_LABELME)
def test_labelme_gives_right_labels(case, tracks):
    check_labels(formats.load("labelme").parse(RIGHT_LABELME[case], LIKE, NAMES), tracks)


REFUSED_LABELME = {
    "other proportions": (zipped(**{"000000.json": labelme(0, size=(640, 360))}), "640x360"),
    "lines": (zipped(**{"000000.json": labelme(0, shape_type="line")}), "'line'"),
    "frames from 1": (zipped(**{f"{k + 1:06d}.json": labelme(k) for k in range(F)}), "000008.json"),
    "another frame's picture": (zipped(**{"000001.json": labelme(0)}), "000001.json is not named as"),
    "COCO": (coco({}), "imagePath"),
    "Label Studio": (LABEL_STUDIO, "found JSON of Label Studio; write COCO"),
    "YouTube-VIS": (YOUTUBE_VIS, "found YouTube-VIS; write COCO"),
    "two of one label": (
        zipped(
            **{
                f"{k:06d}.json": json.dumps(
                    {
                        "shapes": [
                            {"label": "car", "points": outline(k)},
                            {"label": "car", "points": [(1, 1), (5, 1), (5, 5)]},
                        ]
                    }
                )
                for k in range(F)
            }
        ),
        "2 shapes of 'car'",
    ),
}


@pytest.mark.parametrize("case", REFUSED_LABELME)
def test_labelme_says_why_it_is_not_read(case):
    content, word = REFUSED_LABELME[case]
    with pytest.raises(KT3DMoSegError, match=word):
        formats.load("labelme").parse(content, LIKE, NAMES)


def test_a_circle_is_an_outline():
    content = zipped(**{"000000.json": labelme(0, points=[[50, 60], [50, 90]], shape_type="circle")})
    (item,) = formats.load("labelme").parse(content, LIKE, NAMES).objects
    radius = np.hypot(*(np.array(item.key_frames[0].polygons[0]) - (49.5, 59.5)).T)
    assert np.allclose(radius, 30, atol=0.02)


# Masks


def mask(k, value=1, dtype=np.uint8, size=(W, H), blank=0, scale=1):
    picture = np.full((size[1], size[0]), blank, dtype)
    picture[80:160, 60 + 5 * k : 160 + 5 * k] = value
    picture = np.kron(picture, np.ones((scale, scale), dtype))
    return cv2.imencode(".png", picture)[1].tobytes()


def masks(frames=range(F), name="{:06d}.png", first=0, **options):
    return zipped(**{name.format(k + first): mask(k, **options) for k in frames})


RIGHT_MASKS = {
    "all": (masks(), NAMES),
    "two frames": (masks((0, 7)), NAMES),
    "another size": (masks(scale=2), NAMES),
    "one frame": (masks((3,)), NAMES),
    "255": (masks(value=255), NAMES),
    "255 in two frames": (masks((0, 7), value=255), NAMES),
    "below folders": (masks(name="masks__clip__{:06d}.png"), NAMES),
    "of several clips": (
        zipped(
            **{f"clip__{k:06d}.png": mask(k) for k in range(F)},
            **{f"other__{k:06d}.png": mask(0, 2) for k in range(F)},
        ),
        NAMES,
    ),
    "another width of numbers": (masks(name="{:05d}.png"), NAMES),
    "numbers of the frames": (masks(range(5), first=3), KITTI),
    "of a longer sequence": (
        zipped(**{f"{k:06d}.png": mask(max(0, k - 3), 0 if k < 3 else 1) for k in range(12)}),
        KITTI,
    ),
    "named as the frames, from 1": (masks(first=1), FROM_ONE),
    "hidden files": (
        zipped(
            **{f"{k:06d}.png": mask(k) for k in range(F)}, **{"._000000.png": b"x", "__MACOSX__._1.png": b"x"}
        ),
        NAMES,
    ),
}


@pytest.mark.parametrize("case", RIGHT_MASKS)
def test_masks_give_right_labels(case, tracks):
    content, names = RIGHT_MASKS[case]
    check_labels(formats.load("davis").parse(content, LIKE, names), tracks)


def test_mots_masks_of_another_size_are_scaled(tracks):
    png = masks(value=1001, dtype=np.uint16, scale=3)
    twice = [cv2.imdecode(np.frombuffer(mask(k, scale=2), np.uint8), cv2.IMREAD_UNCHANGED) for k in range(F)]
    text = "".join(f"{k} 1001 1 {2 * H} {2 * W} {encode_rle(m > 0)}\n" for k, m in enumerate(twice))
    for name, content in (("mots_png", png), ("mots_txt", text.encode())):
        plan = formats.plan(name, content, LIKE, NAMES)
        assert "scaled to 320x240" in " ".join(plan.notes)
        check_labels(plan.annotation, tracks)


def test_mots_numbers_are_those_of_the_frames(tracks):
    content = zipped(**{f"{k + 3:06d}.png": mask(k, 1001, np.uint16) for k in range(5)})
    found = formats.load("mots_png").parse(content, LIKE, KITTI)
    assert [key.frame for key in found.objects[0].key_frames] == [0, 1, 2, 3, 4]
    trajectories, on = tracks
    assert (label_tracks(trajectories, found).label[on] == 2).all()


COLOURS = cv2.imencode(".png", np.ones((H, W, 3), np.uint8))[1].tobytes()
REFUSED_MASKS = {
    "a stray file": (
        {"000000.png": mask(0, 0), **{f"{k + 1:06d}.png": mask(k) for k in range(6)}},
        FROM_ONE,
        "000000.png",
    ),
    "from 0, frames from 1": ({f"{k:06d}.png": mask(k) for k in range(F)}, FROM_ONE, "shift of 1"),
    "from 1, frames from 0": ({f"{k + 1:06d}.png": mask(k) for k in range(F)}, NAMES, "000008.png"),
    "another size": ({"000000.png": mask(0, size=(W + 100, H))}, NAMES, "420x240"),
    "colours": ({"000000.png": COLOURS}, NAMES, "3 channels; write it as indexed PNG"),
    "16 bits": ({"000000.png": mask(0, 1, np.uint16)}, NAMES, "16 bits"),
    "255 and gray levels": ({"000000.png": mask(0, 255), "000001.png": mask(1, 128)}, NAMES, "255"),
    "pictures": ({"000000.jpg": b"x"}, NAMES, r"\*\.png"),
    "another file": ({"000000.png": mask(0), "overlay.png": mask(0)}, NAMES, "overlay.png"),
    "no background": ({f"{k:06d}.png": mask(k, 2, blank=1) for k in range(F)}, NAMES, "0 for the background"),
    "other clips": ({f"{clip}__000000.png": mask(0) for clip in ("a", "b")}, NAMES, "a, b"),
}


@pytest.mark.parametrize("case", REFUSED_MASKS)
def test_masks_say_why_they_are_not_read(case):
    files, names, word = REFUSED_MASKS[case]
    with pytest.raises(KT3DMoSegError, match=word):
        formats.load("davis").parse(zipped(**files), LIKE, names)


def test_a_crowd_beside_objects_is_rejected():
    data = json.loads(coco({"track_id": 1}))
    data["annotations"].append({"image_id": 1, "category_id": 1, "iscrowd": 1, "segmentation": crowd(0)})
    plan = formats.plan("coco", json.dumps(data).encode(), LIKE, NAMES)
    assert [item.motion for item in plan.annotation.objects] == [1, "reject"]
    assert "crowds are rejected" in " ".join(plan.notes)


def test_of_two_shapes_of_a_track_in_one_frame_the_last_counts_and_that_is_said(tracks):
    shapes = [shape(k, outline(k)) for k in range(F)]
    plan = formats.plan("cvat", cvat(track(0, shape(3, outline(0)), *shapes)), LIKE, NAMES)
    assert plan.skipped == ["track[0]: of several shapes in one frame, all but the last"]
    check_labels(plan.annotation, tracks)


def test_what_is_left_out_of_a_noisy_mask_is_said():
    noise = np.random.default_rng(0).integers(0, 2, (H, W)).astype(np.uint8)
    content = zipped(**{"000000.png": cv2.imencode(".png", noise)[1].tobytes()})
    assert "very many parts" in " ".join(formats.plan("davis", content, LIKE, NAMES).notes)


@pytest.mark.parametrize(("mark", "between"), [(b"\xef\xbb\xbf", b" "), (b"", b"\t")])
def test_mots_text_as_spreadsheets_write_it(mark, between):
    line = f"0 1001 1 {H} {W} {encode_rle(np.eye(H, W, dtype=bool))}".encode()
    found = formats.plan("mots_txt", mark + line.replace(b" ", between), LIKE, NAMES)
    assert (len(found.annotation.objects), found.skipped) == (1, [])


@pytest.mark.parametrize("more", [EVERY_OTHER, "<start_frame>4</start_frame><stop_frame>7</stop_frame>"])
def test_frames_that_a_task_has_not_are_asked_about(more):
    content = cvat(track(0, *[shape(k, outline(k)) for k in range(4)]), meta=task(size=4, more=more))
    (doubt,) = formats.plan(
        "cvat", content.encode() if isinstance(content, str) else content, LIKE, NAMES
    ).doubts
    assert re.match("frames .* are none of the task's, [04] to [67]", doubt)


def test_255_next_to_other_ids_is_void():
    picture = np.zeros((H, W), np.uint8)
    picture[80:160, 60:160], picture[70:80, 60:160] = 1, 255
    content = zipped(**{"000000.png": cv2.imencode(".png", picture)[1].tobytes()})
    car, void = formats.load("davis").parse(content, LIKE, NAMES).objects
    assert (car.motion, void.motion) == (1, "reject")


def test_a_white_object_with_soft_edges_is_no_void():
    soft = cv2.GaussianBlur(
        np.where(np.arange(W) > 99, 255, 0).repeat(H).reshape(W, H).T.astype(np.uint8), (5, 5), 1
    )
    with pytest.raises(KT3DMoSegError, match=r"ids 1, 2, \.\.\. \(255 = void\), found 255 and"):
        formats.load("davis").parse(
            zipped(**{"000000.png": cv2.imencode(".png", soft)[1].tobytes()}), LIKE, NAMES
        )


@pytest.mark.parametrize("name", ["davis", "mots_png"])
def test_an_empty_mask_is_absence_and_no_mask_is_not(name):
    dtype = np.uint8 if name == "davis" else np.uint16
    files = {
        "000001.png": mask(1, 0, dtype),
        "000003.png": mask(3, 1, dtype),
        "000006.png": mask(6, 0, dtype),
    }
    (item,) = formats.load(name).parse(zipped(**files), LIKE, NAMES).objects
    assert [(key.frame, key.visibility) for key in item.key_frames] == [
        (1, "outside"),
        (3, "visible"),
        (6, "outside"),
    ]


@pytest.mark.parametrize("name", ["davis", "mots_png", "mots_txt", "coco", "labelme", "cvat"])
@pytest.mark.parametrize("names", [FROM_ONE, KITTI])
def test_what_we_export_comes_back_whatever_the_numbers_of_the_frames(name, names, tracks):
    given = formats.load("davis").parse(masks(), LIKE, NAMES)
    chosen = formats.load(name)
    check_labels(chosen.parse(chosen.dump(given, formats.regions(given), names), LIKE, names), tracks)


# The plan


def test_one_bad_shape_is_skipped_and_reported(tracks):
    bad = '<polygon frame="2" keyframe="1" outside="0" occluded="0" points="1,x"/>'
    content = cvat(track(0, *ENDS), track(1, bad), track(2, '<box frame="0"/>'))
    with pytest.warns(SkippedWarning, match=r"frame 2.*points.*a box"):
        found = formats.load("cvat").parse(content, LIKE, NAMES)
    check_labels(found, tracks)
    plan = formats.plan("cvat", content, LIKE, NAMES)
    assert len(plan.skipped) == 2
    assert any("skipped: " in line for line in plan.lines())


EMPTY = {
    "cvat": b"<annotations><version>1.1</version></annotations>",
    "coco": b'{"images": [{"id": 1, "file_name": "000000.png"}], "categories": [], "annotations": []}',
    "davis": zipped(**{f"{k:06d}.png": mask(k, 0) for k in range(F)}),
    "labelme": zipped(**{"000000.json": b'{"shapes": []}'}),
    "mots_txt": b"",
}


@pytest.mark.parametrize("name", EMPTY)
def test_a_file_without_objects_is_doubtful(name):
    plan = formats.plan(name, EMPTY[name], LIKE, NAMES)
    assert plan.doubts == ["the file shows no object"]


def test_a_plan_says_what_an_import_does():
    content = cvat(track(0, *LONG), meta=task(more=RANGE, pictures=(640, 480)))
    text = "\n".join(formats.plan("cvat", content, LIKE, NAMES).lines())
    for word in ("1 object drawn in 2 of 8 frames (0, 7): car 1", "640x480", "frame 40", "tracks"):
        assert word in text
    plan = formats.plan("davis", masks(range(7)), LIKE, FROM_ONE)
    assert "000000.png" in plan.doubts[0]
    assert plan.frames == (0, 1, 2, 3, 4, 5)


def twice(*places, ids=(1, 2)):
    """COCO with an outline at each place (dx) of frame 0, and their ids."""
    boxes = [np.ravel(outline(0, dx=dx)).tolist() for dx in places]
    shapes = [{"image_id": 0, "track_id": k, "segmentation": [b]} for k, b in zip(ids, boxes, strict=True)]
    return json.dumps({"images": [{"id": 0, "file_name": NAMES[0]}], "annotations": shapes}).encode()


BOUNDED = track(0, shape(0, outline(0)), shape(3, outline(3), outside=1))
LATER = shape(5, outline(0, dx=120)), shape(7, outline(2, dx=120))


@pytest.mark.parametrize(
    ("name", "content", "note"),
    [
        ("coco", twice(0, 8), "object 1 and object 2 have different motions in the same place in frame 0"),
        ("coco", twice(0, 90), ""),
        ("coco", twice(0, 150, ids=(4, 4)), "2 shapes of id 4 in frame 0 are parts of one object"),
        ("cvat", cvat(BOUNDED, track(1, *LATER)), "begin after track[0] has ended: track[1]; they are other"),
        ("cvat", cvat(BOUNDED, track(1, *LATER, label="van")), ""),
    ],
    ids=["doubled", "neighbours", "parts", "returns", "another label"],
)
def test_a_plan_says_which_objects_may_be_one(name, content, note):
    said = [
        line
        for line in formats.plan(name, content, LIKE, NAMES).notes
        if re.search("place|parts|begin", line)
    ]
    assert [note in line for line in said] == [True] * bool(note)


def test_parts_keep_their_places_whatever_the_order_in_which_they_are_found(tracks):
    """A pole hides the middle of a car; in the last frame the right half is found first."""
    pictures = {}
    for frame, up in ((0, 0), (F - 1, 1)):
        picture = np.zeros((240, 320), np.uint8)
        picture[80:160, 60 + 5 * frame : 100 + 5 * frame] = 1
        picture[80 - up : 160, 120 + 5 * frame : 160 + 5 * frame] = 1
        pictures[f"{frame:06d}.png"] = cv2.imencode(".png", picture)[1].tobytes()
    plan = formats.plan("davis", zipped(**pictures), LIKE, NAMES)
    [item] = plan.annotation.objects
    first, last = ([np.mean(p, axis=0)[0] for p in k.polygons] for k in item.key_frames if k.polygons)
    assert len(first) == len(last) == 2
    assert np.argsort(first).tolist() == np.argsort(last).tolist()


def test_a_person_decides_about_shift_and_scale(tracks):
    plan = formats.plan("davis", masks(), LIKE, FROM_ONE, Choices(shift=1))
    assert not plan.doubts
    check_labels(plan.annotation, tracks)
    content = cvat(track(0, shape(0, outline(0, 2)), shape(7, outline(7, 2))))
    plan = formats.plan("cvat", content, LIKE, NAMES, Choices(scale=0.5))
    assert not plan.doubts
    check_labels(plan.annotation, tracks)
    plan = formats.plan("cvat", cvat(track(0, *LONG)), LIKE, NAMES, Choices(shift=-40))
    check_labels(plan.annotation, tracks)
    later = zipped(**{f"{k + 5:06d}.json": labelme(k) for k in range(F)})  # the imagePath names frame k
    plan = formats.plan("labelme", later, LIKE, NAMES, Choices(shift=-5))
    assert not plan.doubts
    check_labels(plan.annotation, tracks)
    plan = formats.plan("davis", masks(), LIKE, NAMES, Choices(scale=0.5))
    assert "not by the factor" in " ".join(plan.notes)
    check_labels(plan.annotation, tracks)


@pytest.mark.parametrize("choices", [{"scale": 0.0}, {"scale": float("nan")}, {"shift": 10**9}])
def test_absurd_choices(choices):
    with pytest.raises(KT3DMoSegError, match=next(iter(choices))):
        Choices(**choices)


def test_a_third_party_s_format_has_a_plan_too(monkeypatch):
    class Theirs:
        suffix, media_type = ".x", "text/plain"

        @staticmethod
        def parse(content, like, names):
            return replace(like, annotator=content.decode())

    monkeypatch.setattr(formats, "load", lambda name: Theirs)
    assert formats.plan("theirs", b"me", LIKE).annotation.annotator == "me"


# What is not read, or not drawn


RLE = encode_rle(np.eye(H, W, dtype=bool))
BOX_ONLY = {"segmentation": [], "bbox": [1, 1, 5, 5]}


def without_outlines(content, *frames):
    data = json.loads(content)
    for item in data["annotations"]:
        item |= BOX_ONLY if item["image_id"] - 1 in frames else {}
    return json.dumps(data).encode()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("coco", without_outlines(coco({"track_id": 1}), 4, 5, 6, 7)),
        ("coco", without_outlines(coco({}), 2)),
        (
            "labelme",
            zipped(**{f"{k:06d}.json": labelme(k, shape_type=("polygon", "line")[k == 3]) for k in range(F)}),
        ),
        ("cvat", cvat(*[image(k, drawn(outline(k), tag="polygon" if k < 5 else "box")) for k in range(F)])),
        (
            "mots_txt",
            "".join(f"{k} 1001 1 {H} {W} {RLE if k != 2 else RLE[:-3]}\n" for k in range(F)).encode(),
        ),
    ],
)
def test_an_object_is_not_gone_where_a_shape_of_it_is_skipped(name, content):
    plan = formats.plan(name, content, LIKE, NAMES)
    (item,) = plan.annotation.objects
    assert plan.skipped
    assert {key.visibility for key in item.key_frames} == {"visible"}
    assert "no object is seen" not in " ".join(plan.notes)


@pytest.mark.parametrize("drawing", ["coco", "cvat"])
def test_a_frame_left_out_among_drawn_ones_makes_those_at_the_end_doubtful(drawing):
    frames = (0, 1, 2, 3, 5)
    images = [image(k, drawn(outline(k)) * (k in frames)) for k in range(F)]
    content = coco({"track_id": 1}, frames=frames) if drawing == "coco" else cvat(*images)
    (doubt,) = formats.plan(drawing, content, LIKE, NAMES).doubts
    assert doubt == "frames without a shape (4, 6-7) are taken as not annotated: objects stay in them"


def test_one_id_for_two_labels_is_doubtful_in_different_frames_too():
    data = json.loads(coco({"track_id": 1}))
    for annotation in data["annotations"][4:]:
        annotation["category_id"] = 2
    (doubt,) = formats.plan("coco", json.dumps(data).encode(), LIKE, NAMES).doubts
    assert doubt == "shapes of several labels have one id, 1: car, other"


def test_one_id_for_two_numbered_labels_in_a_frame_is_doubtful():
    shapes = [drawn(outline(0, dx=d), label=f"car {d}").replace("/>", f">{ID}</polygon>") for d in (0, 1)]
    (doubt,) = formats.plan("cvat", cvat(image(0, *shapes)), LIKE, NAMES).doubts
    assert doubt == "shapes of several labels have one id, 7: car 0, car 1"


def test_what_coco_says_is_occluded_is():
    found = formats.load("coco").parse(coco({"attributes": {"occluded": True, "track_id": 0}}), LIKE, NAMES)
    assert {key.visibility for key in found.objects[0].key_frames} == {"occluded"}


def test_masks_of_davis_are_not_read_as_mots():
    with pytest.raises(KT3DMoSegError, match="gray PNG of 16 bits, found 8 bits; import it as davis"):
        formats.plan("mots_png", masks(), LIKE, NAMES)


def test_a_task_of_fewer_frames_is_asked_about():
    content = cvat(track(0, *[shape(k, outline(k)) for k in range(4)]), meta=task(size=4))
    (doubt,) = formats.plan("cvat", content, LIKE, NAMES).doubts
    assert doubt == "the task has 4 of the clip's 8 frames, 0 to 3, unless it was made of later ones"
    assert not formats.plan("cvat", content, LIKE, NAMES, Choices(shift=0)).doubts


def test_objects_of_one_motion_keep_it_through_mots():
    key = formats.load("coco").parse(coco({"track_id": 1}), LIKE, NAMES).objects[0]
    shadow = replace(
        key,
        id=2,
        kind="other",
        key_frames=tuple(
            replace(k, polygons=(((1.0, 1.0), (9.0, 1.0), (9.0, 9.0)),)) for k in key.key_frames
        ),
    )
    annotation = replace(LIKE, objects=(key, shadow))
    content = formats.load("mots_png").dump(annotation, formats.regions(annotation), NAMES)
    assert formats.load("mots_png").parse(content, LIKE, NAMES).motions == [1]
