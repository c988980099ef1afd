"""Outlines of what moves, by clicks: the module, its route, and the page."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from annotation_scenes import write_clip
from test_annotate_server import page as server_page  # noqa: F401  # a fixture

from kt3dmoseg import io
from kt3dmoseg.annotate import one_click
from kt3dmoseg.annotate.formats.masks import mask_of
from kt3dmoseg.annotate.geometry import arrays
from kt3dmoseg.annotate.model import Stroke
from kt3dmoseg.annotate.one_click import outline_clicks, painted, sharpened
from kt3dmoseg.types import Trajectories

SIZE = (320, 200)


def overlap(polygons, frame):
    """IoU with the box that drifts, and the mask."""
    exact = np.zeros(SIZE[::-1], bool)
    exact[70:130, 60 + 4 * frame : 140 + 4 * frame] = True
    found = mask_of(arrays(polygons), SIZE)
    return (found & exact).sum() / (found | exact).sum(), found


@pytest.mark.parametrize("given", ["click", "groups", "box"])
def test_a_click_or_box_outlines_what_moves_and_another_click_takes_a_part_away(tmp_path, given, monkeypatch):
    moving = write_clip(tmp_path, "one")
    tracks = io.load(tmp_path / "tracks" / "one.npz").dense
    frames = [cv2.imread(str(path), 0) for path in sorted((tmp_path / "frames" / "one").iterdir())]
    groups = [np.where(moving, 2, 1)] if given == "groups" else []
    box = (70, 68, 154, 132) if given == "box" else None
    clicks = [] if box else [(112.0, 100.0, True)]
    iou, _ = overlap(outline_clicks(frames.__getitem__, tracks, 3, clicks, box, groups), 3)
    assert iou > 0.85
    clicks.append((80.0, 100.0, False))
    iou, found = overlap(outline_clicks(frames.__getitem__, tracks, 3, clicks, box, groups), 3)
    assert iou > 0.6
    assert (found[100, 80], found[100, 112]) == (False, True)
    quick = outline_clicks(frames.__getitem__, tracks, 3, clicks, box, groups)
    monkeypatch.setattr(one_click, "_ROUND_REACH", np.inf)  # as if all trajectories were asked in every round
    assert outline_clicks(frames.__getitem__, tracks, 3, clicks, box, groups) == quick


def test_a_box_is_outlined_without_trajectories():
    tracks = Trajectories(np.zeros((0, 1, 2)), np.zeros((0, 1), bool), image_size=SIZE)
    frame = np.full(SIZE[::-1], 40, np.uint8)
    frame[70:130, 60:140] = 200
    iou, _ = overlap(outline_clicks(lambda _: frame, tracks, 0, [], (58, 68, 142, 132)), 0)
    assert iou > 0.8


def test_a_box_takes_the_shape_that_is_expected_there_where_the_picture_shows_none():
    tracks = Trajectories(np.zeros((0, 1, 2)), np.zeros((0, 1), bool), image_size=SIZE)
    flat, triangle = np.full(SIZE[::-1], 90, np.uint8), ((10.0, 70.0), (50.0, 70.0), (50.0, 30.0))
    exact = mask_of(arrays([((60, 130), (140, 130), (140, 70))]), SIZE)
    found = [
        mask_of(arrays(outline_clicks(lambda _: flat, tracks, 0, [], (60, 70, 140, 130), (), like)), SIZE)
        for like in ([], [triangle])
    ]
    without, shaped = ((mask & exact).sum() / (mask | exact).sum() for mask in found)
    assert shaped > without + 0.15


def test_the_brush_adds_a_disc_along_a_line_and_takes_it_away():
    square = ((10, 10), (50, 10), (50, 50), (10, 50))
    before = mask_of(arrays([square]), SIZE)
    added = painted(Stroke((square,), ((60, 30), (80, 30)), 12, True), SIZE)
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    disc = np.hypot(x - np.clip(x, 60, 80), y - 30) < 12
    assert np.count_nonzero(mask_of(arrays(added), SIZE) != (before | disc)) < 30
    left = painted(Stroke(tuple(added), ((60, 30), (80, 30)), 12, False), SIZE)
    assert np.count_nonzero(mask_of(arrays(left), SIZE) != (before & ~disc)) < 30


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
        ({"frame": 0, "clicks": [], "box": [10, 10, 12, 40]}, "box"),
        ({"frame": 0, "clicks": [], "box": [10, 10, 320, 40]}, "box"),
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


@pytest.mark.browser
def test_a_stroke_counts_though_other_key_frames_are_made_meanwhile_and_not_when_this_one_changes(page):
    page.press("Shift+O")
    page.drag((57, 67), (143, 133))
    page.until("labeller.state.doc.objects.length === 1 && !labeller.state.making")
    page.value(
        "(() => { const { fetch } = window, { state } = labeller; window.fetch = async (url, ...rest) => {"
        "const answer = await fetch(url, ...rest); if (`${url}`.endsWith('/paint')) {"
        "const [item] = state.doc.objects, [key, ...others] = item.key_frames;"
        "const key_frames = window.here ? [{ ...key, polygons: [...key.polygons] }, ...others]"
        ": [key, ...others, { ...key, frame: 5 }];"
        "state.doc = { ...state.doc, objects: [{ ...item, key_frames }] }; } return answer; }; })()"
    )
    page.press("Shift+P")
    for here, counted in ((False, 1), (True, 0)):
        page.value(f"window.here = {str(here).lower()}")
        before = page.value("labeller.state.done.length")
        with page.tab.expect_response("**/paint"):
            page.drag((100, 100), (100, 160))
        page.tab.wait_for_timeout(300)
        assert page.value("labeller.state.done.length") == before + counted
    page.press("Control+z")
    page.saved()


@pytest.mark.browser
def test_a_box_makes_an_outline_and_the_brush_changes_it_by_mouse_and_by_keys(page):
    page.press("Shift+O")
    page.drag((57, 67), (143, 133))
    page.until("labeller.state.doc.objects.length === 1")
    (first,) = page.objects()
    assert overlap(first["key_frames"][0]["polygons"], 0)[0] > 0.85
    page.press("Shift+P")
    page.drag((100, 100), (100, 160))
    page.until("labeller.state.done.length === 2")
    assert overlap(page.objects()[0]["key_frames"][0]["polygons"], 0)[1][160, 100]
    page.press("Shift+X", "ArrowDown", "i")
    page.value("labeller.state.cross = [100, 155]")
    page.press("Enter")
    page.until("labeller.state.done.length === 3")
    found = overlap(page.objects()[0]["key_frames"][0]["polygons"], 0)[1]
    assert (found[155, 100], found[140, 100]) == (False, True)
    page.press("Control+z", "Control+z")
    assert page.objects() == [first]
    page.press("End")
    page.until("labeller.state.frame > 0 && labeller.state.regions?.[1]?.[labeller.state.frame]")
    page.press("Shift+O", "]")
    frame = page.value("labeller.state.frame")
    page.tab.keyboard.down("Alt")
    page.click((70 + 4 * frame, 100))
    page.tab.keyboard.up("Alt")
    page.until("labeller.state.doc.objects[0].key_frames.length === 2")
    page.press("Control+z")
    page.until(f"!labeller.state.making && labeller.state.regions?.[1]?.[{frame}]")
    page.tab.wait_for_timeout(500)  # until what is carried follows the undo
    carried = page.value(f"labeller.state.regions[1][{frame}].polygons")
    with page.tab.expect_request("**/outline") as asked:
        page.drag((57 + 4 * frame, 67), (143 + 4 * frame, 133))
    assert asked.value.post_data_json["like"] == carried  # the shape to expect


def test_clicks_correct_the_shape_that_is_carried_there_unless_they_are_far_from_it():
    tracks = Trajectories(np.zeros((0, 1, 2)), np.zeros((0, 1), bool), image_size=SIZE)
    frame = np.full(SIZE[::-1], 90, np.uint8)
    carried = (((60.0, 70.0), (120.0, 70.0), (120.0, 130.0), (60.0, 130.0)),)

    def clicked(*clicks, like=carried):
        return outline_clicks(lambda _: frame, tracks, 0, clicks, like=like)

    before = mask_of(arrays(carried), SIZE)
    for place, adds in (((128.0, 100.0), True), ((63.0, 100.0), False)):
        found = mask_of(arrays(clicked((*place, adds))), SIZE)
        x, y = map(int, place)
        assert (found[y, x], before[y, x]) == (adds, not adds)
        assert (found & before).sum() > 0.85 * before.sum()
    assert clicked((300.0, 20.0, True)) == clicked((100.0, 100.0, True), like=()) == []


def test_a_carried_region_is_outlined_anew_by_the_edges_there():
    tracks = Trajectories(np.zeros((0, 1, 2)), np.zeros((0, 1), bool), image_size=SIZE)
    frame = np.full(SIZE[::-1], 40, np.uint8)
    frame[70:130, 60:140] = 200
    carried = np.array([(64.0, 74), (144, 74), (144, 134), (64, 134)])
    before = overlap([carried], 0)[0]
    assert before < 0.85
    assert overlap(sharpened(lambda _: frame, tracks, 0, [carried]), 0)[0] > 0.95
    assert sharpened(lambda _: frame, tracks, 0, [carried + 400]) == []


@pytest.mark.browser
def test_key_frames_are_made_where_propagation_is_weak_and_stay_in_doubt(page):
    page.press("Shift+O")
    page.drag((90, 90), (106, 106))  # fewer than 8 trajectories: in doubt wherever it is carried to
    page.until("labeller.state.doc.objects.length === 1 && !labeller.state.making")
    frames = "labeller.state.doc.objects[0].key_frames.map((key) => key.frame)"
    made = page.value(frames)
    assert len(made) > 1
    page.press("Escape", "Shift+W")
    page.shows("#hint", "outlined by itself")
    page.press("End", "]", "e")  # it leaves here: what was made is made again, and none comes back after it
    page.until("!labeller.state.making")
    assert page.value("labeller.state.doc.objects[0].key_frames.at(-1).visibility") == "outside"
    page.press("Control+z")
    assert page.value(frames) == made
    page.press("Control+z")
    assert page.objects() == []
