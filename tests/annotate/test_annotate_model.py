"""The model, its JSON, and the agreement of schema and reader."""

from __future__ import annotations

import copy
import json
from pathlib import Path

import jsonschema
import pytest
from annotation_scenes import annotations, box, scene
from hypothesis import given, settings

from kt3dmoseg.annotate import AnnotatedObject, KeyFrame, load_annotation, save_annotation
from kt3dmoseg.annotate.model import dumps, from_json, json_schema, to_json
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError

ROOT = Path(__file__).parents[2]
FILES = sorted((ROOT / "annotations").rglob("*_*lip*.json"))
SCHEMA = json.loads((ROOT / "annotations" / "SCHEMA.json").read_text())


def schema_accepts(data) -> bool:
    return jsonschema.Draft202012Validator(SCHEMA).is_valid(data)


def test_file_round_trip(tmp_path):
    save_annotation(tmp_path / "a.json", scene())
    assert load_annotation(tmp_path / "a.json") == scene()


@settings(max_examples=60, deadline=None)
@given(annotations())
def test_every_annotation_survives_json_and_fits_the_schema(annotation):
    data = json.loads(dumps(annotation))
    assert from_json(data) == annotation
    assert data == to_json(annotation)
    assert schema_accepts(data)


def test_every_polygon_has_a_line_of_its_own():
    assert "      [[60.25, 8.0], [80.25, 8.0], [80.25, 24.0], [60.25, 24.0]],\n" in dumps(scene())


def test_names_may_hold_anything(tmp_path):
    tricky = AnnotatedObject(1, 'a "\0 0" \\u0000', "car", 1, (KeyFrame(0, polygons=(box(1, 1),)),))
    annotation = type(scene())("c\0", (9, 9), 2, (tricky,))
    save_annotation(tmp_path / "a.json", annotation)
    assert load_annotation(tmp_path / "a.json") == annotation


def change(data, path, value):
    out = copy.deepcopy(data)
    *way, last = path
    target = out
    for step in way:
        target = target[step]
    if value is KeyError:
        del target[last]
    else:
        target[last] = value
    return out


BAD = [
    (("format",), "coco", "format"),
    (("version",), 2, "version"),
    (("clip",), KeyError, "clip"),
    (("clip",), " ", "clip"),
    (("revision",), -1, "revision"),
    (("revision",), True, "revision"),
    (("n_frames",), 2.5, "n_frames"),
    (("image_size",), [96], "image_size"),
    (("image_size",), [96, "64"], r"image_size\[1\]"),
    (("objects",), {}, "objects"),
    (("colour",), 1, "colour"),
    (("objects", 1, "kind"), "cra", "kind"),
    (("objects", 1, "motion"), -1, r"objects\[1\].motion"),
    (("objects", 1, "motion"), "no", r"objects\[1\].motion"),
    (("objects", 1, "motion"), 1.5, r"objects\[1\].motion"),
    (("objects", 1, "name"), "", r"objects\[1\].name"),
    (("objects", 1, "key_frames"), [], r"objects\[1\].key_frames"),
    (("objects", 1, "key_frames", 0, "frame"), -1, r"objects\[1\].key_frames\[0\].frame"),
    (("objects", 1, "key_frames", 0, "visibility"), "gone", r"key_frames\[0\].visibility"),
    (("objects", 1, "key_frames", 0, "polygons", 0), [[0, 0], [1, 1]], r"key_frames\[0\].polygons\[0\]"),
    (("objects", 1, "key_frames", 0, "polygons", 0, 2), [1], r"polygons\[0\]\[2\]"),
    (("objects", 1, "key_frames", 0, "polygons", 0, 2), [1, "2"], r"polygons\[0\]\[2\]"),
    (("objects", 1, "key_frames", 0, "polygons", 0, 2), [1, 1e9], r"polygons\[0\]\[2\]"),
    (("marks", 0, "polygon"), "x", r"marks\[0\].polygon"),
]

# What a JSON schema cannot express.
BEYOND_SCHEMA = [
    (("objects", 1, "id"), 1, r"objects\[1\].id"),
    (("objects", 1, "key_frames", 0, "frame"), 99, r"objects\[1\].key_frames\[.\].frame"),
    (("objects", 1, "key_frames", 0, "frame"), 2, r"objects\[1\].key_frames"),
    (("objects", 1, "key_frames", 0, "polygons"), [], r"objects\[1\].key_frames\[0\].polygons"),
    (("objects", 1, "key_frames", 0, "visibility"), "outside", r"key_frames\[0\].polygons"),
    (("marks", 0, "frame"), 5, r"marks\[0\].frame"),
]


@pytest.mark.parametrize(("path", "value", "field"), BAD + BEYOND_SCHEMA)
def test_errors_name_the_field(path, value, field):
    with pytest.raises(InvalidValueError, match=field):
        from_json(change(to_json(scene()), path, value))


@pytest.mark.parametrize(("path", "value", "field"), BAD)
def test_schema_refuses_the_same(path, value, field):
    assert not schema_accepts(change(to_json(scene()), path, value))


def test_infinite_coordinates_are_refused(tmp_path):
    for number, word in (("Infinity", "Infinity"), ("1e400", "polygons"), ("9" * 400, "400 digits")):
        (tmp_path / "a.json").write_text(dumps(scene()).replace("60.25", number))
        with pytest.raises(FileFormatError, match=rf"a\.json.*{word}"):
            load_annotation(tmp_path / "a.json")


@pytest.mark.parametrize("content", ["", "[", "null", "[]", '"x"', "[" * 100_000, "\xff"])
def test_files_that_are_no_annotation(tmp_path, content):
    (tmp_path / "a.json").write_bytes(content.encode("latin-1"))
    with pytest.raises(FileFormatError, match=r"a\.json"):
        load_annotation(tmp_path / "a.json")


def test_missing_file(tmp_path):
    with pytest.raises(InputFileError, match="none"):
        load_annotation(tmp_path / "none.json")


@pytest.mark.parametrize("file", FILES, ids=lambda file: f"{file.parent.name}-{file.stem}")
def test_our_annotations_follow_the_schema_and_are_saved_as_they_were(file):
    text = file.read_text()
    found = load_annotation(file)
    assert schema_accepts(json.loads(text))
    assert found.clip == file.stem
    assert json.loads(dumps(found)) == json.loads(text)
    if '"image_size": [1242, 375],' in text:  # the layout of the present writer
        assert dumps(found) == text


def test_the_schema_is_made_from_the_models():
    # Write it again with: print(json.dumps(json_schema(), indent=1))
    assert json_schema() == SCHEMA
