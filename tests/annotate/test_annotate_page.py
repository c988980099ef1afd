"""The labelling page in a real Chromium, against a real server process."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from annotation_scenes import write_clip
from playwright.sync_api import sync_playwright

from kt3dmoseg.annotate import load_annotation

pytestmark = pytest.mark.browser

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
LIMIT = 60.0
CORNERS = [(60, 70), (140, 70), (140, 130), (60, 130)]


@pytest.fixture(scope="module")
def browser():
    if not CHROMIUM:
        pytest.fail("Chromium is not installed; .ci/run installs it")
    with sync_playwright() as playwright:
        yield playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    folder = tmp_path_factory.mktemp("clips")
    write_clip(folder, "one")
    write_clip(folder, "two", frames=3, tracks=50)
    return folder


class Server:
    """`kt3dmoseg label` as a process of its own."""

    def __init__(self, clips, notes, port=0, *extra):
        command = [sys.executable, "-m", "kt3dmoseg.cli", "label", str(clips / "frames"), "--no-browser"]
        command += [
            "--tracks",
            str(clips / "tracks"),
            "--annotations",
            str(notes),
            "--port",
            str(port),
            *extra,
        ]
        environment = os.environ | {"OMP_NUM_THREADS": "1"}
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
        for line in self.process.stdout:
            if found := re.search(r"http://\S+:(\d+)/\S*", line):
                self.address, self.port = found.group(0), int(found.group(1))
                return
        raise AssertionError("the server did not start")

    def stop(self, how=signal.SIGINT):
        if self.process.poll() is None:
            self.process.send_signal(how)
        self.process.wait(timeout=LIMIT)
        self.process.stdout.close()


class Page:
    """A tab, in terms of the image."""

    def __init__(self, context, address):
        self.tab = context.new_page()
        self.errors = []
        self.tab.on("pageerror", lambda error: self.errors.append(str(error)))
        self.tab.goto(address)
        self.ready()

    def ready(self):
        self.until("window.labeller?.state.labels && labeller.state.loaded")

    def value(self, expression):
        return self.tab.evaluate(f"() => {expression}")

    def until(self, expression, limit=LIMIT):
        end = time.monotonic() + limit
        while not self.value(f"!!({expression})"):
            assert time.monotonic() < end, (expression, self.errors)
            time.sleep(0.02)

    def at(self, point):
        box = self.tab.locator("#stage").bounding_box()
        view = self.value("labeller.state.view")
        return [box[k] + (point[i] - view[k]) * view["scale"] for i, k in enumerate("xy")]

    def click(self, point, **options):
        self.tab.mouse.click(*self.at(point), **options)

    def drag(self, start, *stops, steps=4):
        self.tab.mouse.move(*self.at(start))
        self.tab.mouse.down()
        for stop in stops:
            self.tab.mouse.move(*self.at(stop), steps=steps)
        self.tab.mouse.up()

    def press(self, *keys):
        for key in keys:
            self.tab.keyboard.press(key)

    def draw(self, corners=CORNERS):
        self.press("n")
        for corner in corners:
            self.click(corner)
        self.press("Enter")

    def objects(self):
        return self.value("labeller.state.doc.objects")

    def saved(self):
        """Wait until everything is saved; return the revision in view."""
        self.until("labeller.state.saving.kind === 'saved' && !labeller.saver.pending")
        self.until("document.getElementById('saved').textContent.includes('rev ')")
        return int(re.search(r"rev (\d+)", self.tab.locator("#saved").inner_text()).group(1))


@pytest.fixture(scope="module")
def running(clips, tmp_path_factory):
    """One server for all tests that leave it alone; it keeps nothing of an annotation but its file."""
    notes = tmp_path_factory.mktemp("shared") / "notes"
    server = Server(clips, notes)
    server.notes = notes
    yield server
    server.stop(signal.SIGKILL)


@pytest.fixture
def shared(running):
    shutil.rmtree(running.notes, ignore_errors=True)
    return running


@pytest.fixture
def server(clips, tmp_path):
    """A server that the test may kill."""
    own = Server(clips, tmp_path / "notes")
    own.notes = tmp_path / "notes"
    yield own
    own.stop(signal.SIGKILL)


@pytest.fixture
def context(browser):
    made = browser.new_context(viewport={"width": 1280, "height": 720}, accept_downloads=True)
    made.set_default_timeout(1000 * LIMIT)
    yield made
    made.close()


@pytest.fixture
def page(context, shared):
    made = Page(context, shared.address)
    yield made
    assert made.errors == []


def stored(server, clip="one"):
    return load_annotation(server.notes / f"{clip}.json")


def near(polygon, corners, reach=1.0):
    return len(polygon) == len(corners) and all(
        abs(x - a) < reach and abs(y - b) < reach for (x, y), (a, b) in zip(polygon, corners, strict=True)
    )


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
    assert page.tab.locator("dialog[open] .help").is_visible()
    page.press("Escape")
    assert page.value("document.activeElement.id") == "stage"
    page.press("PageDown")
    page.until("labeller.state.clip.name === 'two'")


def test_properties_are_edited_beside_the_frame(page, shared):
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


def test_second_tab_conflict_keeps_both(context, shared):
    first, second = Page(context, shared.address), Page(context, shared.address)
    first.draw()
    first.saved()
    second.draw([(200, 20), (260, 20), (260, 50)])
    second.until("labeller.state.saving.kind === 'conflict'")
    assert second.tab.locator("dialog[open]").is_visible()
    second.press("Escape")
    assert second.tab.locator("dialog[open]").is_visible()
    assert len(stored(shared).objects) == 1
    second.tab.get_by_role("button", name="Merge both").click()
    assert second.saved() == 2
    assert sorted(len(o.key_frames[0].polygons[0]) for o in stored(shared).objects) == [3, 4]
    assert first.errors + second.errors == []


@pytest.mark.parametrize(("choice", "corners"), [("Keep mine", 3), ("Take theirs", 4)])
def test_conflict_choices_are_edits_that_can_be_undone(context, shared, choice, corners):
    first, second = Page(context, shared.address), Page(context, shared.address)
    first.draw()
    first.saved()
    second.draw([(200, 20), (260, 20), (260, 50)])
    second.tab.get_by_role("button", name=choice).click()
    second.until("labeller.state.saving.kind === 'saved' && !labeller.saver.pending")
    assert [len(o.key_frames[0].polygons[0]) for o in stored(shared).objects] == [corners]
    if choice == "Take theirs":
        second.press("Control+z")
        second.until("labeller.saver.revision === 2")
        assert [len(o.key_frames[0].polygons[0]) for o in stored(shared).objects] == [3]


def test_server_killed_and_restarted_loses_nothing(context, clips, server, tmp_path):
    page = Page(context, server.address)
    page.draw()
    assert page.saved() == 1
    server.stop(signal.SIGKILL)
    assert len(stored(server).objects) == 1
    page.press("4")
    page.draw([(200, 20), (260, 20), (260, 50)])
    page.until("labeller.state.saving.kind === 'offline'")
    assert "kept" in page.tab.locator("#saved").inner_text()
    again = Server(clips, tmp_path / "notes", server.port)
    try:
        page.saved()
        assert [o.motion for o in stored(server).objects] == [4, 5]
    finally:
        again.stop(signal.SIGKILL)
    assert page.errors == []


def test_edits_survive_closing_the_tab_while_the_server_is_away(context, clips, server, tmp_path):
    page = Page(context, server.address)
    server.stop(signal.SIGKILL)
    page.draw()
    page.until("Object.keys(localStorage).some(key => key.startsWith('draft:one'))")
    page.press("PageDown", "F2", "s", "Escape", "Control+e", "Escape")
    page.until("labeller.state.hint.includes('does not answer')")
    assert page.errors == []
    page.tab.close()
    again = Server(clips, tmp_path / "notes", server.port)
    try:
        back = Page(context, again.address)
        back.saved()
        assert near(stored(server).objects[0].key_frames[0].polygons[0], CORNERS)
    finally:
        again.stop(signal.SIGKILL)


def test_proposals_are_accepted_or_rejected_by_a_person(context, clips, tmp_path):
    import cv2
    import numpy as np

    masks = tmp_path / "masks" / "one"
    masks.mkdir(parents=True)
    for k in range(6):
        mask = np.zeros((200, 320), np.uint8)
        mask[70:130, 60 + 4 * k : 140 + 4 * k] = 1
        mask[10:40, 200:240] = 2
        cv2.imwrite(str(masks / f"{k:05d}.png"), mask)
    server = Server(clips, tmp_path / "notes", 0, "--masks", str(tmp_path / "masks"))
    try:
        page = Page(context, server.address)
        page.press("s")
        page.tab.get_by_role("button", name="masks").click()
        page.until("labeller.state.review")
        assert page.objects() == []
        page.tab.get_by_role("button", name="Reject").click()
        page.tab.get_by_role("button", name="Accept").click()
        page.until("!labeller.state.review")
        assert [item["name"] for item in page.objects()] == ["motion 2"]
        assert page.errors == []
    finally:
        server.stop(signal.SIGKILL)


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
    page.until("labeller.state.doc.objects.length === 1")
    assert page.objects()[0]["motion"] == 6


def test_clips_flicker_play_zoom_and_pan(page):
    page.press("f")
    page.until("labeller.state.flickered === 1")
    page.until("labeller.state.flickered === 0")
    page.press("f", "Space")
    page.until("labeller.state.frame >= 2")
    page.press("Space")
    assert page.value("labeller.state.flickered") is None
    before = page.value("labeller.state.view")
    page.tab.mouse.move(*page.at((100, 100)))
    where = page.at((100, 100))
    page.tab.mouse.wheel(0, -400)
    page.until(f"labeller.state.view.scale > {before['scale']}")
    assert page.at((100, 100)) == pytest.approx(where, abs=1.5)
    page.drag((250, 20), (260, 40))
    assert page.value("labeller.state.view.y") != before["y"]
    page.press("F2")
    page.tab.get_by_role("button", name="two", exact=True).click()
    page.until("labeller.state.clip.name === 'two' && labeller.state.labels")
    assert "clip=two" in page.tab.url


def test_nothing_comes_from_elsewhere(context, shared):
    asked = []
    context.on("request", lambda request: asked.append(request.url))
    Page(context, shared.address)
    assert asked
    assert all(url.startswith((shared.address, "blob:", "data:")) for url in asked)


def test_ctrl_c_ends_the_server_quietly(clips, tmp_path):
    server = Server(clips, tmp_path / "notes")
    server.stop(signal.SIGINT)
    assert server.process.returncode in (0, 130)


def test_another_address_wants_the_token(clips, tmp_path, context):
    server = Server(clips, tmp_path / "notes", 0, "--host", "0.0.0.0")
    try:
        address = server.address.replace("0.0.0.0", "127.0.0.1")
        assert "token=" in address
        page = Page(context, address)
        assert "token" not in page.tab.url
        stranger = context.browser.new_context()
        assert stranger.request.get(address.partition("?")[0] + "api/clips").status == 401
        stranger.close()
    finally:
        server.stop(signal.SIGKILL)
    assert json.loads(json.dumps(page.errors)) == []
