"""Looking over a clip in the labelling page: progress, proposals, problems, a second annotator."""

from __future__ import annotations

import json
import shutil
import signal
from dataclasses import replace

import cv2
import numpy as np
import pytest
from annotation_scenes import drawn_by_hand
from labeller_page import CORNERS, Page, Server, near

from kt3dmoseg.annotate import AnnotatedObject, KeyFrame, load_annotation, save_annotation
from kt3dmoseg.annotate.model import PROPOSALS, to_json

pytestmark = pytest.mark.browser

HALF = [(60, 70), (100, 70), (100, 130), (60, 130)]
SAME_PLACE = [(60, 70), (140, 70), (140, 130), (60, 131)]


# Watches the picture for twenty seconds, or until two different ones were seen.
DIFFERENT_PICTURES = """() => new Promise((done) => {
  const context = document.getElementById("picture").getContext("2d");
  const seen = new Set();
  const end = performance.now() + 20000;
  const look = () => {
    seen.add(context.getImageData(0, 0, 800, 400).data.join());
    if (seen.size < 2 && performance.now() < end) requestAnimationFrame(look);
    else done(seen.size);
  };
  look();
})"""


def draw_by_hand(path, clip, n_frames, corners, motion=1):
    drawn_by_hand(path / f"{clip}.json", "box", corners, motion, clip, n_frames, "B")


@pytest.fixture(scope="module")
def equipped(clips, tmp_path_factory):
    """A server with masks and another annotator's files."""
    folder = tmp_path_factory.mktemp("equipped")
    masks = folder / "masks" / "one"
    masks.mkdir(parents=True)
    for k in range(6):
        mask = np.zeros((200, 320), np.uint8)
        mask[70:130, 60 + 4 * k : 140 + 4 * k] = 1
        mask[10:40, 200:240] = 2
        mask[150:180, 200:240] = 3
        cv2.imwrite(str(masks / f"{k + 1:06d}.png"), mask)  # named as the frames are
    draw_by_hand(folder / "other", "one", 6, HALF)
    server = Server(
        clips, folder / "notes", 0, "--masks", str(folder / "masks"), "--compare", str(folder / "other")
    )
    server.notes = folder / "notes"
    yield server
    server.stop(signal.SIGKILL)


@pytest.fixture
def reviewer(context, equipped):
    shutil.rmtree(equipped.notes, ignore_errors=True)
    made = Page(context, equipped.address)
    yield made
    assert made.errors == []


def button(page, name):
    return page.tab.get_by_role("button", name=name, exact=True)


def colour(page, layer, point):
    """Red, green, blue, alpha of a canvas at an image position."""
    x, y = page.at(point)
    box = page.box("#stage")
    where = f"{round(x - box['x'])}, {round(y - box['y'])}, 1, 1"
    return page.value(f"[...document.getElementById('{layer}').getContext('2d').getImageData({where}).data]")


def test_proposals_are_accepted_corrected_or_rejected_by_a_person(reviewer):
    reviewer.press("s")
    assert button(reviewer, "tracklets").is_disabled()
    button(reviewer, "masks").click()
    reviewer.until("labeller.state.review")
    assert reviewer.objects() == []
    reviewer.press("]")
    reviewer.until("labeller.state.review.index === 1")
    reviewer.press("]", "]")
    reviewer.until("labeller.state.review.index === 0 && document.activeElement.textContent === 'Accept'")
    button(reviewer, "Reject").click()
    reviewer.until("labeller.state.proposals.length === 2")
    button(reviewer, "Correct").click()
    reviewer.until("labeller.state.doc.objects.length === 1")
    reviewer.shows("#review", "correct it")
    assert reviewer.value("document.activeElement.id") == "stage"  # keys edit at once
    points = reviewer.objects()[0]["key_frames"][0]["polygons"][0]
    lowest = max(range(len(points)), key=lambda k: points[k][1] - points[k][0])
    x, y = points[lowest]
    reviewer.press("Shift+Z", "Home")
    reviewer.drag((x, y), (x - 6, y + 6))
    button(reviewer, "Go on (1 left)").click()
    reviewer.until("document.activeElement.textContent === 'Accept'")
    held = "new KeyboardEvent('keydown', { key: 'Enter', repeat: true, cancelable: true, bubbles: true })"
    assert reviewer.value(f"document.activeElement.dispatchEvent({held})") is False  # accepts nothing unseen
    reviewer.press("Enter")
    reviewer.until("!labeller.state.review")
    corrected, accepted = reviewer.objects()
    assert (corrected["name"], accepted["name"]) == ("motion 2", "motion 3")
    assert (corrected["motion"], accepted["motion"]) == (1, 2)
    assert corrected["key_frames"][0]["polygons"][0][lowest] == pytest.approx([x - 6, y + 6], abs=1)
    # Masks were named 000001.png on, as the frames: the first belongs to the first frame.
    assert [key["frame"] for key in accepted["key_frames"]] == [0, 1, 2, 3, 4, 5]


