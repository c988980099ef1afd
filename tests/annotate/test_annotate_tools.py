"""Agreement of labellings, the tools, pictures of regions, and the command."""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
import tracemalloc
from pathlib import Path

import cv2
import numpy as np
import pytest
from annotation_scenes import drawn_by_hand, write_clip
from hypothesis import given
from hypothesis import strategies as st
from overlay import draw_view
from sklearn.metrics import cohen_kappa_score

from kt3dmoseg import cli, io
from kt3dmoseg.annotate import AnnotatedObject, Annotation, KeyFrame, load_annotation, save_revision
from kt3dmoseg.annotate.agreement import agree, compare, overlaps
from kt3dmoseg.annotate.propagation import Region
from kt3dmoseg.draw.palette import label_colour
from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import Labels

ROOT = Path(__file__).parents[2]
BOX = [(60, 70), (140, 70), (140, 130), (60, 130)]


def tool(name):
    spec = importlib.util.spec_from_file_location(name, ROOT / "tools" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), min_size=1, max_size=40))
def test_kappa_is_that_of_scikit_learn(pairs):
    a, b = np.array(pairs).T
    found = agree(a, b)
    assert found.agreement == np.mean(found.a == b)
    if found.agreement < 1:
        assert found.kappa == pytest.approx(cohen_kappa_score(found.a, b))
    else:
        assert found.kappa == 1


@given(st.lists(st.integers(0, 4), min_size=1, max_size=40), st.permutations([1, 2, 3, 4]))
def test_renamed_motions_agree(labels, names):
    renamed = np.array([0, *names])[labels]
    found = agree(renamed, labels)
    assert found.agreement == found.kappa == found.both == 1.0
    assert found.groups() == []


def test_agreement_by_hand():
    found = agree([5, 5, 5, 2, 0, 7], [1, 1, 2, 2, 2, 0])
    assert found.matching == {5: 1, 2: 2}
    assert found.agreement == 3 / 6
    assert found.both == 3 / 4
    assert found.differences.tolist() == [2, 4, 5]
    assert [(a, b, rows.tolist()) for a, b, rows in found.groups()][:2] == [(0, 2, [4]), (1, 2, [2])]
    with pytest.raises(InvalidValueError, match="length"):
        agree([1], [1, 2])


@pytest.fixture
def clip(tmp_path):
    """A clip whose file holds labels like a release, and an annotation of it."""
    on = write_clip(tmp_path, "one")
    there = io.load(tmp_path / "tracks" / "one.npz")
    (tmp_path / "release").mkdir()
    io.save(there.with_labels(Labels(np.where(on, 1, 2))), tmp_path / "release" / "one.mat")
    drawn_by_hand(tmp_path / "annotations" / "one.json", "drifting box", BOX)
    return tmp_path


