"""The labelling page when a key, a click or somebody else's work comes at an odd moment."""

from __future__ import annotations

import json
import signal

import pytest
from labeller_page import CORNERS, Page, Server, stored

from kt3dmoseg.annotate import AnnotatedObject, Annotation, KeyFrame, save_revision

pytestmark = pytest.mark.browser

THERE = [(200, 20), (260, 20), (260, 50)]
THIRD = [(20, 150), (60, 150), (60, 180)]
SEEN = "[...Array(6).keys()].map((f) => labeller.state.regions?.[1]?.[f]?.visibility).join(' ')"


def hold(page, pattern):
    """Let the answers to requests wait; the list that is returned gets them."""
    held = []
    page.tab.route(pattern, lambda route: held.append(route))  # builtins have no attributes
    return held


def let_go(page, pattern, held):
    while not held:
        page.tab.wait_for_timeout(20)
    for route in held:
        route.continue_()
    page.tab.unroute(pattern)


def named(page):
    return [(item["name"], item["motion"]) for item in page.objects()]


@pytest.mark.parametrize("keys", [["Shift+P"], ["Escape", "Shift+O"], ["Escape", "n"], []], ids=str)
def test_escape_takes_back_what_the_pointer_began(page, keys):
    page.draw()
    before = page.objects()
    page.press(*keys)
    page.hold((140, 130), (170, 150))
    page.press("Escape")
    page.release((180, 160))
    assert page.objects() == before
    assert page.value(
        "labeller.state.tool === 'select' && !labeller.state.pending && !labeller.state.dragging"
    )


@pytest.mark.parametrize("how", ["Escape", "pointercancel"])
def test_a_key_frame_on_the_timeline_that_is_not_let_go_is_put_back(page, how):
    page.press("ArrowRight", "ArrowRight", "ArrowRight")
    page.draw()
    box = page.box("#timeline")
    y, column = box["y"] + 39, box["width"] / 6
    page.tab.mouse.move(box["x"] + 3.5 * column, y)
    page.tab.mouse.down()
    page.tab.mouse.move(box["x"] + 1.5 * column, y, steps=4)
    page.until("labeller.state.dragging")
    if how == "Escape":
        page.press("Escape")
    else:
        page.tab.locator("#timeline").dispatch_event(how)
    page.tab.mouse.move(box["x"] + 1.4 * column, y, steps=2)
    page.tab.mouse.up()
    assert [key["frame"] for key in page.objects()[0]["key_frames"]] == [3]


def test_keys_do_nothing_in_the_middle_of_a_stroke_and_an_outline_stays_in_its_frame(page):
    page.draw()
    page.press("Shift+P")
    page.hold((140, 100), (150, 100))
    page.press("ArrowRight")
    page.release((160, 100))
    page.until("labeller.state.doc.objects[0].key_frames[0].polygons[0].length > 4")
    page.press("Escape", "Escape", "n")
    for corner in THERE:
        page.click(corner)
    page.press("ArrowRight")
    page.shows("#hint", "An outline is of one frame")
    page.press("Enter")
    assert [[key["frame"] for key in item["key_frames"]] for item in page.objects()] == [[0], [0]]


@pytest.mark.parametrize(
    ("key", "seen"),
    [
        ("Delete", "visible outside visible visible visible visible"),
        ("o", "visible occluded occluded visible visible visible"),
        ("e", "visible outside outside visible visible visible"),
    ],
)
def test_before_the_first_key_frame_the_frames_before_stay_as_they_are(page, key, seen):
    page.press("ArrowRight", "ArrowRight", "ArrowRight")
    page.draw()
    page.press("Home", "ArrowRight", key)
    page.until(f"{SEEN} === '{seen}'")


def test_not_in_this_frame_leaves_the_next_that_was_outlined_by_itself(page):
    page.press("Shift+O")
    page.click((250, 50))
    page.until("labeller.state.doc.objects[0]?.key_frames.length === 6 && !labeller.state.making")
    page.press("Escape", "ArrowRight", "ArrowRight")
    page.tab.locator(".entry .object").click()
    page.press("Delete")
    page.until(f"{SEEN} === 'visible visible outside visible visible visible'")
    page.until("!labeller.state.making")


