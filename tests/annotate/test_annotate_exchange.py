"""`kt3dmoseg annotations`: import, export, check and compare for one clip and for many."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from annotation_scenes import drawn_by_hand, write_clip, zipped

from kt3dmoseg.annotate import KeyFrame, Mark, formats, load_annotation, save_revision
from kt3dmoseg.annotate.exchange import compare_annotations, import_annotations
from kt3dmoseg.cli import main
from kt3dmoseg.io.images import write_moving

CORNERS = [(60, 70), (140, 70), (140, 130), (60, 130)]


def mask(k, dx=0):
    picture = np.zeros((200, 320), np.uint8)
    picture[70:130, 60 + 4 * k + dx : 140 + 4 * k + dx] = 1
    return cv2.imencode(".png", picture)[1].tobytes()


@pytest.fixture
def data(tmp_path):
    """Two clips, whose frames count from 1, and masks of both: a zip of one, a folder of the other."""
    write_clip(tmp_path, "one")
    write_clip(tmp_path, "two", frames=3, tracks=100)
    (tmp_path / "masks" / "two").mkdir(parents=True)
    (tmp_path / "masks" / "one.zip").write_bytes(zipped(**{f"{k + 1:06d}.png": mask(k) for k in range(6)}))
    for k in range(3):
        (tmp_path / "masks" / "two" / f"{k + 1:06d}.png").write_bytes(mask(k))
        (tmp_path / "masks" / "two" / f"._{k + 1:06d}.png").write_bytes(b"x")
    return tmp_path


def run(data, command, *words):
    return main(["annotations", command, *map(str, words), "--annotations", str(data / "notes")])


def load(data, *words, source="masks", clips="frames", format="davis"):
    return run(data, "import", data / source, data / clips, "--format", format, *words)


def test_masks_of_many_clips_become_their_annotations(data, capsys):
    assert load(data) == 0
    printed = capsys.readouterr().out
    assert printed.count("1 object drawn in") == 2
    for name, frames in (("one", 6), ("two", 3)):
        found = load_annotation(data / "notes" / f"{name}.json")
        assert [k.frame for k in found.objects[0].key_frames] == list(range(frames))
        assert found.revision == 1


def test_what_a_source_lacks_and_has_in_addition_is_reported(data, capsys):
    (data / "masks" / "two").rename(data / "masks" / "Two")
    assert load(data) == 0
    assert "it has nothing of two\n  left out, of no clip: Two\n" in capsys.readouterr().out
    (data / "masks" / "one.zip").unlink()
    assert load(data, "--replace") == 2
    printed = capsys.readouterr().err
    assert "expected a file or folder named as a clip, found Two; the clips are one, two" in printed


def test_clip_files_need_no_frames(data):
    assert load(data, "--shift", "-1", clips="tracks") == 0  # without frames they are numbered from 0
    assert len(load_annotation(data / "notes" / "one.json").objects[0].key_frames) == 6


def test_a_video_is_a_clip(data):
    write_moving(data / "one.mp4", [np.full((200, 320, 3), 50 * k, np.uint8) for k in range(6)], 10)
    drawn_by_hand(data / "notes" / "one.json", "box", CORNERS)
    words = ("-o", data / "out", "--format", "davis")
    assert run(data, "export", data / "one.mp4", *words) == 0
    assert load(data, "--replace", source="out", clips="one.mp4") == 0
    assert run(data, "check", data / "one.mp4") == 0
    assert len(compare_annotations(data / "notes", data / "notes", data / "one.mp4")) == 1


def test_one_file_is_not_of_every_clip(data, capsys):
    (data / "masks" / "two").rename(data / "two")
    assert load(data, source="masks/one.zip") == 2
    assert "one.zip is one file for 2 clips, and does not name one" in capsys.readouterr().out
    assert not list((data / "notes").glob("*.json"))
    assert load(data, source="masks/one.zip", clips="frames/one") == 0


def test_given_tracks_take_the_place_of_those_in_clip_files(data, capsys):
    assert load(data) == 0
    lines = {}
    for tracks in ("tracks", "nothing"):
        code = run(data, "check", data / "tracks", "--tracks", data / tracks)
        lines[tracks] = code, "".join(capsys.readouterr())
    assert lines["tracks"][0] == 0
    assert lines["nothing"][0] == 2
    assert "nothing: expected tracks of one, two" in lines["nothing"][1]


def test_what_is_never_visible_is_missed_by_nobody(data, capsys):
    assert load(data) == 0
    path = data / "notes" / "one.json"
    annotation = load_annotation(path)
    hidden = replace(annotation.objects[0], id=7, name="hidden", key_frames=(KeyFrame(0, "outside"),))
    save_revision(path, replace(annotation, objects=(*annotation.objects, hidden)))
    capsys.readouterr()
    words = [data / "notes", data / "notes", data / "frames", "--json"]
    assert main(["annotations", "compare", *map(str, words)]) == 0
    found = {each["clip"]: each for each in json.loads(capsys.readouterr().out)}
    assert [pair["iou"] for pair in found["one"]["objects"]] == [1.0]


def test_a_dry_run_writes_nothing(data, capsys):
    assert load(data, "--dry-run") == 0
    assert "nothing written" in capsys.readouterr().out
    assert not (data / "notes").exists()


def test_what_is_drawn_is_not_written_over_unasked(data, capsys):
    drawn_by_hand(data / "notes" / "one.json", "by hand", CORNERS)
    before = (data / "notes" / "one.json").read_bytes()
    assert load(data) == 2
    printed = capsys.readouterr().out
    assert "one: failed" in printed
    assert "two:\n" in printed
    assert (data / "notes" / "one.json").read_bytes() == before
    assert load_annotation(data / "notes" / "two.json").objects
    assert load(data, "--merge") == 0
    found = load_annotation(data / "notes" / "one.json")
    assert [(item.id, item.name, item.motion) for item in found.objects] == [
        (1, "by hand", 1),
        (2, "motion 1", 2),
    ]
    assert load(data, "--replace") == 0
    assert [item.name for item in load_annotation(data / "notes" / "one.json").objects] == ["motion 1"]
    assert load(data, "--merge", "--replace") == 2


def test_what_somebody_saves_meanwhile_is_not_lost(data, monkeypatch):
    def drawn_meanwhile(name, content, current, *rest):
        if current.clip == "one":
            save_revision(path, replace(before, objects=(replace(before.objects[0], name="meanwhile"),)))
        return plan(name, content, current, *rest)

    path, plan = data / "notes" / "one.json", formats.plan
    before = drawn_by_hand(path, "before", CORNERS)
    monkeypatch.setattr(formats, "plan", drawn_meanwhile)
    one, two = import_annotations(
        data / "masks", data / "frames", format="davis", annotations=data / "notes", replace=True
    )
    assert not one.ok
    assert "revision" in one.lines[0]
    assert two.ok
    assert [item.name for item in load_annotation(path).objects] == ["meanwhile"]


def test_doubts_are_refused_until_a_person_decides(data, capsys):
    (data / "zero.zip").write_bytes(zipped(**{f"{k:06d}.png": mask(k) for k in range(6)}))
    clips = data / "frames" / "one"

    def attempt(*words):
        return run(data, "import", data / "zero.zip", clips, "--format", "davis", *words)

    assert attempt() == 2
    assert "000000.png" in capsys.readouterr().out
    assert not (data / "notes" / "one.json").exists()
    assert attempt("--dry-run") == 2
    assert attempt("--shift", "1") == 0
    assert len(load_annotation(data / "notes" / "one.json").objects[0].key_frames) == 6
    assert attempt("--replace", "--force") == 0
    assert load_annotation(data / "notes" / "one.json").objects[0].key_frames[0].frame == 0


@pytest.mark.parametrize("format", ["cvat", "coco", "labelme", "davis", "mots_png", "mots_txt"])
def test_export_and_import_again(data, format):
    assert load(data) == 0
    words = ("-o", data / "out", "--format", format, "--tracks", data / "tracks")
    assert run(data, "export", data / "frames", *words) == 0
    assert load(data, "--replace", source="out", format=format) == 0
    for found in compare_annotations(data / "notes", data / "notes", data / "frames"):
        assert [(pair.iou, pair.rank) for pair in found.objects] == [(1.0, 3)]


def test_check_finds_what_is_probably_a_mistake(data, capsys):
    assert load(data) == 0
    assert run(data, "check", data / "frames", "--tracks", data / "tracks") == 0
    assert "1 motion; trajectories:" in capsys.readouterr().out
    path = data / "notes" / "one.json"
    found = load_annotation(path)
    (item,) = found.objects
    off = replace(item.key_frames[0], polygons=(((500, 10), (520, 10), (520, 30)),))
    others = [
        replace(item, id=2, name="twin", motion=2),
        replace(item, id=3, name="far", motion=3, key_frames=(off,)),
        replace(
            item, id=4, name="ghost", motion=4, key_frames=(replace(off, visibility="outside", polygons=()),)
        ),
    ]
    save_revision(path, replace(found, objects=(item, *others)))
    (data / "notes" / "two.json").write_text('{"format": "x"}')
    assert run(data, "check", data / "frames", "--tracks", data / "tracks") == 2
    printed = capsys.readouterr().out
    for word in (
        "motion 1 and twin have different motions in the same place",
        "far (object 3) lies off the picture",
        "ghost (object 4) is seen nowhere",
        "motion 4 labels no trajectory",
        "two.json",
    ):
        assert word in printed


def test_compare_by_labels_and_object_by_object(data, capsys):
    assert load(data) == 0
    half = [(60, 70), (100, 70), (100, 130), (60, 130)]
    drawn_by_hand(data / "other" / "one.json", "half", half)
    words = [data / "notes", data / "other", data / "frames", "--tracks", data / "tracks"]
    capsys.readouterr()
    assert main(["annotations", "compare", *map(str, words), "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)
    assert found["clip"] == "one"
    assert 0.4 < found["objects"][0]["iou"] < 0.6
    assert found["objects"][0]["verdict"] == "labels differ: motion 1 / half"
    assert 5 < found["objects"][0]["different"] < 60
    assert 0.5 < found["kappa"] < 1
    assert main(["annotations", "compare", *map(str, words)]) == 0
    assert "labels differ: motion 1 / half" in capsys.readouterr().out
    assert main(["annotations", "compare", *map(str, words[:3])]) == 0


@pytest.mark.parametrize(
    ("words", "word"),
    [
        (["import", "nowhere", "frames", "--format", "davis"], "nowhere"),
        (["import", "masks", "frames", "--format", "davsi"], "did you mean 'davis'"),
        (["import", "tracks", "frames", "--format", "cvat"], "named as a clip"),
        (["import", "masks", "nothing", "--format", "davis"], "nothing"),
        (["import", "masks", "frames", "--format", "davis", "--scale", "0"], "scale"),
        (["export", "frames", "-o", "out", "--format", "davis"], "<clip>.json"),
        (["check", "frames"], "<clip>.json"),
        (["check", "frames"], "the clips are one, two"),
        (["compare", "a", "b", "frames"], "<clip>.json"),
        (["compare", "a", "b", "frames"], "the clips are one, two"),
    ],
)
def test_mistakes_are_answered_in_one_line(data, words, word, capsys, monkeypatch):
    monkeypatch.chdir(data)
    assert main(["annotations", *words]) == 2
    printed = capsys.readouterr().err
    assert word in printed
    assert printed.count("\n") == 1


def test_merging_keeps_lassos_and_rejected_objects(data):
    drawn_by_hand(data / "a.json", "a", CORNERS, motion=3)
    first = replace(load_annotation(data / "a.json"), marks=(Mark(0, 5, tuple(CORNERS)),))
    (item,) = first.objects
    second = replace(
        first, objects=(item, replace(item, id=2, motion="reject"), replace(item, id=3, motion=0))
    )
    added = first.with_free_numbers(second.objects)
    assert [(o.id, o.motion) for o in added] == [(2, 8), (3, "reject"), (4, 0)]
    added = replace(first, objects=()).with_free_numbers(second.objects)  # only the lasso has a motion
    assert [(o.id, o.motion) for o in added] == [(1, 8), (2, "reject"), (3, 0)]
