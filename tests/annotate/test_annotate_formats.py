"""Formats of other tools: export then import is identity, within what each format can hold."""

from __future__ import annotations

import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest
from annotation_scenes import FRAMES, SIZE, annotations, box, motions, scene, zipped
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from kt3dmoseg.annotate import AnnotatedObject, Annotation, KeyFrame, formats
from kt3dmoseg.annotate.formats.masks import (
    decode_rle,
    encode_rle,
    mask_of,
    polygons_of,
)
from kt3dmoseg.errors import KT3DMoSegError, MissingDependencyError
from kt3dmoseg.io.images import davis_palette, decode_indices, encode_indices

ALL = formats.FORMATS.names()
EMPTY = replace(scene(), objects=(), marks=())


def cycle(name, annotation):
    chosen = formats.load(name)
    # As `parse` does, also where it doubts: all that is drawn may lie in the first pixel.
    return chosen.plan(chosen.dump(annotation, formats.regions(annotation)), annotation.emptied()).annotation


@pytest.mark.parametrize("name", ALL)
def test_same_bytes_every_time(name):
    chosen = formats.load(name)
    assert chosen.dump(scene(), formats.regions(scene())) == chosen.dump(scene(), formats.regions(scene()))


@pytest.mark.parametrize("name", ALL)
def test_no_objects(name):
    assert cycle(name, replace(scene(), objects=())).objects == ()


@pytest.mark.parametrize("name", ALL)
def test_pixels_keep_their_motion(name):
    assert motions(cycle(name, scene())) == motions(scene())


@settings(max_examples=30, deadline=None)
@given(annotations())
def test_cvat_keeps_objects_key_frames_and_polygons(annotation):
    # Its one limit: what is occluded somewhere unknown is one hidden shape.
    assert cycle("cvat", annotation).objects == annotation.objects


@settings(max_examples=15, deadline=None)
@given(annotations())
def test_labelme_keeps_the_regions_of_every_frame(annotation):
    before, back = formats.regions(annotation), cycle("labelme", annotation)
    after = formats.regions(back)
    for item in annotation.objects:
        for frame in range(FRAMES):
            old = before[item.id][frame].polygons
            new = after[item.id][frame].polygons if item.id in after else []
            # The file has hundredths of a pixel from the corner: halves of them go up or down.
            for one, other in zip(old, new, strict=True):
                np.testing.assert_allclose(other, one, rtol=0, atol=0.00501)


@settings(max_examples=15, deadline=None)
@given(annotations())
def test_coco_keeps_the_pixels_of_every_object(annotation):
    before, back = formats.regions(annotation), cycle("coco", annotation)
    after = formats.regions(back)
    for item in annotation.objects:
        for frame, region in enumerate(before[item.id]):
            old = mask_of(region.polygons if region.visibility == "visible" else [], SIZE)
            new = mask_of(after[item.id][frame].polygons if item.id in after else [], SIZE)
            assert (old == new).all()
        if item.id in after:
            (same,) = (other for other in back.objects if other.id == item.id)
            assert (same.name, same.kind, same.motion) == (item.name, item.kind, item.motion)


@pytest.mark.parametrize("name", ["davis", "mots_png", "mots_txt"])
@settings(max_examples=10, deadline=None)
@given(annotation=annotations())
def test_label_images_keep_the_motion_of_every_pixel(name, annotation):
    # One kind: MOTS has objects of two classes apart even when they share a motion.
    alike = replace(annotation, objects=tuple(replace(o, kind="car") for o in annotation.objects))
    assert motions(cycle(name, alike)) == motions(alike)


@settings(max_examples=60, deadline=None)
@given(hnp.arrays(np.bool_, st.tuples(st.integers(1, 12), st.integers(1, 12))))
def test_masks_to_polygons_and_back(mask):
    height, width = mask.shape
    back = mask_of([np.array(p) for p in polygons_of(mask)], (width, height))
    assert (back == mask).all()


@settings(max_examples=60, deadline=None)
@given(hnp.arrays(np.bool_, st.tuples(st.integers(1, 40), st.integers(1, 40))))
def test_rle_is_that_of_pycocotools(mask):
    from pycocotools import mask as theirs

    text = theirs.encode(np.asfortranarray(mask.astype(np.uint8)))["counts"].decode()
    assert encode_rle(mask) == text
    assert (decode_rle(text, *mask.shape) == mask).all()


@pytest.mark.parametrize(
    "text", ["~~", "P", "1", "0" * 40 + "P", "\x00", "ooooooooooooo", "@0\0", "@0é", "?", "A"]
)
def test_damaged_rle(text):
    with pytest.raises(KT3DMoSegError):
        decode_rle(text, 4, 4)