def test_clicks_belong_to_what_was_selected_when_they_were_made(page):
    held = hold(page, "**/outline")
    page.press("Shift+O")
    page.click((100, 100))
    page.press("Enter")
    page.click((250, 50))
    page.until("labeller.state.selected === null")
    let_go(page, "**/outline", held)
    page.until("labeller.state.doc.objects.length === 2 && !labeller.state.making")
    first, second = ([x for x, _ in item["key_frames"][0]["polygons"][0]] for item in page.objects())
    assert max(first) < 200 < min(second)


def test_a_stroke_is_not_painted_on_another_object(page):
    page.draw()
    page.press("Escape")
    page.draw(THERE)
    before = page.objects()
    held = hold(page, "**/paint")
    page.tab.locator(".entry .object").first.click()
    page.press("Shift+P")
    page.drag((100, 100), (150, 100))
    page.drag((100, 110), (150, 110))
    page.tab.locator(".entry .object").last.click()
    let_go(page, "**/paint", held)
    page.shows("#hint", "Another object was selected meanwhile")
    assert page.objects()[1] == before[1]


def test_undo_while_a_save_is_on_its_way_is_not_called_saved(page, shared):
    held = hold(page, "**/annotation")
    page.draw()
    page.until("labeller.state.saving.kind === 'busy'")
    page.press("Control+z")
    page.until("labeller.state.doc.objects.length === 0")
    assert page.value("labeller.saver.pending")
    assert "saved" not in page.tab.locator("#saved").inner_text()
    assert page.value("Object.keys(localStorage).some((key) => key.startsWith('draft:one'))")
    let_go(page, "**/annotation", held)
    assert page.saved() == 2
    assert not stored(shared).objects


@pytest.mark.parametrize("what", ["a name", "an outline"])
def test_what_is_begun_while_a_merge_comes_goes_to_its_object(context, shared, what):
    ada, bo = Page(context, shared.address), Page(context, shared.address)
    bo.draw(THERE)
    bo.saved()
    held = hold(ada, "**/annotation")
    ada.draw()
    ada.until("labeller.state.saving.kind === 'busy'")
    if what == "a name":
        name = ada.tab.locator("[name=name]")
        name.click()
        name.fill("my van")
    else:
        ada.press("r")
        for corner in CORNERS[:3]:
            ada.click(corner)
    let_go(ada, "**/annotation", held)
    ada.until("labeller.state.doc.objects.length === 2")
    ada.press("Enter")
    ada.saved()
    first, second = stored(shared).objects
    assert len(first.key_frames[0].polygons[0]) == len(THERE)
    if what == "a name":
        assert [first.name, second.name] == ["object 1", "my van"]
    else:
        assert len(second.key_frames[0].polygons[0]) == 3
    assert ada.errors == bo.errors == []


def test_undo_after_a_merge_makes_no_objects(context, shared):
    ada = Page(context, shared.address)
    ada.draw()
    ada.press("4")
    ada.saved()
    bo = Page(context, shared.address)
    bo.tab.locator(".entry .object").click()
    name = bo.tab.locator("[name=name]")
    name.fill("van")
    name.blur()
    bo.saved()
    ada.draw(THERE)
    ada.saved()
    assert named(ada) == [("van", 4), ("object 2", 5)]
    for _ in range(3):
        ada.press("Control+z")
        assert named(ada) == [("van", 4)]
    ada.saved()
    assert ada.errors == bo.errors == []


def test_an_edit_made_while_the_next_clip_is_opened_is_saved(page, shared):
    held = hold(page, "**/api/clips/two")
    page.press("PageDown")
    page.until("!labeller.state.playing")
    page.draw()
    let_go(page, "**/api/clips/two", held)
    page.until("labeller.state.clip.name === 'two' && labeller.state.labels")
    assert len(stored(shared).objects) == 1


