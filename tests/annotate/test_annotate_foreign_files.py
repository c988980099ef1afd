"""Files as other tools write them, and ours as those tools read them."""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from annotation_scenes import FRAMES, SIZE, motions, scene, zipped

from kt3dmoseg.annotate import formats
from kt3dmoseg.annotate.formats.masks import encode_rle, mask_of
from kt3dmoseg.annotate.model import REJECT

EMPTY = replace(scene(), objects=(), marks=())


def test_foreign_cvat_tracks_become_objects():
    text = b"""<annotations><track id="0" label="Car">
      <polygon frame="1" outside="0" occluded="0" keyframe="1" points="1,1;9,1;9,9"/>
      <polygon frame="2" outside="0" occluded="0" keyframe="0" points="2,1;9,1;9,9"/>
      <polygon frame="3" outside="1" occluded="0" keyframe="1" points="2,1;9,1;9,9"/></track>
      <track id="1" label="unicorn"><polygon frame="0" points="1,1;9,1;9,9"/></track></annotations>"""
    car, other = formats.load("cvat").parse(text, EMPTY).objects
    assert [(k.frame, k.visibility) for k in car.key_frames] == [
        (0, "outside"),
        (1, "visible"),
        (3, "outside"),
    ]
    assert (car.kind, car.motion, other.kind, other.motion) == ("car", 1, "other", 2)


def test_foreign_mots_ids_of_two_classes_are_two_motions():
    mask = np.zeros((SIZE[1], SIZE[0]), bool)
    mask[:5, :5] = True
    lines = f"0 1001 1 64 96 {encode_rle(mask)}\n0 2001 2 64 96 {encode_rle(~mask)}\n"
    found = formats.load("mots_txt").parse(lines.encode(), EMPTY).objects
    assert [(o.kind, o.motion) for o in found] == [("car", 1), ("pedestrian", 2)]


def test_foreign_coco_polygons():
    data = {
        "images": [{"id": 2}, {"id": 3}],
        "categories": [{"id": 1, "name": "Car"}],
        "annotations": [
            {"image_id": 3, "category_id": 1, "track_id": 5, "segmentation": [[1, 1, 9, 1, 9, 9]]}
        ],
    }
    (item,) = formats.load("coco").parse(json.dumps(data).encode(), EMPTY).objects
    assert (item.kind, item.motion, [k.frame for k in item.key_frames]) == ("car", 1, [2, 3])


CVAT_EXPORT = b"""<?xml version="1.0" encoding="utf-8"?>
<annotations>
  <version>1.1</version>
  <meta>
    <task>
      <id>7</id><name>drive</name><size>5</size><mode>interpolation</mode><overlap>2</overlap>
      <bugtracker></bugtracker><created>2026-01-02 03:04:05.678901+00:00</created>
      <start_frame>0</start_frame><stop_frame>4</stop_frame><frame_filter></frame_filter>
      <labels><label><name>van</name><color>#fa3253</color><type>any</type>
        <attributes><attribute><name>parked</name><mutable>False</mutable><input_type>checkbox</input_type>
          <default_value>false</default_value><values>false</values></attribute></attributes></label></labels>
      <segments><segment><id>3</id><start>0</start><stop>4</stop><url>http://localhost/api/jobs/3</url>
      </segment></segments>
      <owner><username>me</username><email></email></owner><assignee></assignee>
      <original_size><width>96</width><height>64</height></original_size><source>drive.mp4</source>
    </task>
    <dumped>2026-01-03 03:04:05.678901+00:00</dumped>
  </meta>
  <track id="4" label="van" source="manual">
    <polygon frame="0" keyframe="1" outside="0" occluded="0"
      points="10.50,20.50;30.50,20.50;30.50,40.50" z_order="0">
      <attribute name="parked">false</attribute>
    </polygon>
    <polygon frame="1" keyframe="0" outside="0" occluded="0"
      points="11.50,20.50;31.50,20.50;31.50,40.50" z_order="0">
      <attribute name="parked">false</attribute>
    </polygon>
    <polygon frame="2" keyframe="1" outside="0" occluded="1"
      points="12.50,20.50;32.50,20.50;32.50,40.50" z_order="0">
      <attribute name="parked">false</attribute>
    </polygon>
    <polygon frame="3" keyframe="1" outside="1" occluded="0"
      points="12.50,20.50;32.50,20.50;32.50,40.50" z_order="0">
      <attribute name="parked">false</attribute>
    </polygon>
  </track>
</annotations>
"""


@pytest.mark.parametrize("packed", [False, True])
def test_what_cvat_offers_for_download(packed):
    content = zipped(**{"annotations.xml": CVAT_EXPORT}) if packed else CVAT_EXPORT
    (van,) = formats.load("cvat").parse(content, EMPTY).objects
    assert (van.name, van.kind, van.motion) == ("van 1", "van", 1)
    assert [(k.frame, k.visibility) for k in van.key_frames] == [
        (0, "visible"),
        (2, "occluded"),
        (3, "outside"),
    ]
    # CVAT counts from the corner of the first pixel, we from its centre.
    assert van.key_frames[0].polygons == (((10.0, 20.0), (30.0, 20.0), (30.0, 40.0)),)


def test_cvat_gets_the_fields_that_it_writes_itself():
    root = ElementTree.fromstring(formats.load("cvat").dump(scene(), formats.regions(scene())))
    theirs = ElementTree.fromstring(CVAT_EXPORT)
    assert root.findtext("version") == "1.1"
    for path in ("meta/task/mode", "meta/task/labels/label/name", "meta/task/original_size/width"):
        assert root.find(path) is not None
        assert theirs.find(path) is not None
    for path in ("track", "track/polygon", "track/polygon/attribute"):
        assert set(root.find(path).keys()) == set(theirs.find(path).keys())
    frames = [int(shape.get("frame")) for shape in root.find("track")]
    assert frames == list(range(FRAMES))
    assert "60.75,8.50" in root.find("track/polygon").get("points")