@pytest.mark.parametrize("runs", [[16], [0, 16], [3, 0, 5, 8], [1, 1, 1, 13, 0]])
def test_run_lengths_as_numbers(runs):
    flat = [k % 2 == 1 for k, run in enumerate(runs) for _ in range(run)]
    assert decode_rle(runs, 4, 4).ravel(order="F").tolist() == flat


@pytest.mark.parametrize("runs", [[], [15], [17], [18, -2]])
def test_run_lengths_that_do_not_fill_the_mask(runs):
    with pytest.raises(KT3DMoSegError, match="4x4"):
        decode_rle(runs, 4, 4)


def test_without_pycocotools_the_message_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "pycocotools.mask", None)
    with pytest.raises(MissingDependencyError, match=r"kt3dmoseg\[label\]"):
        encode_rle(np.ones((2, 2), bool))


def test_indexed_png_is_what_opencv_and_palette_say():
    image = np.arange(256, dtype=np.uint8).reshape(16, 16)
    content = encode_indices(image, davis_palette())
    assert (decode_indices(content, "x")[0] == image).all()
    colours = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
    assert colours[0, 1].tolist() == [0, 0, 128]  # BGR: DAVIS's first object is dark red


def test_a_simplified_outline_keeps_corners():
    mask = np.ones((12, 20), bool)
    mask[0, 5:7] = mask[8:10, 19] = False
    (polygon,) = polygons_of(mask, tolerance=1.5)
    assert set(polygon) == {(-0.5, -0.5), (19.5, -0.5), (19.5, 11.5), (-0.5, 11.5)}
    assert len(polygons_of(mask)[0]) == 12


def indexed(height, width):
    return encode_indices(np.zeros((height, width), np.uint8), davis_palette())


BOMB = b"""<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "x"><!ENTITY c "&b;&b;&b;">]>
<annotations>&c;</annotations>"""
XXE = b"""<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]><annotations>&b;</annotations>"""

HOSTILE = [
    ("cvat", BOMB),
    ("cvat", BOMB.decode().encode("utf-16")),
    ("cvat", XXE),
    ("cvat", b"<a>" * 100_000),
    ("cvat", b"<other/>"),
    ("cvat", b"<annotations><track label='car'><box frame='0'/></track></annotations>"),
    (
        "cvat",
        b"<annotations><track label='car'><polygon frame='99' points='1,1;2,2;3,1'/></track></annotations>",
    ),
    ("cvat", b"<annotations><track label='car'><polygon frame='0' points='1,x'/></track></annotations>"),
    (
        "cvat",
        b"<annotations><track label='car'><polygon frame='0' points='1,1;nan,2;3,1'/></track></annotations>",
    ),
    ("davis", zipped(**{"00000.png": b"x"})),
    ("davis", zipped(**{"readme.png": indexed(64, 96)})),
    ("davis", zipped(**{"00009.png": indexed(64, 96)})),
    ("davis", zipped(**{"00000.png": indexed(9, 9)})),
    ("davis", zipped(**{"a__00000.png": b"x", "b__00000.png": b"x"})),
    ("davis", zipped()),
    ("davis", zipped(**{"00000.png": cv2.imencode(".png", np.zeros((64, 96), np.uint16))[1].tobytes()})),
    ("cvat", zipped(**{"a.xml": b"<annotations/>", "b.xml": b"<annotations/>"})),
    ("cvat", b"<annotations><track><polygon frame='-1' points='1,1;2,2;3,1'/></track></annotations>"),
    ("mots_txt", b"-1 1001 1 64 96 Qa0"),
    ("mots_png", zipped(**{"00000.png": cv2.imencode(".png", np.zeros((64, 96, 3), np.uint8))[1].tobytes()})),
    ("mots_txt", b"0 1001 1 64 96"),
    ("mots_txt", b"0 1001 1 9 9 Qa0"),
    ("mots_txt", b"0 1001 1 1000000000 1000000000 Qa0"),
    ("mots_txt", b"7 1001 1 64 96 Qa0"),
    ("coco", b"[]"),
    ("coco", b"{}"),
    ("coco", b'{"images": [{"id": 0}], "annotations": [{"image_id": 4, "segmentation": []}]}'),
    (
        "coco",
        b'{"images": [{"id": 0}], "annotations": ['
        b'{"image_id": 0, "segmentation": {"size": [9, 9], "counts": "x"}}]}',
    ),
    ("coco", b'{"images": [{"id": 0}], "annotations": [{"image_id": 0, "segmentation": [[1, 2, 3]]}]}'),
    ("labelme", zipped(**{"0.json": b"{}"})),
    ("labelme", zipped(**{"0.json": b"[" * 100_000})),
    ("labelme", zipped(**{"0.json": b'{"shapes": [{"label": "a", "points": [[1, 2]]}]}'})),
    ("labelme", zipped(**{"0.json": b'{"shapes": [{"label": "a", "shape_type": "circle", "points": []}]}'})),
]