def test_a_clip_that_cannot_be_saved_is_left_only_when_asked(page, shared):
    page.tab.route("**/annotation", lambda route: route.fulfill(status=507, json={"error": "disk full"}))
    page.draw()
    page.press("PageDown")
    page.shows("dialog", "could not be saved")
    page.tab.get_by_role("button", name="Stay here").click()
    assert page.value("labeller.state.clip.name") == "one"
    page.press("PageDown")
    page.tab.get_by_role("button", name="Leave it").click()
    page.until("labeller.state.clip.name === 'two' && labeller.state.labels")
    page.tab.unroute("**/annotation")
    page.press("PageUp")
    page.until("labeller.state.clip.name === 'one' && labeller.state.doc.objects.length === 1")
    page.saved()
    assert len(stored(shared).objects) == 1


def test_edits_of_two_tabs_that_were_closed_are_both_restored(context, clips, server):
    pages = [Page(context, server.address) for _ in range(2)]
    server.stop(signal.SIGKILL)
    for page, corners in zip(pages, (THERE, THIRD), strict=True):
        page.draw(corners)
        page.until("labeller.state.saving.kind === 'offline'")
        page.tab.close()
    again = Server(clips, server.notes, server.port)
    try:
        page = Page(context, again.address)
        page.until("labeller.state.doc.objects.length === 2")
        page.saved()
        assert len(stored(server).objects) == 2
    finally:
        again.stop(signal.SIGKILL)


def test_a_page_of_another_folder_is_not_saved_into_this_one(context, clips, server, tmp_path):
    page = Page(context, server.address)
    page.draw()
    page.saved()
    server.stop(signal.SIGKILL)
    second = Server(clips, tmp_path / "second", server.port)
    try:
        page.draw(THERE)
        page.shows("#saved", "another folder of annotations")
        page.tab.reload()
        page.ready()
        assert not page.objects()
        assert not (tmp_path / "second").exists() or not any((tmp_path / "second").glob("*.json"))
    finally:
        second.stop(signal.SIGKILL)


def test_a_damaged_draft_or_one_of_other_frames_keeps_nobody_out(page):
    page.draw()
    page.saved()
    other = "{ ...labeller.state.doc, n_frames: 9, objects: [] }"
    key = "'draft:one:' + labeller.state.clip.folder + "
    page.value(f"localStorage.setItem({key} ':gone', '{{')")
    page.value(f"localStorage.setItem({key} ':older', JSON.stringify({{ base: {other}, doc: {other} }}))")
    page.tab.reload()
    page.ready()
    assert len(page.objects()) == 1
    assert not page.tab.locator("dialog[open]").count()
    assert page.value("Object.keys(localStorage).filter((key) => key.startsWith('draft:')).length") == 2
    page.value("localStorage.clear()")


def test_going_back_closes_the_dialogue_of_the_clip_that_is_left(page):
    page.press("PageDown")
    page.until("labeller.state.clip.name === 'two' && labeller.state.labels")
    held = hold(page, "**/proposals/*")
    page.press("s")
    page.tab.get_by_role("button", name="mseg").click()
    page.shows("dialog", "Asking mseg")
    page.tab.go_back()
    page.until("labeller.state.clip.name === 'one' && labeller.state.labels")
    assert not page.tab.locator("dialog[open]").count()
    let_go(page, "**/proposals/*", held)
    page.press("ArrowRight")
    page.until("labeller.state.frame === 1")
    assert page.value("labeller.state.review") is None


def test_a_copy_waits_for_the_region_of_the_outline_that_is_there_now(page):
    page.draw()
    page.until("labeller.state.carried === labeller.state.doc")
    held = hold(page, "**/regions")
    page.drag((100, 100), (100, 120))
    page.press("c")
    page.shows("#hint", "It is being carried there")
    assert len(page.objects()[0]["key_frames"]) == 1
    let_go(page, "**/regions", held)
    page.until("labeller.state.carried === labeller.state.doc")
    page.press("c")
    page.until("labeller.state.doc.objects[0].key_frames.length === 2")
    lowest = max(y for _, y in page.objects()[0]["key_frames"][1]["polygons"][0])
    assert lowest > CORNERS[2][1] + 10