def test_what_the_build_proposed_is_shown_until_somebody_has_drawn(context, equipped):
    shutil.rmtree(equipped.notes, ignore_errors=True)
    draw_by_hand(equipped.notes, "one", 6, SAME_PLACE)
    proposed = load_annotation(equipped.notes / "one.json")
    save_annotation(equipped.notes / "one.proposals.json", replace(proposed, revision=0), PROPOSALS)
    (equipped.notes / "one.json").unlink()
    page = Page(context, equipped.address)
    page.until("labeller.state.review")
    assert page.objects() == []
    button(page, "Accept").click()
    page.until("!labeller.state.review")
    page.saved()
    assert len(load_annotation(equipped.notes / "one.json").objects) == 1
    again = Page(context, equipped.address)
    again.until("labeller.state.moving !== undefined && labeller.state.tracks")
    assert again.value("labeller.state.proposals") is None
    assert page.errors == again.errors == []


def test_an_outline_that_crosses_itself_is_filled_as_it_is_labelled(page):
    turns = 4 * np.pi * np.arange(5) / 5
    page.draw([(150 + 80 * np.sin(a), 100 - 80 * np.cos(a)) for a in turns.tolist()])
    page.press("Shift+B")
    (x, y), box = page.at((150, 100)), page.box("#stage")
    block = f"{round(x - box['x'] - 8)}, {round(y - box['y'] - 8)}, 16, 16"
    layer = "document.getElementById('regions').getContext('2d')"
    inked = f"Math.max(...{layer}.getImageData({block}).data.filter((_, k) => k % 4 === 3))"
    page.value("new Promise(requestAnimationFrame)")
    assert page.value(inked) == 0
    page.press("Shift+B", "Escape")
    page.draw([(130, 80), (170, 80), (170, 120), (130, 120)])
    page.press("2")
    page.value("new Promise(requestAnimationFrame)")
    assert page.value(inked) == 0  # they overlap elsewhere


def test_keys_in_a_review_leave_what_was_accepted_before_alone(reviewer):
    reviewer.press("s")
    button(reviewer, "masks").click()
    reviewer.until("labeller.state.review && document.activeElement.textContent === 'Accept'")
    reviewer.press("Enter")
    reviewer.until("labeller.state.review?.item && labeller.state.doc.objects.length === 1")
    before = reviewer.objects()
    reviewer.press("x", "7", "Delete")
    assert reviewer.objects() == before


def test_escape_ends_the_review_and_keeps_nothing(reviewer):
    reviewer.press("s")
    button(reviewer, "masks").click()
    reviewer.until("labeller.state.review")
    reviewer.press("Escape")
    reviewer.until("!labeller.state.review && !labeller.state.proposals")
    assert reviewer.objects() == []


