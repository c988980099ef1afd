"""Drawing in the labelling page: a real Chromium against a real server process."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from annotation_scenes import zipped
from labeller_page import CORNERS, near, stored

pytestmark = pytest.mark.browser


def test_draw_label_by_key_save_reload(page, shared):
    page.draw()
    page.press("3")
    page.saved()
    (item,) = stored(shared).objects
    assert item.motion == 3
    assert near(item.key_frames[0].polygons[0], CORNERS)
    page.until("labeller.state.labels.counts.motions[4] > 10")
    page.tab.reload()
    page.ready()
    assert page.objects()[0]["motion"] == 3


def test_region_follows_the_motion_into_the_next_frames(page):
    page.draw()
    page.until("labeller.state.regions?.[1]")
    page.press("End")
    moved = page.value("labeller.state.regions[1][5].polygons[0]")
    assert near(moved, [(x + 20, y) for x, y in CORNERS], 1.5)
    page.press("Home", "c")
    page.until("labeller.state.frame === 1")
    keys = page.objects()[0]["key_frames"]
    assert [key["frame"] for key in keys] == [0, 1]
    assert near(keys[1]["polygons"][0], [(x + 4, y) for x, y in CORNERS], 1.5)


def test_undo_and_redo_without_limit(page):
    page.draw()
    states = [page.value("JSON.stringify(labeller.state.doc)")]
    for key in ["2", "4", "x", "ArrowRight", "o", "ArrowRight", "e", "0"]:
        page.press(key)
        states.append(page.value("JSON.stringify(labeller.state.doc)"))
    distinct = list(dict.fromkeys(states))
    for state in reversed(distinct[:-1]):
        page.press("Control+z")
        assert page.value("JSON.stringify(labeller.state.doc)") == state
    page.press("Control+z")
    assert page.objects() == []
    for state in distinct:
        page.press("Control+Shift+Z")
        assert page.value("JSON.stringify(labeller.state.doc)") == state


def test_points_are_moved_inserted_and_deleted(page):
    page.draw()
    page.drag((140, 130), (150, 140))
    assert near(page.objects()[0]["key_frames"][0]["polygons"][0], [*CORNERS[:2], (150, 140), CORNERS[3]])
    page.press("Control+z")
    page.drag((100, 70), (100, 60))
    assert near(page.objects()[0]["key_frames"][0]["polygons"][0], [(60, 70), (100, 60), *CORNERS[1:]])
    page.click((100, 60), button="right")
    assert near(page.objects()[0]["key_frames"][0]["polygons"][0], CORNERS)
    page.drag((100, 100), (110, 95))
    assert near(page.objects()[0]["key_frames"][0]["polygons"][0], [(x + 10, y - 5) for x, y in CORNERS])


def test_delete_here_is_not_delete_object(page):
    page.draw()
    page.until("labeller.state.regions?.[1]")
    page.press("ArrowRight", "ArrowRight", "Delete")
    page.until("labeller.state.regions?.[1]?.[2]?.visibility === 'outside'")
    shown = page.value("labeller.state.regions[1].map(r => r.visibility)")
    assert shown == ["visible", "visible", "outside", "visible", "visible", "visible"]
    page.press("Shift+Delete")
    assert page.objects() == []
    page.press("Control+z")
    assert len(page.objects()) == 1


def test_lasso_marks_trajectories(page, shared):
    page.press("q")
    page.drag((170, 20), (300, 20), (300, 60), (170, 60), (170, 22), steps=12)
    caught = page.value("labeller.state.lassoed.rows.length")
    assert caught > 5
    page.press("5")
    page.until("labeller.state.labels.counts.motions[6]")
    assert page.value("labeller.state.labels.counts.motions[6]") == caught
    page.saved()
    assert stored(shared).marks[0].motion == 5


def test_everything_by_keyboard_alone(page, shared):
    page.press("n", "i")
    page.until("labeller.state.cross")
    x, y = page.value("labeller.state.cross")
    page.press(
        "Enter", *["Shift+L"] * 5, "Enter", *["Shift+K"] * 4, "Enter", *["Shift+J"] * 5, "Enter", "Enter"
    )
    page.until("labeller.state.doc.objects.length === 1")
    polygon = page.objects()[0]["key_frames"][0]["polygons"][0]
    assert near(polygon, [(x, y), (x + 50, y), (x + 50, y + 40), (x, y + 40)], 0.1)
    page.press(
        "2", "v", "l", "l", "v", "w", "v", "d", "ArrowRight", "o", "Escape", "]", "z", "Shift+Z", "End", "e"
    )
    page.saved()
    (item,) = stored(shared).objects
    assert item.motion == 2
    assert [(key.frame, key.visibility) for key in item.key_frames] == [
        (0, "visible"),
        (1, "occluded"),
        (5, "outside"),
    ]
    assert item.key_frames[0].polygons[0][0] == (x + 2, y)
    page.press("?")
    page.shows("dialog[open] .help")
    page.press("Escape")
    assert page.value("document.activeElement.id") == "stage"
    page.press("PageDown")
    page.until("labeller.state.clip.name === 'two'")


def test_properties_are_edited_in_the_panel(page, shared):
    page.draw()
    page.tab.get_by_label("name", exact=True).fill("white van")
    page.tab.get_by_label("name", exact=True).press("Enter")
    page.tab.get_by_label("Kind").select_option("van")
    page.tab.get_by_label("note").fill("turns left")
    page.tab.locator("#stage").focus()
    page.press("7")
    page.saved()
    (item,) = stored(shared).objects
    assert (item.name, item.kind, item.note, item.motion) == ("white van", "van", "turns left", 7)


def test_a_typed_name_belongs_to_its_object_when_the_timeline_selects_another(page):
    page.draw()
    page.draw([(200, 20), (260, 20), (260, 50)])
    page.press("[")
    page.until("document.querySelector('#inspector input')?.value === 'object 1'")
    name = page.tab.get_by_label("name", exact=True)
    name.focus()
    name.press("Control+a")
    name.type("white van")
    page.tab.locator("#timeline").click(position={"x": 20, "y": 26 + 26 + 13})
    page.until("labeller.state.selected === 2")
    page.until("labeller.state.doc.objects[0].name === 'white van'")
    assert [item["name"] for item in page.objects()] == ["white van", "object 2"]


def mask_of_box(k):
    picture = np.zeros((200, 320), np.uint8)
    picture[70:130, 60 + 4 * k : 140 + 4 * k] = 1
    return cv2.imencode(".png", picture)[1].tobytes()


def test_export_and_import_in_the_page(page, tmp_path):
    page.draw()
    page.press("6", "Control+e")
    with page.tab.expect_download() as download:
        page.tab.get_by_role("row", name="CVAT").get_by_role("button", name="Export").click()
    file = Path(tmp_path / "one.xml")
    download.value.save_as(file)
    assert "<polygon" in file.read_text()
    page.tab.get_by_role("button", name="Close").click()
    page.press("Shift+Delete", "Control+e")
    page.tab.get_by_role("row", name="CVAT").locator("input").set_input_files(file)
    page.shows("#dialog li", "1 object drawn in 1 of 6 frames (0): object 1")
    assert page.objects() == []
    page.tab.get_by_role("button", name="Import", exact=True).click()
    page.until("labeller.state.doc.objects.length === 1")
    assert page.objects()[0]["motion"] == 6


def test_an_import_adds_to_what_is_drawn_or_replaces_it(page, tmp_path):
    masks = zipped(**{f"{k:06d}.png": mask_of_box(k) for k in range(4)})  # the frames count from 1
    (tmp_path / "masks.zip").write_bytes(masks)
    page.draw()

    def load(choice):
        page.press("Control+e")
        page.tab.get_by_role("row", name="DAVIS").locator("input").set_input_files(tmp_path / "masks.zip")
        page.shows("#dialog li", "000000.png")
        page.tab.get_by_label("frames later").fill("1")
        page.tab.get_by_role("button", name="Read again").click()
        page.shows("#dialog li", "numbers shifted by 1")
        page.tab.get_by_role("button", name=choice).click()

    load("Add to what is drawn")
    page.until("labeller.state.doc.objects.length === 2")
    assert [item["motion"] for item in page.objects()] == [1, 2]
    load("Replace what is drawn")
    page.until("labeller.state.doc.objects.length === 1")
    page.press("Control+z")
    page.until("labeller.state.doc.objects.length === 2")


def test_occluded_and_outside_leave_no_stray_key_frames(page):
    page.draw()
    page.until("labeller.state.regions?.[1]")
    for key in "eo":
        page.press("ArrowRight", "ArrowRight", key, key)
        assert [k["frame"] for k in page.objects()[0]["key_frames"]] == [0]
    page.press("e", "ArrowRight")
    page.tab.get_by_role("button", name="outside", exact=True).click()
    assert [k["frame"] for k in page.objects()[0]["key_frames"]] == [0, 4]


def test_what_two_motions_claim_is_in_doubt_and_what_is_in_front_is_not(page):
    page.draw()
    page.tab.get_by_label("Kind").select_option("pedestrian")
    page.draw([(x + 30, y + 10) for x, y in CORNERS])
    assert [item["kind"] for item in page.objects()] == ["pedestrian"] * 2
    page.until("labeller.state.weak?.[2]?.every((why) => why === 'overlaps object 1')")
    x, y = (round(at - page.box("#regions")[axis]) for at, axis in zip(page.at((105, 90)), "xy", strict=True))
    place = f"document.getElementById('regions').getContext('2d').getImageData({x}, {y}, 20, 20).data"
    hatched = f"[...{place}].some((blue, k, all) => k % 4 === 2 && blue > 200 && all[k + 1] > 200)"
    page.until(hatched)
    page.press("Escape")
    page.tab.get_by_role("button", name="unlabelled at object 1").click()
    page.until("/in conflict .1 of/.test(labeller.state.hint)")
    page.press("Shift+Digit2", "0")
    page.until(f"!labeller.state.weak[2][0] && !{hatched}")
    page.press("Shift+Digit1")
    page.until("labeller.state.selected === 1")


def test_points_near_the_border_are_on_it(page):
    page.draw([(1, 60), (60, 60), (60, 110), (-4, 110)])
    width, height = page.value("labeller.state.clip.image_size")
    polygon = page.objects()[0]["key_frames"][0]["polygons"][0]
    assert [x for x, _ in polygon] == [-0.5, pytest.approx(60, abs=1), pytest.approx(60, abs=1), -0.5]
    page.drag((60, 110), (width - 2, height + 3))
    assert page.objects()[0]["key_frames"][0]["polygons"][0][2] == [width - 0.5, height - 0.5]