def test_a_deleted_object_leaves_nothing_to_the_next_of_its_number(page):
    page.draw()
    page.until("labeller.state.carried === labeller.state.doc")
    hold(page, "**/regions")
    page.press("Shift+Delete")
    page.draw(THERE)
    page.press("c")
    page.press("ArrowRight")
    keys = page.objects()[0]["key_frames"]
    assert all(min(x for x, _ in key["polygons"][0]) >= 199 for key in keys)
    page.tab.unroute("**/regions")


def test_two_objects_of_one_motion_stay_of_one_when_they_are_taken(context, clips, tmp_path):
    def drawn(number, name, motion, corners):
        return AnnotatedObject(number, name, "car", motion, (KeyFrame(0, polygons=(tuple(corners),)),))

    theirs = (drawn(1, "tractor", 2, THERE), drawn(2, "trailer", 2, THIRD))
    save_revision(tmp_path / "other" / "one.json", Annotation("one", (320, 200), 6, theirs, annotator="B"))
    server = Server(clips, tmp_path / "notes", 0, "--compare", str(tmp_path / "other"))
    try:
        page = Page(context, server.address)
        page.press("m")
        page.tab.locator("dialog td button").first.click()
        for number in (1, 2):
            page.shows("#differences", f"{number} of ")
            page.tab.get_by_role("button", name="Take theirs").click()
        page.until("labeller.state.doc.objects.length === 2")
        assert [motion for _, motion in named(page)] == [1, 1]
    finally:
        server.stop(signal.SIGKILL)


def test_the_other_clips_are_at_hand_when_the_first_cannot_be_read(context, clips, tmp_path):
    notes = tmp_path / "notes"
    notes.mkdir()
    (notes / "one.json").write_text('{"clip": "o')
    server = Server(clips, notes)
    try:
        tab = context.new_page()
        tab.goto(server.address)
        tab.get_by_role("button", name="Other clips").click()
        tab.locator("[data-clip=two]").click()
        tab.wait_for_url("**/*clip=two*")
    finally:
        server.stop(signal.SIGKILL)


def test_a_key_frame_that_is_reshaped_goes_on_being_carried(page):
    page.draw()
    page.until("labeller.state.carried === labeller.state.doc")
    there = page.value("labeller.state.regions[1][5].polygons[0][0]")
    held = hold(page, "**/regions")
    page.drag(CORNERS[2], (150, 140))
    page.press("End", "v", "l")
    x, y = page.objects()[0]["key_frames"][1]["polygons"][0][0]
    assert abs(x - 1 - there[0]) < 1
    assert abs(y - there[1]) < 1
    let_go(page, "**/regions", held)


@pytest.mark.parametrize("key", ["Delete", "o", "e"])
def test_key_frames_made_by_themselves_do_not_count_as_the_first(page, key):
    page.press("End", "Shift+O")
    page.click((250, 50))
    page.until("labeller.state.doc.objects[0]?.key_frames.length > 2 && !labeller.state.making")
    page.press("Escape")
    page.tab.locator(".entry .object").click()
    page.press("Home", "ArrowRight", "ArrowRight", "ArrowRight", key)
    page.until(
        f"labeller.state.carried === labeller.state.doc && {SEEN}.startsWith('visible visible visible o')"
    )
    page.until("!labeller.state.making")


def test_a_browser_that_forbids_storage_says_so(context, shared):
    tab = context.new_page()
    forbidden = "get() { throw new DOMException('forbidden', 'SecurityError'); }"
    tab.add_init_script(f"Object.defineProperty(window, 'localStorage', {{ {forbidden} }})")
    tab.goto(shared.address)
    tab.get_by_text("Let this page store data in the browser").wait_for()


@pytest.mark.parametrize("by", ["timeline", "list", "key"])
def test_an_outline_goes_to_the_object_that_it_was_begun_for(page, by):
    page.draw()
    page.press("Escape")
    page.draw(THERE)
    before = page.objects()
    page.tab.locator(".entry .object").first.click()
    page.press("r")
    for corner in CORNERS[:3]:
        page.click(corner)
    box = page.box("#timeline")
    if by == "timeline":
        page.tab.mouse.click(box["x"] + 2.5 * box["width"] / 6, box["y"] + 65)
    elif by == "list":
        page.tab.locator(".entry .object").last.click()
    else:
        page.press("]")
    page.click(CORNERS[0])  # closes it
    assert page.objects()[1] == before[1]
    assert len(page.objects()[0]["key_frames"][0]["polygons"][0]) == 3