def test_the_state_of_a_clip_is_what_its_annotator_sets(context, equipped):
    shutil.rmtree(equipped.notes, ignore_errors=True)
    draw_by_hand(equipped.notes, "two", 3, CORNERS)
    page = Page(context, equipped.address)
    state = page.tab.get_by_label("State of this clip")
    assert state.input_value() == "not started"
    page.draw()
    page.saved()
    page.until("document.getElementById('state').value === 'in work'")
    state.select_option("done")
    page.tab.get_by_label("your name").fill("Ada")
    page.press("Enter")
    page.until("labeller.state.work.state === 'done'")
    page.until("document.getElementById('state').title.startsWith('by Ada, ')")
    page.press("F2")
    page.until("labeller.state.summaries?.every(clip => !clip.counting)")
    page.shows("dialog p", "2 clips: 0 not started, 1 in work, 1 done, 0 reviewed.")
    page.shows("dialog td", "by Ada")
    button(page, "You: Ada").click()
    page.tab.get_by_label("your name").fill("Bo")
    page.press("Enter")
    page.press("2")
    page.saved()
    page.until("document.getElementById('state').value === 'in work'")
    page.until("document.getElementById('state').title.startsWith('changed since done by Ada')")
    state.select_option("reviewed")
    page.until("document.getElementById('state').title.startsWith('by Bo, ')")
    page.tab.reload()
    page.ready()
    assert state.input_value() == "reviewed"
    page.press("PageDown")
    page.until("labeller.state.clip.name === 'two' && labeller.state.labels")
    assert state.input_value() == "in work"
    page.press("F2")
    page.shows("dialog p", "0 not started, 1 in work, 0 done, 1 reviewed.")
    page.tab.get_by_label("two is assigned to").fill("Cy")
    page.press("ArrowDown")  # opens the names of the team, and stays in the field
    assert page.value("document.activeElement.ariaLabel") == "two is assigned to"
    page.press("Tab")
    page.until("labeller.state.work.assigned === 'Cy'")
    page.shows("dialog p", "Bo: 1 done, 0.0 minutes each")
    page.tab.get_by_label("Show clips with").fill("cy")
    page.until("document.querySelectorAll('dialog tr button').length === 1")
    assert page.errors == []


def test_going_back_from_the_first_clip_leaves_the_page(page, shared):
    other = page.tab.context.new_page()
    other.goto(shared.address + "api/clips")
    assert page.value("history.length") == other.evaluate("history.length")
    page.press("PageDown")
    page.until("labeller.state.clip.name === 'two' && location.search === '?clip=two'")
    page.tab.go_back()
    page.until("labeller.state.clip.name === 'one' && location.search === '?clip=one'")


def test_each_of_a_team_opens_the_page_as_themselves(browser, clips, tmp_path):
    (tmp_path / "team").write_text("Ada\nBo\n")
    server = Server(clips, tmp_path / "notes", 0, "--team", str(tmp_path / "team"))
    try:
        names = dict(line.split("\t") for line in (tmp_path / "team").read_text().splitlines())
        pages = {
            name: Page(browser.new_context(), server.address.split("?")[0] + f"?token={token}&clip=two")
            for name, token in names.items()
        }
        for name, page in pages.items():
            clip = page.value("labeller.state.clip")
            assert (clip["annotator"], clip["name"]) == (name, "two")
            page.draw()  # both the first object, without the other's in view
            page.press("4" if name == "Ada" else "7")
            page.saved()
        log = (tmp_path / "notes" / "two.log.jsonl").read_text().splitlines()
        assert list(dict.fromkeys(json.loads(line)["by"] for line in log)) == ["Ada", "Bo"]
        assert {item.motion for item in load_annotation(tmp_path / "notes" / "two.json").objects} == {4, 7}
        for page in pages.values():
            assert page.errors == []
            page.tab.context.close()
    finally:
        server.stop(signal.SIGKILL)


def test_motion_that_no_outline_explains_is_found(page):
    page.press("Shift+U")
    page.shows("#hint", "leave the motion of the scene (1 of 1)")
    x, y = page.value("labeller.state.cross")
    assert 60 < x < 165
    assert 70 < y < 130
    page.press("Shift+Z", "Home")
    page.draw()
    page.until("labeller.state.labels?.counts.motions[2] > 10")
    page.press("Shift+U")
    page.shows("#hint", "No trajectories seem to move by themselves")


def test_weak_frames_are_hatched_counted_and_visited(page):
    page.draw()
    page.until("labeller.state.weak?.[1]")
    assert page.value("labeller.state.weak[1].some(Boolean)") is False
    page.draw([(200, 20), (206, 20), (206, 26), (200, 26)])
    page.until("labeller.state.weak?.[2]")
    assert page.value("labeller.state.weak[2].map(Boolean)") == [False, *[True] * 5]
    page.shows(".entry .weak", "5 weak")
    page.shows("#progress", "5 weak")
    hatched = (
        "(() => { const canvas = document.getElementById('timeline'); const box = [FRAME + 0.1, FRAME + 0.4]"
        ".map((at) => Math.round(at * canvas.width / 6)); const top = 26 + 26 * ROW + 3; "
        "return Math.max(...canvas.getContext('2d').getImageData(box[0], top, box[1] - box[0], 4).data"
        ".filter((_, k) => k % 4 === 3)) > 120; })()"
    )
    page.until(hatched.replace("FRAME", "3").replace("ROW", "1"))
    assert not page.value(hatched.replace("FRAME", "3").replace("ROW", "0"))
    page.press("Home", "Escape", "Escape", "Shift+W")
    page.until("labeller.state.selected === 2 && labeller.state.frame === 1")
    page.shows("#hint", "object 2: follows")
    page.press("Shift+W")
    page.until("labeller.state.frame === 2")
    page.press("Shift+Delete")
    page.press("Shift+W")
    page.until("labeller.state.hint === 'No frame is in doubt'")


