"""The labelling page with several people in one clip, other keyboards, and what is done at odd moments."""

from __future__ import annotations

import signal

import pytest
from labeller_page import CORNERS, Page, Server, stored

pytestmark = pytest.mark.browser

THERE = [(200, 20), (260, 20), (260, 50)]


def test_two_people_who_take_turns_make_no_copies(context, shared):
    ada, bo = Page(context, shared.address), Page(context, shared.address)
    ada.draw()
    ada.saved()
    bo.draw(THERE)
    for _ in range(2):
        for page, corner in ((ada, CORNERS[0]), (bo, THERE[0])):
            page.saved()
            page.press("Escape", "Escape")
            page.click([value + 12 if axis == 0 else value + 4 for axis, value in enumerate(corner)])
            page.press("w")
            page.saved()
        name = ada.tab.get_by_label("note")
        name.fill("half hidden")
        name.blur()
    bo.saved()
    ada.saved()
    objects = stored(shared).objects
    assert [len(item.key_frames[0].polygons[0]) for item in objects] == [4, 3]
    assert [item.name for item in objects] == ["object 1", "object 2"]
    assert ada.errors == bo.errors == []


def test_nobody_reviews_what_somebody_saved_meanwhile(context, shared):
    bo = Page(context, shared.address)
    bo.value("localStorage.setItem('annotator', 'Bo')")
    ada = Page(context, shared.address)
    ada.draw()
    ada.saved()
    state = bo.tab.get_by_label("State of this clip")
    state.select_option("reviewed")
    bo.shows("#hint", "Somebody else saved meanwhile: look at it, then set the state again")
    assert len(bo.objects()) == 1
    assert bo.value("labeller.state.work.state") != "reviewed"
    state.select_option("reviewed")
    bo.until("labeller.state.work.state === 'reviewed'")
    assert bo.value("labeller.state.work.revision") == 1


def test_a_clip_is_left_only_when_the_merge_is_saved(context, shared):
    ada, bo = Page(context, shared.address), Page(context, shared.address)
    ada.draw()
    ada.saved()
    bo.draw(THERE)
    bo.press("PageDown")
    bo.until("labeller.state.clip.name === 'two' && labeller.state.labels")
    assert len(stored(shared).objects) == 2


def test_page_down_opens_the_next_clip_also_after_the_state_was_chosen(context, shared):
    page = Page(context, shared.address)
    page.value("localStorage.setItem('annotator', 'Ada')")
    page.draw()
    page.saved()
    page.tab.get_by_label("State of this clip").focus()
    page.press("ArrowDown")
    page.until("labeller.state.work?.state === 'done'")
    page.press("PageDown")
    page.until("labeller.state.clip.name === 'two' && labeller.state.labels")
    assert page.value("labeller.state.work.state ?? ''") in ("", "not started")
    page.press("PageUp")
    page.until("labeller.state.clip.name === 'one' && labeller.state.labels")
    assert page.value("labeller.state.work.state") == "done"


def test_regions_follow_an_edit_after_the_server_was_restarted(context, clips, server, tmp_path):
    page = Page(context, server.address)
    page.draw()
    page.saved()
    server.stop(signal.SIGKILL)
    again = Server(clips, tmp_path / "notes", server.port)
    try:
        page.drag((100, 100), (100, 108))
        page.saved()
        moved = "labeller.state.regions?.[1]?.[2]?.polygons?.[0]?.[0]?.[1]"
        before = page.value("labeller.state.doc.objects[0].key_frames[0].polygons[0][0][1]")
        page.until(f"Math.abs({moved} - {before}) < 3")
    finally:
        again.stop(signal.SIGKILL)
    assert page.errors == []


def test_what_is_reshaped_behind_something_stays_hidden(page):
    page.draw([*CORNERS, (55, 100)])
    page.press("ArrowRight", "o")
    page.until("labeller.state.doc.objects[0].key_frames.length === 2")
    x, y = page.value("labeller.state.doc.objects[0].key_frames[1].polygons[0][0]")
    page.click((x, y), button="right")
    page.until("labeller.state.doc.objects[0].key_frames[1].polygons[0].length === 4")
    assert page.objects()[0]["key_frames"][1]["visibility"] == "occluded"
    page.press("r")
    for corner in CORNERS:
        page.click(corner)
    page.press("Enter")
    assert page.objects()[0]["key_frames"][1]["visibility"] == "visible"


def test_a_drag_stops_playing_and_changes_one_frame(page):
    page.draw()
    page.press("Space")
    page.until("labeller.state.playing")
    page.drag((100, 100), (104, 104), steps=20)
    assert page.value("labeller.state.playing") is False
    page.until("!labeller.state.dragging")
    assert len(page.objects()[0]["key_frames"]) <= 2


def test_letters_count_on_keyboards_without_latin_ones(page):
    page.draw()
    event = "new KeyboardEvent('keydown', {{ key: '{}', code: '{}', ctrlKey: {}, bubbles: true }})"
    page.value(f"document.body.dispatchEvent({event.format('я', 'KeyZ', 'true')})")
    page.until("labeller.state.doc.objects.length === 0")
    page.value(f"document.body.dispatchEvent({event.format('т', 'KeyN', 'false')})")
    page.until("labeller.state.tool === 'draw'")
    page.press("Escape")
    page.value(f"document.body.dispatchEvent({event.format('ö', 'Semicolon', 'false')})")
    assert page.value("labeller.state.tool") == "select"


def test_a_new_object_is_seen_though_its_number_was_hidden(page):
    page.draw()
    page.press("Shift+H", "Shift+Delete")
    page.until("labeller.state.doc.objects.length === 0")
    page.draw()
    page.until("labeller.state.doc.objects.length === 1")
    assert page.value("labeller.state.unseen.has(labeller.state.doc.objects[0].id)") is False


def test_a_click_in_the_list_counts_while_a_name_is_kept(page):
    page.draw()
    page.draw(THERE)
    page.tab.get_by_label("name", exact=True).fill("van")
    entry = page.box('[data-id="1"] .object')
    page.tab.mouse.move(entry["x"] + 30, entry["y"] + 8)
    page.tab.mouse.down()
    page.tab.wait_for_timeout(120)
    page.tab.mouse.up()
    page.until("labeller.state.selected === 1")
    assert [item["name"] for item in page.objects()] == ["object 1", "van"]
    page.shows("[data-id='2']", "van")