def test_the_server_away_leaves_copying_and_undo_possible(page, shared):
    page.tab.route("**/annotation", lambda route: route.abort())
    page.draw()
    page.until("labeller.state.saving.kind === 'offline'")
    page.drag((100, 100), (104, 104))
    page.press("c")
    page.until("labeller.state.doc.objects[0].key_frames.length === 2")
    page.press("Control+z", "Control+z", "Control+z")
    page.until("labeller.state.doc.objects.length === 0")
    page.tab.unroute("**/annotation")
    page.until("labeller.state.saving.kind === 'saved'")


def test_copies_that_follow_fast_are_all_made(page):
    page.draw()
    page.until("labeller.state.carried === labeller.state.doc")
    held = hold(page, "**/regions")
    page.press("c", "c", "c")
    assert [key["frame"] for key in page.objects()[0]["key_frames"]] == [0, 1, 2, 3]
    let_go(page, "**/regions", held)


def test_two_strokes_that_follow_fast_are_no_double_click_that_ends_an_outline(page):
    page.draw()
    page.press("Shift+P")
    mouse = page.tab.mouse
    for count in (1, 2):
        mouse.move(*page.at((138, 100)))
        mouse.down(click_count=count)
        mouse.move(*page.at((152, 100)), steps=8)
        mouse.up(click_count=count)
    assert page.value("labeller.state.tool") == "brush"
    page.until("!labeller.state.pending.points.length")
    xs = [x for x, _ in page.objects()[0]["key_frames"][0]["polygons"][0]]
    assert min(xs) < 62 < 150 < max(xs)


def test_space_plays_after_a_click_on_a_button_and_presses_one_chosen_by_key(page):
    page.draw()
    page.draw(THERE)
    page.tab.locator("#motions [value='3']").click()
    page.press("[", "Space")
    assert page.value("labeller.state.playing")
    page.press("Space")
    assert [motion for _, motion in named(page)] == [1, 3]
    for clicked in ("#undo", ".entry .object", "#properties [value=occluded]"):
        page.tab.locator(clicked).first.click()
        page.value("new Promise(requestAnimationFrame)")  # the list is drawn again
        assert page.value("document.activeElement.id") == "stage"
    page.tab.locator("#redo, #undo").first.focus()
    page.press("Enter")
    assert page.value("document.activeElement.id") == "undo"


@pytest.mark.parametrize("place", [(100, 100), (100, 70), (60, 70)], ids=["inside", "edge", "point"])
def test_a_click_on_a_region_that_trembles_changes_nothing(page, place):
    page.draw()
    before = page.objects()
    x, y = page.at(place)
    page.tab.mouse.move(x, y)
    page.tab.mouse.down()
    page.tab.mouse.move(x + 1, y)
    page.tab.mouse.up()
    assert page.objects() == before


@pytest.mark.parametrize("key", ["7", "Delete"])
def test_keys_while_a_new_object_is_drawn_leave_the_one_before_alone(page, key):
    page.draw()
    before = page.objects()
    page.press("n")
    for corner in THERE[:2]:
        page.click(corner)
    page.press(key)
    assert page.objects() == before


def test_a_lasso_is_dropped_when_another_object_is_selected(page):
    page.draw()
    page.press("Escape", "Escape", "q")
    page.drag((200, 20), (260, 20), (260, 60), (200, 60), (200, 22), steps=8)
    page.until("labeller.state.lassoed")
    page.click((100, 100))
    page.tab.locator("#motions [value='5']").click()
    assert named(page) == [("object 1", 5)]
    assert not page.value("labeller.state.doc.marks?.length")


def test_a_small_square_keeps_its_fourth_corner(page):
    x, y = page.at((100, 100))
    page.press("n")
    for dx, dy in ((0, 0), (6, 0), (6, 6), (0, 6)):
        page.tab.mouse.click(x + dx, y + dy)
    page.press("Enter")
    assert [len(item["key_frames"][0]["polygons"][0]) for item in page.objects()] == [4]