def test_long_work_shows_its_time_and_can_be_cancelled(reviewer):
    go = []
    reviewer.tab.route("**/proposals/masks", lambda route: go.append(route))
    reviewer.press("s")
    button(reviewer, "masks").click()
    reviewer.shows("dialog p", "Asking masks… 1 s")
    button(reviewer, "Cancel").click()
    reviewer.draw()
    for route in go:
        route.fulfill(json={"objects": []})
    reviewer.saved()
    assert reviewer.value("document.querySelector('dialog[open]')") is None
    assert len(reviewer.objects()) == 1


def test_an_import_that_was_left_does_not_come_back_over_what_is_drawn_meanwhile(page, tmp_path):
    held = []
    page.tab.route("**/import/coco*", lambda route: held.append(route))
    (tmp_path / "file.json").write_text("{}")
    page.press("Control+e")
    page.tab.get_by_role("row", name="COCO").locator("input").set_input_files(tmp_path / "file.json")
    page.shows("dialog p", "Reading file.json")
    page.press("Escape")
    page.draw()
    for route in held:
        route.fulfill(json={"objects": [], "plan": {"lines": [], "skipped": [], "doubts": []}})
    page.saved()
    assert page.value("document.querySelector('dialog[open]')") is None
    assert len(page.objects()) == 1


def test_what_somebody_saves_while_an_import_is_under_review_is_kept(reviewer, equipped, tmp_path):
    held = []
    reviewer.tab.route("**/annotation", lambda route: held.append(route))
    (tmp_path / "file.json").write_text("{}")
    reviewer.draw()
    reviewer.until("labeller.state.saving.kind === 'busy'")
    key = {"frame": 0, "visibility": "visible", "polygons": [[[5, 5], [30, 5], [30, 30]]]}
    bus = {"id": 1, "name": "bus", "kind": "bus", "motion": 1, "note": "", "key_frames": [key]}
    plan = {"lines": ["1 object"], "skipped": [], "doubts": []}
    reviewer.tab.route("**/import/coco*", lambda route: route.fulfill(json={"objects": [bus], "plan": plan}))
    reviewer.press("Control+e")
    reviewer.tab.get_by_role("row", name="COCO").locator("input").set_input_files(tmp_path / "file.json")
    reviewer.shows("dialog li", "1 object")
    theirs = {"objects": [bus | {"id": 9, "name": "theirs", "motion": 4}], "revision": 1}
    equipped.notes.mkdir()
    (equipped.notes / "one.json").write_text(json.dumps(reviewer.value("labeller.state.doc") | theirs))
    reviewer.tab.unroute("**/annotation")
    for route in held:
        route.continue_()
    reviewer.until("labeller.state.doc.objects.length === 2")
    button(reviewer, "Add to what is drawn").click()
    reviewer.shows("dialog li", "what is drawn has changed")
    button(reviewer, "Add to what is drawn").click()
    reviewer.until("labeller.state.doc.objects.length === 3")
    assert sorted(item["name"] for item in reviewer.objects()) == ["bus", "object 1", "theirs"]
    reviewer.saved()