def test_agreement_tool(clip, capsys):
    arguments = ["--annotations", str(clip / "annotations"), "--release", str(clip / "release")]
    assert tool("annotation_agreement").main(arguments) == 0
    text = capsys.readouterr().out
    assert "| one | 400 |" in text
    assert "| label 1 | drifting box |" in text
    assert tool("annotation_agreement").main([*arguments, "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert row["agreement"] > 0.95
    assert row["evaluated"] == 400


def test_agreement_tool_lists_where_the_two_differ(clip, capsys):
    half = [(60, 70), (100, 70), (100, 130), (60, 130)]
    drawn_by_hand(clip / "other" / "one.json", "drifting box", half)
    arguments = ["--annotations", str(clip / "annotations"), "--release", str(clip / "release")]
    assert tool("annotation_agreement").main([*arguments, "--other", str(clip / "other")]) == 0
    text = capsys.readouterr().out
    assert "ours: drifting box, theirs: background" in text
    assert "frame 3 at (" in text


def test_agreement_tool_without_annotations(clip, capsys):
    arguments = ["--annotations", str(clip / "nothing"), "--release", str(clip / "release")]
    assert tool("annotation_agreement").main(arguments) == 2
    assert "one is not annotated" in capsys.readouterr().err


def test_render_tool(clip, capsys):
    arguments = [str(clip / "annotations" / "one.json"), "--frames", str(clip / "frames" / "one")]
    arguments += ["-o", str(clip / "out")]
    assert tool("render_annotation").main(arguments) == 2
    assert "--tracks" in capsys.readouterr().err
    arguments += ["--tracks", str(clip / "tracks" / "one.npz")]
    assert tool("render_annotation").main(arguments) == 0
    names = sorted(p.name for p in (clip / "out").iterdir())
    assert names == [f"one_f00{k}.png" for k in range(6)] + ["one_object01_0.png"]
    last = cv2.imread(str(clip / "out" / "one_f005.png"))
    orange = (np.abs(last.astype(int) - label_colour(2)[::-1]) < 40).all(axis=2)
    columns = np.flatnonzero(orange[100:150].any(axis=0))
    # 36 pixels of ruler, 1.25 screen pixels per pixel: the box is at 80 to 160 in the last frame.
    assert columns.min() == pytest.approx(36 + 80 * 1.25, abs=6)
    assert columns.max() == pytest.approx(36 + 160 * 1.25, abs=6)


def test_render_tool_crops(clip, capsys):
    arguments = ["--frames", str(clip / "frames" / "one"), "-o", str(clip / "out"), "--zoom", "3"]
    assert tool("render_annotation").main([*arguments, "--crop", "2:50,60,89,99"]) == 0
    picture = cv2.imread(str(clip / "out" / "one_f002_50_60.png"))
    assert picture.shape == (40 * 3 + 26, 40 * 3 + 36, 3)
    for bad in ("9:0,0,5,5", "0:5,5,0,0", "x", "0:1,2,3"):
        assert tool("render_annotation").main([*arguments, "--crop", bad]) == 2
        assert "--crop" in capsys.readouterr().err


def test_views_may_reach_beyond_the_frame():
    picture = draw_view(np.full((20, 30), 99, np.uint8), (-10.0, -10.0, 40.0, 30.0), 2.0)
    assert picture.shape == (2 * 41 + 26, 2 * 51 + 36, 3)


def test_command_reports_what_is_wrong(tmp_path, capsys):
    assert cli.main(["label", str(tmp_path)]) == 2
    assert "a folder of frames" in capsys.readouterr().err
    write_clip(tmp_path, "one")
    assert cli.main(["label", str(tmp_path / "frames"), "--no-browser", "--port", "99999"]) == 2
    assert "--port" in capsys.readouterr().err


SAVER = """
import sys
from dataclasses import replace
from kt3dmoseg.annotate import Annotation, Mark, save_revision
lasso = Mark(0, 1, tuple((k, k * k % 97) for k in range(2000)))
annotation = Annotation("one", (320, 200), 6, marks=(lasso,))
while True:
    annotation = save_revision(sys.argv[1], annotation)
    print(annotation.revision, flush=True)
    annotation = replace(annotation, marks=(*annotation.marks, Mark(0, 1, ((0, 0), (9, 0), (9, 9)))))
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no kill -9 on this system")
@pytest.mark.parametrize("moment", [0.0, 0.013, 0.05])
def test_kill_9_never_breaks_the_file(tmp_path, moment):
    path = tmp_path / "one.json"
    command = [sys.executable, "-c", SAVER, str(path)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ)
    printed = [process.stdout.readline() for _ in range(3)]
    time.sleep(moment)
    process.kill()
    printed += process.communicate()[0].splitlines()
    last = max(int(line) for line in printed if line.strip())
    found = load_annotation(path)
    assert found.revision in (last, last + 1)
    assert save_revision(path, found).revision == found.revision + 1


def test_many_objects_are_compared_in_bounded_memory():
    square = np.array([[0, 0], [50, 0], [50, 50], [0, 50.0]])
    mine = {k: [Region("visible", (square + 10 * k,), True)] for k in range(1, 61)}
    tracemalloc.start()
    found = overlaps(mine, mine, (1242, 375))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 100e6  # one float64 per pixel and object would be 450 MB
    assert np.array_equal(np.diag(found)[:30], np.ones(30))
    assert found[0, 1] == pytest.approx(40**2 / (2 * 50**2 - 40**2), abs=0.03)
    assert overlaps({}, mine, (1242, 375)).shape == (0, 60)


def outlined(*boxes):
    """An annotation of boxes (name, motion, x), and where they are."""
    items, regions = [], {}
    for number, (name, motion, x) in enumerate(boxes, 1):
        polygon = ((x, 10), (x + 40, 10), (x + 40, 50), (x, 50))
        items.append(AnnotatedObject(number, name, "car", motion, (KeyFrame(0, polygons=(polygon,)),)))
        regions[number] = [Region("visible", (np.array(polygon, float),), True)] * 2
    return Annotation("clip", (200, 60), 2, tuple(items)), regions


def test_objects_are_paired_by_place_and_motion():
    one, at_one = outlined(("van", 1, 0), ("walker", 2, 60), ("far car", 3, 140))
    two, at_two = outlined(("bus", 4, 2), ("runner", 2, 96), ("dot", 5, 141))
    labels = np.array([1, 1, 2, 2, 2, 3]), np.array([1, 1, 5, 5, 1, 1])  # the last objects label none
    found = compare((one, two), (at_one, at_two), labels).objects
    assert [pair.verdict("A", "B") for pair in found] == [
        "missed by B: walker",  # by 4 pixels of 40 it is not the runner
        "missed by A: runner",
        "labels differ: van / bus",
        "same labels: far car / dot",
    ]
    assert [pair.different for pair in found] == [1, 0, 1, 0]
    assert [pair.motion for pair in found] == [None, None, 1, 3]
    two, at_two = outlined(("bus", 4, 0), ("bike", "reject", 60))
    found = compare((one, two), (at_one, at_two), labels).objects
    assert [pair.verdict("A", "B") for pair in found][:2] == [
        "missed by B: far car",
        "another motion: walker / bike",
    ]


def test_the_background_is_the_same_in_both_labellings():
    found = agree([1] * 4 + [2] * 6, [1] * 4 + [1] * 5 + [2], background=1)
    assert found.agreement == 0.5
    assert found.matching == {1: 1, 2: 2}