MANY = np.arange(64 * 96, dtype=np.uint16).reshape(64, 96)
CROWDS = [
    ("mots_png", zipped(**{"000000.png": cv2.imencode(".png", MANY)[1].tobytes()}), "10 objects"),
    ("mots_txt", b"0 1001 1 64 96 PP6\n" * 51, "50 lines"),
    (
        "coco",
        b'{"images": [{"id": 0}], "annotations": ['
        + b",".join([b'{"image_id": 0, "segmentation": [[1, 1, 9, 1, 9, 9]]}'] * 11)
        + b"]}",
        "10 objects",
    ),
    ("coco", b'{"images": [], "annotations": [' + b",".join([b"{}"] * 51) + b"]}", "50 annotations"),
]


@pytest.mark.parametrize(("name", "content", "limit"), CROWDS)
def test_crowds_are_refused_before_they_fill_the_memory(name, content, limit, monkeypatch):
    for module in ("model", "formats.coco", "formats.foreign"):
        monkeypatch.setattr(f"kt3dmoseg.annotate.{module}.MAX_OBJECTS", 10)
    with pytest.raises(KT3DMoSegError, match=f"at most {limit}"):
        formats.load(name).parse(content, EMPTY)


def test_hundredths_of_a_pixel_that_fall_between_two_come_back():
    # -10.655 is rounded to -10.66, and to -10.65 when it is counted from the corner.
    keys = tuple(KeyFrame(k, polygons=(((x, 1.0),) * 3,)) for k, x in ((0, -10.66), (2, -10.65)))
    annotation = replace(EMPTY, objects=(AnnotatedObject(1, "a", "car", 1, keys),))
    (polygon,) = formats.regions(cycle("labelme", annotation))[1][1].polygons
    np.testing.assert_allclose(polygon, [[-10.655, 1.0]] * 3, rtol=0, atol=0.00501)


def test_of_very_many_parts_the_largest_are_kept():
    mask = np.zeros((60, 60), bool)
    mask[::2, ::2] = True
    mask[40:50, 40:50] = True
    polygons = polygons_of(mask)
    assert len(polygons) == 200
    assert max(np.ptp([x for x, _ in polygon]) for polygon in polygons) >= 10


def test_an_outline_of_very_many_corners_loses_details_not_itself():
    comb = np.ones((3, 6000), bool)
    comb[1:, ::2] = False
    (polygon,) = polygons_of(comb)
    assert 4000 <= len(polygon) <= 5000


@pytest.mark.parametrize(("name", "content"), HOSTILE)
def test_hostile_files_are_refused_in_one_line(name, content):
    with pytest.raises(KT3DMoSegError) as caught:
        formats.load(name).parse(content, EMPTY)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ALL)
@settings(max_examples=25, deadline=None)
@given(junk=st.binary(max_size=300))
def test_junk_is_refused(name, junk):
    with pytest.raises(KT3DMoSegError):
        formats.load(name).parse(junk, EMPTY)


@pytest.mark.parametrize("name", ALL)
def test_truncated_files_are_refused_or_shorter(name):
    chosen = formats.load(name)
    full = chosen.dump(scene(), formats.regions(scene()))
    for share in (0.1, 0.5, 0.9):
        try:
            found = chosen.parse(full[: int(share * len(full))], EMPTY)
        except KT3DMoSegError:
            continue
        assert name == "mots_txt"
        assert len(found.objects) <= len(scene().objects)


def test_zip_that_promises_too_much_is_refused():
    content = bytearray(zipped(**{"00000.png": b"x" * 100}))
    at = content.rindex(b"PK\x01\x02")
    content[at + 24 : at + 28] = (1 << 31).to_bytes(4, "little")
    with pytest.raises(KT3DMoSegError, match="at most"):
        formats.load("davis").parse(bytes(content), EMPTY)


def test_motions_that_a_format_cannot_hold():
    item = AnnotatedObject(1, "a", "car", 999, (KeyFrame(0, polygons=(box(1, 1),)),))
    annotation = Annotation("scene", SIZE, FRAMES, (item,))
    with pytest.raises(KT3DMoSegError, match="253"):
        cycle("davis", annotation)
    assert cycle("mots_png", annotation).motions == [999]
    larger = replace(annotation, objects=(replace(item, motion=1000),))
    with pytest.raises(KT3DMoSegError, match="at most 999"):
        cycle("mots_txt", larger)