def test_two_annotators_are_compared_and_adjudicated_object_by_object(reviewer, equipped):
    walker = [[200, 20], [230, 20], [230, 60], [200, 60]]
    theirs = load_annotation(equipped.notes.parent / "other" / "one.json")
    key = KeyFrame(2, polygons=(tuple(map(tuple, walker)),))
    both = (*theirs.objects, AnnotatedObject(2, "woman with a walker", "pedestrian", 7, (key,)))
    path = equipped.notes.parent / "other" / "one.json"
    path.write_text(json.dumps(to_json(replace(theirs, objects=both))))
    reviewer.draw()
    reviewer.draw([(20, 150), (50, 150), (50, 180), (20, 180)])
    reviewer.saved()
    reviewer.press("m")
    reviewer.until("labeller.state.compared")
    found = reviewer.value("labeller.state.compared")
    reviewer.shows("dialog[open]", f"kappa {found['kappa']:.3f}, mean IoU")
    listed = reviewer.tab.locator("dialog tr button").all_inner_texts()
    assert listed[-1] == "labels differ: object 1 / box"
    assert sorted(listed[:2]) == ["missed by the other: object 2", "missed by you: woman with a walker"]
    button(reviewer, "missed by you: woman with a walker").click()
    reviewer.shows("#differences", "missed by you: woman with a walker")
    button(reviewer, "Take theirs").click()
    reviewer.until("labeller.state.doc.objects.length === 3")
    button(reviewer, "List").click()
    assert sorted(reviewer.tab.locator("dialog td:last-child").all_inner_texts()) == ["", "", "theirs"]
    reviewer.saved()
    reviewer.tab.route("**/annotation", lambda route: route.abort())  # what follows stays unsaved
    reviewer.press("Escape", "4")
    # What the server has, as if somebody else had saved it meanwhile.
    join = "import('/static/saving.js').then(({ join }) => join(structuredClone(labeller.saver.base)))"
    reviewer.value(join)
    reviewer.tab.unroute("**/annotation")
    button(reviewer, "List").click()
    assert sorted(reviewer.tab.locator("dialog td:last-child").all_inner_texts()) == ["", "", "theirs"]
    reviewer.press("Escape", "Control+z", "Control+z")
    button(reviewer, "List").click()
    assert reviewer.tab.locator("dialog td:last-child").all_inner_texts() == ["", "", ""]
    button(reviewer, "missed by the other: object 2").click()
    button(reviewer, "Delete, as theirs").click()
    reviewer.until("labeller.state.doc.objects.length === 1")
    button(reviewer, "List").click()
    rows = reviewer.tab.locator("dialog tr", has=reviewer.tab.locator("td")).all_inner_texts()
    assert [row.split("\t")[0] for row in rows if row.endswith("theirs")] == ["missed by the other: object 2"]
    reviewer.press("Escape", "Control+z")
    button(reviewer, "List").click()
    button(reviewer, "missed by you: woman with a walker").click()
    button(reviewer, "Take theirs").click()
    reviewer.until("labeller.state.doc.objects.length === 3")
    button(reviewer, "List").click()
    button(reviewer, "missed by you: woman with a walker").click()
    reviewer.shows("#differences", "Ctrl+Z takes it back")  # and not once more
    assert not button(reviewer, "Take theirs").count()
    assert reviewer.objects()[2]["key_frames"][0]["polygons"] == [walker]
    assert (reviewer.objects()[2]["name"], reviewer.objects()[2]["motion"]) == ("woman with a walker", 3)
    button(reviewer, "List").click()
    button(reviewer, "missed by the other: object 2").click()
    button(reviewer, "Delete, as theirs").click()
    reviewer.until("labeller.state.doc.objects.length === 2")
    reviewer.shows("#differences", "labels differ: object 1 / box, IoU 0.4")
    polygon = reviewer.value("labeller.state.compared.regions[1][labeller.state.frame].polygons[0]")
    (right, top), (_, bottom) = polygon[1:3]
    edge = [colour(reviewer, "regions", (right, y)) for y in np.linspace(top + 5, bottom - 5, 40)]
    assert max(min(pixel[:3]) for pixel in edge) > 120  # their outline, dashed white
    next_to_it = [colour(reviewer, "regions", (right - 8, y)) for y in np.linspace(top + 5, bottom - 5, 40)]
    assert max(min(pixel[:3]) for pixel in next_to_it) < 60
    button(reviewer, "Redraw").click()
    reviewer.until("labeller.state.tool === 'draw' && labeller.state.pending.mode === 'region'")
    reviewer.press("Escape", "Shift+R")
    button(reviewer, "Take theirs").click()
    reviewer.shows("#hint", "is locked")
    reviewer.press("Shift+R")
    button(reviewer, "Take theirs").click()
    reviewer.shows("dialog[open] td", "theirs")
    assert near(reviewer.objects()[0]["key_frames"][0]["polygons"][0], HALF)
    button(reviewer, "Close").click()
    reviewer.until("labeller.state.compared === null")
    reviewer.tab.locator("#differences").wait_for(state="hidden")  # drawn a moment after the state