def test_an_outline_smaller_than_a_pixel_is_refused(page):
    page.draw([(60, 70), (100, 100), (140, 130)])
    page.shows("#hint", "smaller than a pixel")
    assert page.objects() == []
    for corner in ((60, 70), (140, 130), (140, 70), (60, 130)):  # its two halves turn in opposite directions
        page.click(corner)
    page.press("Enter")
    assert len(page.objects()) == 1


def test_what_needs_trajectories_says_that_they_are_not_there_yet(page):
    page.tab.route("**/tracks", lambda route: route.fulfill(status=202, json={"done": 1, "total": 6}))
    page.tab.reload()
    page.until("window.labeller?.state.doc && labeller.state.view")
    said = "The trajectories are not there yet"
    for key in ("g", "Shift+W"):
        page.press(key)
        assert page.value("labeller.state.hint") == said
        page.press("b")
        assert page.value("labeller.state.hint") != said
    page.press("q")
    page.drag((200, 20), (260, 20), (260, 60), (200, 60), (200, 22), steps=8)
    assert said in page.value("labeller.state.hint")
    page.press("1")
    assert page.value("labeller.state.hint") == f"Marked. {said}"
    page.tab.unroute("**/tracks")
    page.until("labeller.state.labels?.counts.motions[2]")


@pytest.mark.parametrize("key", ["Backspace", "Delete", "e"])
def test_a_point_is_not_chosen_any_more_when_its_key_frame_goes(page, key):
    page.draw()
    page.press("ArrowRight", "r")
    for corner in ((64, 70), (104, 60), (144, 70), (144, 130), (104, 140), (64, 130)):
        page.click(corner)
    page.press("Enter", "Shift+V", key)
    before = page.objects()
    assert page.value("labeller.state.vertex") is None
    page.press("l", "d")
    assert page.objects() == before


@pytest.mark.parametrize("case", ["behind", "away"])
def test_a_key_frame_that_is_moved_keeps_an_outline_of_its_own(page, case):
    page.draw()
    page.press("ArrowRight", *("o" if case == "behind" else ""))
    page.press("End", "r")
    page.until("labeller.state.carried === labeller.state.doc")
    held = hold(page, "**/regions") if case == "away" else []
    for corner in THERE:
        page.click(corner)
    page.press("Enter")
    page.until(f"'{case}' === 'away' || labeller.state.carried === labeller.state.doc")
    page.press("Shift+N")
    key = page.objects()[0]["key_frames"][-1]
    assert (key["frame"], key["visibility"]) == (4, "visible")
    assert min(x for x, _ in key["polygons"][0]) > 180
    if held:
        let_go(page, "**/regions", held)


@pytest.mark.parametrize("again", ["o", "e", "buttons"])
def test_visibility_that_is_taken_back_leaves_the_key_frames_as_they_were(page, again):
    page.draw()
    page.press("ArrowRight", "ArrowRight", "r")
    for corner in THERE:
        page.click(corner)
    page.press("Enter", "End", "e", "Home", "ArrowRight", "ArrowRight")
    before = page.objects()
    for frame in (2, 1):
        if again == "buttons":
            page.tab.locator("button[name=visibility][value=outside]").click()
        else:
            page.press(again)
        assert page.objects() != before
        if again == "buttons":
            page.tab.locator("button[name=visibility][value=visible]").click()
        else:
            page.press(again)
        assert page.objects() == before, frame
        page.press("ArrowLeft")


MADE = "labeller.state.doc.objects.at(-1)?.key_frames.length > 1 && labeller.state.making === null"


def outline_what_is_in_doubt(page):
    """Outline something with few trajectories; the key frames that it gets by itself are held back."""
    held = hold(page, "**/made")
    page.press("Shift+O")
    page.drag((90, 90), (106, 106))
    while not held:
        page.tab.wait_for_timeout(20)
    page.press("Escape")
    return held


