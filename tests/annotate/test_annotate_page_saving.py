"""What the labelling page saves, and that nothing is lost: tabs, servers that die, other addresses."""

from __future__ import annotations

import json
import re
import signal
import socket

import httpx
import pytest
from labeller_page import CORNERS, LIMIT, Page, Server, near, stored

from kt3dmoseg.annotate import load_annotation

pytestmark = pytest.mark.browser


def test_what_two_tabs_draw_is_merged(context, shared):
    first, second = Page(context, shared.address), Page(context, shared.address)
    first.draw()
    first.press("4")
    first.saved()
    second.draw([(200, 20), (260, 20), (260, 50)])
    second.shows("#hint", "Somebody else saved meanwhile: both are merged; kept under new numbers: object 2")
    second.saved()
    assert {len(o.key_frames[0].polygons[0]) for o in stored(shared).objects} == {3, 4}
    second.press("Control+z")  # takes back what was drawn here, not what others saved
    second.saved()
    assert [(o.id, len(o.key_frames[0].polygons[0])) for o in stored(shared).objects] == [(1, 4)]
    assert first.errors == second.errors == []


def test_a_clip_is_done_after_its_last_edit_is_saved(context, shared):
    page = Page(context, shared.address)
    page.value(
        "(() => { const send = window.fetch; let first = true; window.fetch = async (...all) => {"
        " if (all[1]?.method === 'PUT' && first) { first = false;"
        " await new Promise((later) => setTimeout(later, 800)); }"
        " return send(...all); }; localStorage.setItem('annotator', 'me'); })()"
    )
    page.draw()
    page.until("labeller.state.saving.kind === 'busy'")
    page.press("4")  # while the first is on its way
    page.tab.get_by_label("State of this clip").select_option("done")
    page.saved()
    page.until("labeller.state.work.state === 'done'")
    log = [json.loads(line) for line in (shared.notes / "one.log.jsonl").read_text().splitlines()]
    assert log[-1].get("state") == "done", log
    assert log[-1]["revision"] == log[-2]["revision"] == 2


def test_server_killed_and_restarted_loses_nothing(context, clips, server, tmp_path):
    page = Page(context, server.address)
    page.draw()
    assert page.saved() == 1
    server.stop(signal.SIGKILL)
    assert len(stored(server).objects) == 1
    page.press("4")
    page.draw([(200, 20), (260, 20), (260, 50)])
    page.until("labeller.state.saving.kind === 'offline'")
    page.until("document.getElementById('saved').textContent.includes('kept')")
    again = Server(clips, tmp_path / "notes", server.port)
    try:
        page.saved()
        assert [o.motion for o in stored(server).objects] == [4, 5]
    finally:
        again.stop(signal.SIGKILL)
    assert page.errors == []


def test_a_folder_that_cannot_be_written_is_reported_and_tried_again(page, shared):
    shared.notes.write_text("a file where the folder should be")
    page.draw()
    page.until("labeller.state.saving.kind === 'offline'")
    page.until("document.getElementById('saved').textContent.includes('cannot write')")
    page.shows("#saved", "kept in this browser")
    shared.notes.unlink()
    assert page.saved() == 1
    assert len(stored(shared).objects) == 1


def test_a_dead_server_is_noticed_without_an_edit_and_the_banner_shows_what_is_kept(
    context, clips, server, tmp_path
):
    page = Page(context, server.address)
    page.draw()
    page.saved()
    assert not page.tab.locator("#banner").is_visible()
    stage = page.box("#stage")
    server.process.send_signal(signal.SIGSTOP)
    page.shows("#banner", "The server does not answer. Everything before is saved")
    assert page.box("#banner")["width"] == 1280
    assert page.box("#stage") == stage  # nothing moves under the pointer
    page.draw([(200, 20), (260, 20), (260, 50)])
    page.shows("#banner", "Not saved, kept in this browser: object 2.")
    with page.tab.expect_download() as download:
        page.tab.get_by_role("button", name="Download the annotation").click()
    download.value.save_as(tmp_path / "kept.json")
    assert len(load_annotation(tmp_path / "kept.json").objects) == 2
    server.process.send_signal(signal.SIGCONT)
    page.tab.locator("#banner").wait_for(state="hidden")
    page.saved()
    assert len(stored(server).objects) == 2
    assert page.errors == []


def test_a_server_that_falls_silent_in_the_middle_of_an_answer_does_not_answer(page):
    page.value(
        "(() => { const send = window.fetch; const silent = { start: (body) =>"
        " body.error(new DOMException('signal timed out', 'TimeoutError')) };"
        " window.fetch = (where, ...more) => where.endsWith('/trouble')"
        " ? Promise.resolve(new Response(new ReadableStream(silent))) : send(where, ...more); })()"
    )
    page.shows("#banner", "The server does not answer.")


def test_a_folder_that_cannot_be_written_is_noticed_before_the_first_edit(page, shared):
    shared.notes.write_text("a file where the folder should be")
    page.shows("#banner", "a file is where a folder should be")
    shared.notes.unlink()
    page.tab.locator("#banner").wait_for(state="hidden")


def test_what_is_wrong_with_a_clip_is_in_the_banner_of_that_clip(page, shared):
    doubted = {"doubt": "two: other frames"}
    page.tab.route("**/api/clips/two", lambda route: route.fulfill(json=route.fetch().json() | doubted))
    assert not page.tab.locator("#banner").is_visible()
    page.tab.goto(f"{shared.address}?clip=two")
    page.shows("#banner", "two: other frames")


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


def test_ctrl_c_ends_the_server_quietly(clips, tmp_path):
    server = Server(clips, tmp_path / "notes")
    server.stop(signal.SIGINT)
    assert server.process.returncode in (0, 130)


def test_another_address_requires_the_token(clips, tmp_path, context):
    server = Server(clips, tmp_path / "notes", 0, "--host", "0.0.0.0")
    try:
        assert "token=" in server.address
        page = Page(context, re.sub(r"//[^:]+", "//team.example", server.address))
        assert "token" not in page.tab.url
        assert not page.value("isSecureContext")  # plain http in a team's network
        page.draw()
        assert page.saved() == 1
        stranger = context.browser.new_context()
        address = re.sub(r"//[^:]+", "//127.0.0.1", server.address)
        assert stranger.request.get(address.partition("?")[0] + "api/clips").status == 401
        stranger.close()
    finally:
        server.stop(signal.SIGKILL)
    assert json.loads(json.dumps(page.errors)) == []


def test_nothing_comes_from_elsewhere(context, shared):
    asked = []
    context.on("request", lambda request: asked.append(request.url))
    Page(context, shared.address)
    assert asked
    assert all(url.startswith((shared.address, "blob:", "data:")) for url in asked)


def test_a_save_is_answered_next_to_a_hundred_slow_uploads(server):
    """Uploads that never end hold no thread: the save below would wait for them until its time is up."""
    head = (
        "POST /api/clips/one/import/cvat HTTP/1.1\r\n"
        f"Host: 127.0.0.1:{server.port}\r\nContent-Length: 1000000\r\n\r\n<annotations>"
    )
    uploads = [socket.create_connection(("127.0.0.1", server.port), timeout=LIMIT) for _ in range(100)]
    try:
        for upload in uploads:
            upload.sendall(head.encode())
        with httpx.Client(base_url=f"http://127.0.0.1:{server.port}", timeout=LIMIT) as page:
            doc = page.get("/api/clips/one").json()["annotation"]
            answer = page.put("/api/clips/one/annotation", json=doc)
        assert answer.json() == {"revision": 1}
    finally:
        for upload in uploads:
            upload.close()
    assert server.process.poll() is None