def to_list(page):
    """Open the list of differences, unless it is open because none is left below."""
    if not page.value("document.querySelector('dialog').open"):
        button(page, "List").click()


def test_a_decision_is_not_of_an_object_that_took_the_number_of_mine(reviewer):
    reviewer.draw([(20, 150), (50, 150), (50, 180), (20, 180)])
    reviewer.saved()
    reviewer.press("m")
    button(reviewer, "missed by the other: object 1").click()
    button(reviewer, "Delete, as theirs").click()
    reviewer.until("labeller.state.doc.objects.length === 0")
    to_list(reviewer)
    button(reviewer, "missed by you: box").click()
    button(reviewer, "Take theirs").click()
    reviewer.until("labeller.state.doc.objects.length === 1")
    to_list(reviewer)
    button(reviewer, "missed by the other: object 1").click()
    assert reviewer.value("labeller.state.selected") is None
    to_list(reviewer)
    button(reviewer, "missed by you: box").click()
    reviewer.shows("#differences", "Ctrl+Z takes it back")
    reviewer.press("Control+z")
    reviewer.shows("#differences", "Take theirs")


def test_what_is_in_conflict_is_shown_and_found(page):
    page.draw()
    page.draw(SAME_PLACE)
    page.until("labeller.state.labels?.counts.conflict > 10")
    row = page.value("labeller.state.labels.reason.indexOf(3)")
    x, y = page.value(f"[...labeller.state.tracks.xy.slice({2 * 6 * row}, {2 * 6 * row + 2})]")
    other = page.value("labeller.state.labels.reason.indexOf(0)")
    elsewhere = page.value(f"[...labeller.state.tracks.xy.slice({2 * 6 * other}, {2 * 6 * other + 2})]")
    assert colour(page, "tracks", (x, y))[:3] == [255, 43, 214]
    assert colour(page, "tracks", elsewhere)[3] > 0
    page.press("u")
    page.until("labeller.state.problems")
    page.value("new Promise(requestAnimationFrame)")
    assert colour(page, "tracks", (x, y))[:3] == [255, 43, 214]
    assert colour(page, "tracks", elsewhere)[3] == 0
    page.press("g")
    page.until("labeller.state.hint.includes('in conflict (1 of')")
    assert page.value("labeller.state.view.scale") >= 4
    page.press("Shift+Z", "q")
    page.drag((55, 60), (190, 60), (190, 140), (55, 140), (55, 62), steps=12)
    page.press("2")
    page.until("labeller.state.labels.counts.conflict === 0")


def test_clips_flicker_play_zoom_and_pan(page):
    page.press("f")
    page.until("labeller.state.flickered === 1")
    page.until("labeller.state.flickered === 0")
    assert page.tab.evaluate(DIFFERENT_PICTURES) == 2
    page.press("f", "Space")
    page.until("labeller.state.frame >= 2")
    page.press("Space")
    assert page.value("labeller.state.flickered") is None
    before = page.value("labeller.state.view")
    page.tab.mouse.move(*page.at((100, 100)))
    where = page.at((100, 100))
    page.tab.keyboard.down("Control")
    page.tab.mouse.wheel(0, -400)
    page.tab.keyboard.up("Control")
    page.until(f"labeller.state.view.scale > {before['scale']}")
    assert page.at((100, 100)) == pytest.approx(where, abs=1.5)
    page.drag((250, 20), (260, 40))
    assert page.value("labeller.state.view.y") != before["y"]
    page.press("Shift+Z", *["Control+ArrowLeft"] * 40, *["Control+ArrowUp"] * 40)
    left, top = page.at((0, 0))
    box = page.box("#stage")
    assert (box["x"] + box["width"] - left, box["y"] + box["height"] - top) == pytest.approx((60, 60), abs=1)
    page.press("F2")
    page.tab.get_by_role("button", name="two", exact=True).click()
    page.until("labeller.state.clip.name === 'two' && labeller.state.labels")
    assert "clip=two" in page.tab.url