def test_cvat_gets_well_formed_xml_whatever_the_name():
    (item, *_), chosen = scene().objects, formats.load("cvat")
    odd = replace(scene(), objects=(replace(item, name='a\x00\x1b\uffff <b> ]]> & "é" 🚗'),))
    (back,) = chosen.parse(chosen.dump(odd, formats.regions(odd)), EMPTY).objects
    assert back.name == 'a\ufffd\ufffd\ufffd <b> ]]> & "é" 🚗'


NAMES = [f"{k:06d}.png" for k in range(1, FRAMES + 1)]


def test_labelme_files_are_named_as_their_frames():
    chosen = formats.load("labelme")
    content = chosen.dump(scene(), formats.regions(scene()), NAMES)
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        assert archive.namelist()[0] == "000001.json"
        first = json.loads(archive.read("000001.json"))
    fields = {"version", "flags", "shapes", "imagePath", "imageData", "imageHeight", "imageWidth"}
    assert set(first) == fields
    assert first["imagePath"] == "000001.png"
    assert motions(chosen.parse(content, EMPTY, NAMES)) == motions(scene())


def labelme(**fields):
    shape = {"label": "car", "points": [[1, 2], [9, 8]], "group_id": None, "shape_type": "rectangle"}
    return json.dumps({"version": "5.5.0", "flags": {}, "shapes": [shape | fields], "imageData": None})


def test_one_labelme_file_belongs_to_the_frame_of_its_name():
    # Numbers alone would take 000003 for the fourth frame; a Mac adds files of its own.
    content = zipped(**{"000003.json": labelme(), "__MACOSX__._000003.json": "x"})
    (item,) = formats.load("labelme").parse(content, EMPTY, NAMES).objects
    drawn = [k for k in item.key_frames if k.visibility == "visible"]
    assert [k.frame for k in drawn] == [2]
    assert drawn[0].polygons == (((0.5, 1.5), (8.5, 1.5), (8.5, 7.5), (0.5, 7.5)),)


@pytest.mark.parametrize("name", ["davis", "mots_png"])
def test_masks_named_as_frames_belong_to_those(name):
    chosen = formats.load(name)
    content = chosen.dump(scene(), formats.regions(scene()))
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        images = [archive.read(annotation) for annotation in sorted(archive.namelist())]
    renamed = zipped(**dict(zip(NAMES, images, strict=True)))
    assert motions(chosen.parse(renamed, EMPTY, NAMES)) == motions(chosen.parse(content, EMPTY))


def test_coco_images_named_as_frames_are_those():
    annotation = {"image_id": 8, "category_id": 1, "segmentation": [[1, 1, 9, 1, 9, 9]]}
    data = {"images": [{"id": 8, "file_name": "left/000004.png"}], "annotations": [annotation]}
    (item,) = formats.load("coco").parse(json.dumps(data).encode(), EMPTY, NAMES).objects
    assert [k.frame for k in item.key_frames if k.visibility == "visible"] == [3]


def test_coco_opens_in_pycocotools(tmp_path):
    from pycocotools.coco import COCO

    (tmp_path / "x.json").write_bytes(formats.load("coco").dump(scene(), formats.regions(scene()), NAMES))
    theirs = COCO(str(tmp_path / "x.json"))
    regions = formats.regions(scene())
    assert theirs.loadImgs([0])[0]["file_name"] == "000001.png"
    annotations = theirs.loadAnns(theirs.getAnnIds())
    assert {e["track_id"] for e in annotations} == {1, 3, 4}
    for annotation in annotations:
        region = regions[annotation["track_id"]][annotation["image_id"]]
        mask = theirs.annToMask(annotation)
        assert (mask == mask_of(region.polygons, SIZE)).all()
        assert annotation["area"] == mask.sum()


def test_coco_polygons_fill_the_pixels_that_pycocotools_fills():
    from pycocotools import mask as theirs

    box = [2.0, 3.0, 8.0, 3.0, 8.0, 12.0, 2.0, 12.0]
    expected = theirs.decode(theirs.frPyObjects([box], SIZE[1], SIZE[0]))[..., 0].astype(bool)
    data = {"images": [{"id": 0}], "annotations": [{"image_id": 0, "segmentation": [box]}]}
    (item,) = formats.load("coco").parse(json.dumps(data).encode(), EMPTY).objects
    assert (mask_of([np.array(p) for p in item.key_frames[0].polygons], SIZE) == expected).all()


def test_a_line_of_the_mots_page_is_read():
    """The layout of https://www.vision.rwth-aachen.de/page/mots: time_frame id class_id height width rle."""
    from pycocotools import mask as theirs

    mask = np.zeros((SIZE[1], SIZE[0]), np.uint8)
    mask[10:20, 30:50] = 1
    text = theirs.encode(np.asfortranarray(mask))["counts"].decode()
    lines = f"2 1005 1 {SIZE[1]} {SIZE[0]} {text}\n2 10000 10 {SIZE[1]} {SIZE[0]} {text}\n"
    car, ignored = formats.load("mots_txt").parse(lines.encode(), EMPTY).objects
    assert (car.kind, car.motion, ignored.motion) == ("car", 5, REJECT)
    assert (mask_of([np.array(p) for p in car.key_frames[1].polygons], SIZE) == mask).all()
