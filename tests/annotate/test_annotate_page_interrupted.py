"""The labelling page when things happen in between: resizing, reloading, other people; and short clips."""

from __future__ import annotations

import signal

import pytest
from annotation_scenes import write_clip
from labeller_page import CORNERS, Page, Server, near, stored

pytestmark = pytest.mark.browser

MOVED = [*CORNERS[:2], (150, 140), CORNERS[3]]


def outline(page):
    (key,) = page.objects()[0]["key_frames"]
    return key["frame"], key["polygons"][0]


def resize(page, width, height):
    page.tab.set_viewport_size({"width": width, "height": height})
    page.until(f"labeller.state.view && Math.abs(document.getElementById('stage').clientWidth - {width}) < 9")
    page.value("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


def test_a_point_stays_under_the_pointer_when_the_window_gets_another_size(page):
    page.draw()
    page.hold((140, 130), (145, 135))
    resize(page, 1000, 600)
    page.release((150, 140))
    frame, polygon = outline(page)
    assert frame == 0
    assert near(polygon, MOVED)


def test_a_new_size_keeps_what_was_zoomed_to_and_the_whole_frame_whole(page):
    whole = page.value("labeller.state.view.scale")
    resize(page, 1000, 600)
    assert page.value("labeller.state.view.scale") < whole
    page.draw()
    page.press("z")
    zoomed = page.value("labeller.state.view")
    resize(page, 1280, 720)
    assert page.value("labeller.state.view") == zoomed


def test_keys_change_nothing_under_a_pointer_that_drags(page):
    page.draw()
    page.hold((140, 130), (145, 135))
    page.press("ArrowRight", "Shift+Delete", "e", "4")
    page.release((150, 140))
    frame, polygon = outline(page)
    assert frame == 0
    assert near(polygon, MOVED)
    page.hold((150, 140), (180, 180))
    page.press("Escape")
    page.tab.mouse.up()
    assert near(outline(page)[1], MOVED)


def test_reloading_in_the_middle_of_a_drag_loses_only_the_drag(page):
    page.draw()
    page.saved()
    page.tab.on("dialog", lambda dialog: dialog.accept())
    page.hold((140, 130), (180, 180))
    page.tab.reload()
    page.tab.mouse.up()
    page.ready()
    assert near(outline(page)[1], CORNERS)
    assert page.saved() == 1


def test_a_key_frame_that_is_held_while_somebody_saves_overwrites_nothing(context, shared):
    first = Page(context, shared.address)
    first.draw()
    first.saved()
    second = Page(context, shared.address)
    first.draw([(200, 20), (260, 20), (260, 50)])
    first.saved()
    second.press("]")
    box = second.box("#timeline")
    x, y = box["x"] + box["width"] / 12, box["y"] + 26 + 13
    second.press("2")
    second.tab.mouse.move(x, y)
    second.tab.mouse.down()
    second.until("labeller.state.doc.objects.length === 2")
    second.tab.mouse.move(x + box["width"] / 3, y, steps=5)
    second.tab.mouse.up()
    second.saved()
    moved, drawn = stored(shared).objects
    assert (moved.motion, [key.frame for key in moved.key_frames]) == (2, [2])
    assert drawn.motion == 2
    assert first.errors == second.errors == []


def test_an_object_that_leaves_comes_back(page, shared):
    page.draw()
    page.press("ArrowRight", "ArrowRight", "e", "ArrowRight", "ArrowRight", "r")
    for corner in CORNERS:
        page.click(corner)
    page.press("Enter")
    page.saved()
    page.until("labeller.state.regions?.[1]?.[4]?.key")
    seen = page.value("labeller.state.regions[1].map((region) => region.visibility)")
    assert seen == ["visible", "visible", "outside", "outside", "visible", "visible"]
    (item,) = stored(shared).objects
    assert [key.frame for key in item.key_frames] == [0, 2, 4]


def test_a_clip_of_two_frames_in_which_nothing_moves(context, tmp_path):
    write_clip(tmp_path, "short", frames=2, tracks=50)
    server = Server(tmp_path, tmp_path / "notes")
    try:
        page = Page(context, server.address)
        page.press(
            "Shift+U", "Shift+W", "g", "]", "f", "f", "Space", "Space", "End", "z", "c", "Shift+E", "<", ">"
        )
        page.press("s")
        page.tab.get_by_role("button", name="Cancel").click()
        page.press("Home")
        page.draw()
        page.until("labeller.state.regions?.[1]")
        page.press("e", "Control+z", "ArrowRight", "e", "Control+z", "c", "Home", "c", "o")
        page.saved()
        (item,) = page.objects()
        assert [(key["frame"], key["visibility"]) for key in item["key_frames"]] == [
            (0, "visible"),
            (1, "occluded"),
        ]
        assert page.errors == []
    finally:
        server.stop(signal.SIGKILL)