def test_undo_of_the_motion_keeps_key_frames_made_by_themselves(page):
    held = outline_what_is_in_doubt(page)
    page.press("4")
    let_go(page, "**/made", held)
    page.until(MADE)
    before = len(page.objects()[0]["key_frames"])
    page.press("Control+z")
    assert named(page) == [("object 1", 1)]
    assert len(page.objects()[0]["key_frames"]) == before
    page.press("Control+z")
    assert not page.objects()


@pytest.mark.parametrize("what", ["itself", "another object"])
def test_key_frames_made_by_themselves_wait_for_the_end_of_a_drag(page, what):
    page.draw(THIRD)
    page.press("Escape")
    held = outline_what_is_in_doubt(page)
    if what == "another object":
        page.tab.locator(".entry .object").first.click()
    place = (98, 98) if what == "itself" else (55, 160)
    page.hold(place, (place[0] + 5, place[1] + 5))
    page.until("labeller.state.dragging")
    with page.tab.expect_response("**/made"):
        let_go(page, "**/made", held)
    page.tab.wait_for_timeout(200)
    page.release((place[0] + 6, place[1] + 6))
    page.until(MADE)


def test_two_objects_outlined_one_after_the_other_both_get_key_frames_by_themselves(page):
    page.value(
        "(() => { const later = setTimeout; window.setTimeout = (run, ms, ...more) =>"
        " later(run, ms === 400 ? 3000 : ms, ...more); })()"
    )
    page.press("Shift+O")
    page.drag((90, 90), (106, 106))
    page.press("Enter")
    page.click((250, 50))
    page.until("labeller.state.doc.objects.length === 2")
    page.until(MADE)
    assert all(len(item["key_frames"]) > 1 for item in page.objects())


@pytest.mark.parametrize("then", ["PageDown", "done"])
def test_another_clip_and_the_state_wait_for_key_frames_made_by_themselves(page, shared, then):
    held = outline_what_is_in_doubt(page)
    if then == "done":
        page.value("localStorage.setItem('annotator', 'me')")
        page.tab.get_by_label("State of this clip").select_option("done")
    else:
        page.press(then)
    page.tab.wait_for_timeout(700)  # what does not wait is there by then
    let_go(page, "**/made", held)
    if then == "done":
        page.until(MADE)
        page.saved()
        page.until("labeller.state.work?.state === 'done'")
        page.until("document.getElementById('state').value === 'done'")
    else:
        page.until("labeller.state.clip.name === 'two' && labeller.state.labels")
    assert len(stored(shared).objects[0].key_frames) > 1


def test_clicks_that_wait_go_to_no_object_that_is_selected_later(page):
    page.draw()
    page.draw(THERE)
    before = page.objects()
    page.press("Escape", "Shift+O", "]")
    held = hold(page, "**/outline")
    page.click((100, 100))
    page.click((110, 100))
    page.press("]")
    page.until("labeller.state.selected === 2")
    with page.tab.expect_response("**/outline"):
        let_go(page, "**/outline", held)
    page.shows("#hint", "Another object was selected meanwhile")
    assert page.objects() == before


def test_quick_clicks_on_something_new_are_of_one_object(page):
    page.draw(THIRD)
    held = hold(page, "**/outline")
    page.press("Shift+O")
    page.click((250, 50))
    page.click((240, 50))
    let_go(page, "**/outline", held)
    page.until("labeller.state.done.length === 3 && labeller.state.making === null")
    assert len(page.objects()) == 2


def test_a_click_while_the_next_new_object_is_being_made_extends_that_one(page):
    asked = []
    page.tab.on(
        "request", lambda r: r.url.endswith("/outline") and asked.append(json.loads(r.post_data)["clicks"])
    )
    page.tab.route("**/outline", lambda route: (page.tab.wait_for_timeout(300), route.continue_()))
    page.press("Shift+O")
    page.click((100, 100))
    page.press("Shift+O")
    page.click((90, 90))
    page.until("labeller.state.doc.objects.length === 1 && labeller.state.selected === null")
    page.click((120, 110))
    page.until("labeller.state.doc.objects.length === 2 && !labeller.state.making")
    assert [len(clicks) for clicks in asked] == [1, 1, 2]
