"""Outlines of what moves, by clicks: the module, its route, and the page."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from annotation_scenes import write_clip
from test_annotate_server import page as server_page  # noqa: F401  # a fixture

from kt3dmoseg import io
from kt3dmoseg.annotate.formats.masks import mask_of
from kt3dmoseg.annotate.geometry import arrays
from kt3dmoseg.annotate.one_click import outline_clicks

SIZE = (320, 200)


def overlap(polygons, frame):
    """IoU with the box that drifts, and the mask."""
    exact = np.zeros(SIZE[::-1], bool)
    exact[70:130, 60 + 4 * frame : 140 + 4 * frame] = True
    found = mask_of(arrays(polygons), SIZE)
    return (found & exact).sum() / (found | exact).sum(), found


@pytest.mark.parametrize("grouped", [False, True])
def test_a_click_outlines_what_moves_and_another_takes_a_part_away(tmp_path, grouped):
    moving = write_clip(tmp_path, "one")
    tracks = io.load(tmp_path / "tracks" / "one.npz").dense
    frames = [cv2.imread(str(path), 0) for path in sorted((tmp_path / "frames" / "one").iterdir())]
    groups = [np.where(moving, 2, 1)] if grouped else []
    clicks = [(112.0, 100.0, True)]
    iou, _ = overlap(outline_clicks(frames.__getitem__, tracks, 3, clicks, groups), 3)
    assert iou > 0.85
    clicks.append((80.0, 100.0, False))
    iou, found = overlap(outline_clicks(frames.__getitem__, tracks, 3, clicks, groups), 3)
    assert iou > 0.6
    assert (found[100, 80], found[100, 112]) == (False, True)


GOOD = [100, 100, True]


@pytest.mark.parametrize(
    ("body", "field"),
    [
        ([], "body"),
        ({"frame": 0}, "clicks"),
        ({"frame": 6, "clicks": [GOOD]}, "frame"),
        ({"frame": 0.5, "clicks": [GOOD]}, "frame"),
        ({"frame": 0, "clicks": []}, "clicks"),
        ({"frame": 0, "clicks": [GOOD] * 101}, "clicks"),
        ({"frame": 0, "clicks": [[100, 100, False]]}, "clicks[0][2]"),
        ({"frame": 0, "clicks": [GOOD, [100, 100, 1]]}, "clicks[1][2]"),
        ({"frame": 0, "clicks": [GOOD, [320, 100, True]]}, "clicks[1]"),
    ],
)
def test_clicks_that_are_none_are_refused_with_the_field(server_page, body, field):  # noqa: F811
    while server_page.get("/api/clips/one/tracks").status_code == 202:
        pass
    answer = server_page.post("/api/clips/one/outline", json=body)
    assert answer.status_code == 400
    assert field in answer.json()["error"]


@pytest.mark.browser
def test_clicks_make_an_outline_and_undo_takes_them_back(page):
    page.press("Shift+O")
    page.click((100, 100))
    page.until("labeller.state.doc.objects.length === 1")
    (first,) = page.objects()
    iou, found = overlap(first["key_frames"][0]["polygons"], 0)
    assert iou > 0.7
    assert found[100, 70]
    before = page.value("JSON.stringify(labeller.state.doc)")
    page.tab.keyboard.down("Alt")
    page.click((70, 100))
    page.tab.keyboard.up("Alt")
    page.until(f"JSON.stringify(labeller.state.doc) !== {before!r}")
    (item,) = page.objects()
    assert not overlap(item["key_frames"][0]["polygons"], 0)[1][100, 70]
    page.press("Control+z")
    assert page.objects() == [first]
    page.press("Enter")
    page.until("labeller.state.selected === null && labeller.state.tool === 'click'")
    page.press("Escape", "Control+z")
    assert page.objects() == []
