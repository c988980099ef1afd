"""The labelling server: every route, every bad request."""

from __future__ import annotations

import asyncio
import contextlib
import copy
import json
import shutil
import threading
from dataclasses import replace
from datetime import datetime

import cv2
import numpy as np
import pytest
from annotation_scenes import drawn_by_hand, write_clip
from asgi_client import Client

from kt3dmoseg.annotate import AnnotatedObject, KeyFrame, label_tracks, load_annotation
from kt3dmoseg.annotate.model import from_json, to_json
from kt3dmoseg.annotate.server import app
from kt3dmoseg.annotate.server.app import create_app, is_loopback
from kt3dmoseg.annotate.server.clip_session import ClipSession, sessions_of
from kt3dmoseg.annotate.server.routes import _WORKERS, Routes
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.frames import ClipFiles, find_clips
from kt3dmoseg.io import load
from kt3dmoseg.io import save as save_clip
from kt3dmoseg.types import Trajectories

HOST = "127.0.0.1:8000"
BOX = [[60.0, 70.0], [140.0, 70.0], [140.0, 130.0], [60.0, 130.0]]


def never(frames, progress):
    raise AssertionError("the trajectories are in a file")


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    folder = tmp_path_factory.mktemp("clips")
    write_clip(folder, "one")
    write_clip(folder, "two", frames=3, tracks=10)
    return folder


def routes(clips, tmp_path, tracker=never, tracks=True, **options):
    found = find_clips(
        clips / "frames", annotations=tmp_path / "notes", tracks=clips / "tracks" if tracks else None
    )
    return Routes({name: ClipSession(source, tracker) for name, source in found.items()}, **options)


def client(routes, **options):
    return Client(create_app(routes, hosts=[HOST], **options), f"http://{HOST}")


@pytest.mark.parametrize(
    ("names", "numbers"),
    [
        (["a_3_10.png", "a_3_11.png"], ["10", "11"]),
        (["left.png", "right.png"], ["0", "1"]),
        (["x1.png", "y1.png"], ["0", "1"]),
    ],
)
def test_frames_have_the_numbers_in_their_names_where_these_differ(tmp_path, names, numbers):
    source = ClipFiles("c", tuple(tmp_path / name for name in names), None, tmp_path / "c.json")
    assert ClipSession(source, never).numbers == numbers


def test_frames_of_another_clip_are_said_on_the_page_of_that_clip(tmp_path, capsys):
    for name in ("one", "two"):
        write_clip(tmp_path, name, tracks=10)
    path = tmp_path / "tracks" / "two.npz"
    source = {"kind": "frames", "sha256": "0" * 64}
    save_clip(replace(load(path), provenance={"inputs": {"source": source}}), path)
    found = find_clips(tmp_path / "frames", annotations=tmp_path / "notes", tracks=tmp_path / "tracks")
    page = client(Routes(sessions_of(found, never)))
    assert "sha256" in capsys.readouterr().err
    assert page.get("/api/clips/one").json()["doubt"] == ""
    assert "other contents (by their sha256)" in page.get("/api/clips/two").json()["doubt"]


@pytest.fixture
def page(clips, tmp_path):
    return client(routes(clips, tmp_path))


def drawn(page, clip="one"):
    doc = page.get(f"/api/clips/{clip}").json()["annotation"]
    keys = [{"frame": 0, "visibility": "visible", "polygons": [BOX]}]
    doc["objects"] = [{"id": 1, "name": "box", "kind": "car", "motion": 1, "key_frames": keys}]
    return doc


def save(page, doc, revision, **headers):
    return page.put("/api/clips/one/annotation", json=doc | {"revision": revision}, headers=headers)


def wait(page, clip="one"):
    while (answer := page.get(f"/api/clips/{clip}/tracks")).status_code == 202:
        pass
    return answer


def test_page_and_its_files(page):
    html = page.get("/").text
    assert 'data-clip="one"' in html
    assert "/api/clips/one/frames/0" in html
    assert 'data-clip="two"' in page.get("/?clip=two").text
    assert 'data-clip="one"' in page.get('/?clip="><script>').text
    for part in html.split('href="')[1:]:
        answer = page.get(part.partition('"')[0])
        assert answer.status_code == 200
    assert page.get("/static/main.js").headers["content-type"].startswith("text/javascript")
    assert "script-src 'self'" in page.get("/").headers["content-security-policy"]


def counted(page):
    """Ask until all clips are counted."""
    while True:
        found = page.get("/api/clips").json()["clips"]
        if not any(clip["counting"] for clip in found):
            return found


def test_progress_of_all_clips_is_counted_from_the_files_alone(clips, tmp_path):
    save(client(routes(clips, tmp_path)), drawn(client(routes(clips, tmp_path))), 0)
    one, two = counted(client(routes(clips, tmp_path)))
    assert (one["name"], one["revision"], one["objects"], one["motions"]) == ("one", 1, 1, 1)
    labelled = one["counts"]["labelled"]
    assert 390 <= labelled == 400 - one["counts"]["conflict"] - one["counts"]["short"]
    assert (two["name"], two["trajectories"], "counts" in two) == ("two", 10, False)


def test_progress_follows_what_is_saved_and_opened(page, clips, tmp_path):
    assert [c["trajectories"] for c in counted(page)] == [400, 10]
    doc = drawn(page)
    save(page, doc, 0)
    labelled = counted(page)[0]["counts"]
    doc["marks"] = [{"frame": 0, "motion": "reject", "polygon": [[0, 0], [320, 0], [320, 200], [0, 200]]}]
    save(page, doc, 1)
    after = counted(page)[0]
    assert (after["revision"], after["counts"]["rejected"]) == (2, 400)
    assert labelled["rejected"] == 0
    wait(page)
    assert counted(page)[0] == after


def test_progress_computes_no_trajectories(clips, tmp_path):
    page = client(routes(clips, tmp_path, tracks=False))
    save(page, drawn(page), 0)
    one, two = counted(page)
    assert (one["objects"], "trajectories" in one, "counts" in one) == (1, False, False)
    assert "objects" not in two


def set_state(page, state="done", by="Ada"):
    return page.put("/api/clips/one/state", json={"state": state, "by": by})


def test_the_state_of_a_clip_is_kept_next_to_its_annotation_with_name_time_and_revision(
    page, clips, tmp_path
):
    assert page.get("/api/clips/one").json()["work"] == {"state": "not started", "assigned": ""}
    save(page, drawn(page), 0)
    assert page.get("/api/clips/one").json()["work"] == {"state": "in work", "assigned": ""}
    work = set_state(page).json()["work"]
    assert (work["state"], work["by"], work["revision"]) == ("done", "Ada", 1)
    assert datetime.fromisoformat(work["time"]).tzinfo is not None
    set_state(page, "reviewed", " Bob ")
    fresh = client(routes(clips, tmp_path))
    assert [
        clip["work"]["by"] for clip in fresh.get("/api/clips").json()["clips"] if "by" in clip["work"]
    ] == ["Bob"]
    log = [json.loads(line) for line in (tmp_path / "notes" / "one.log.jsonl").read_text().splitlines()]
    assert [entry["state"] for entry in log if "state" in entry] == ["done", "reviewed"]
    assert load_annotation(tmp_path / "notes" / "one.json").revision == 1


@pytest.mark.parametrize(
    ("state", "by", "field"),
    [
        ("finished", "Ada", "state"),
        (["done"], "Ada", "state"),
        ("done", " ", "by"),
        ("done", 3, "by"),
        ("done", "x" * 200, "by"),
    ],
)
def test_a_state_of_no_name_or_by_nobody_is_refused(page, tmp_path, state, by, field):
    answer = set_state(page, state, by)
    assert answer.status_code == 400
    assert answer.json()["error"].startswith(field)
    assert not (tmp_path / "notes" / "one.log.jsonl").exists()


def test_a_damaged_log_is_reported_with_its_name(page, tmp_path):
    set_state(page)
    (tmp_path / "notes" / "one.log.jsonl").write_text('{"state": "fine"}\n')
    assert "one.log.jsonl: line 1: expected time" in page.get("/api/clips").json()["clips"][0]["error"]
    assert "one.log.jsonl" in page.get("/api/clips/one").json()["error"]


def test_the_annotator_of_the_command_line_sets_the_state(clips, tmp_path):
    page = client(routes(clips, tmp_path, annotator="Eve"))
    assert set_state(page).json()["work"]["by"] == "Eve"


def test_the_log_says_who_changed_what_and_for_whom_a_clip_is(page, tmp_path, monkeypatch):
    times = iter(range(0, 10_000, 120))

    class Clock(datetime):
        @classmethod
        def now(cls, zone=None):
            return datetime.fromtimestamp(next(times), zone)

    monkeypatch.setattr("kt3dmoseg.annotate.server.clip_session.datetime", Clock)
    doc = drawn(page) | {"annotator": "Ada"}
    save(page, doc, 0)
    doc["objects"][0]["motion"] = 4
    doc["objects"].append(doc["objects"][0] | {"id": 2, "name": "bus"})
    save(page, doc, 1)
    save(page, doc | {"objects": doc["objects"][:1], "annotator": "Bo"}, 2)
    for _ in range(3):
        next(times)
    assert page.put("/api/clips/one/state", json={"assigned": "Bo", "by": "Ada"}).json()["work"] == {
        "state": "in work",
        "assigned": "Bo",
    }
    log = [json.loads(line) for line in (tmp_path / "notes" / "one.log.jsonl").read_text().splitlines()]
    assert [{k: v for k, v in entry.items() if k != "time"} for entry in log] == [
        {"by": "Ada", "revision": 1, "added": ["box"]},
        {"by": "Ada", "revision": 2, "added": ["bus"], "changed": ["box"]},
        {"by": "Bo", "revision": 3, "removed": ["bus"]},
        {"by": "Ada", "assigned": "Bo"},
    ]
    summary = page.get("/api/clips").json()["clips"][0]
    # Saves two minutes apart count, those after a pause of ten do not.
    assert summary["minutes"] == {"Ada": 2.0, "Bo": 0.0}
    assert summary["work"]["assigned"] == "Bo"


def test_each_of_a_team_has_a_token(clips, tmp_path):
    file = tmp_path / "team"
    file.write_text("\ufeffAda Lovelace\nBo\tsecret\n", encoding="utf-8")  # as Windows' Notepad begins it
    team = app.read_team(file)
    assert app.read_team(file) == team
    assert (len(team), team["secret"]) == (2, "Bo")
    assert file.stat().st_mode & 0o077 == 0
    page = client(routes(clips, tmp_path, team=team.values()), tokens=team)
    assert page.get("/api/clips/one").status_code == 401
    for token, name in team.items():
        answer = page.get("/api/clips/one", headers={"authorization": f"Bearer {token}"}).json()
        assert (answer["annotator"], answer["team"]) == (name, ["Ada Lovelace", "Bo"])
    assert page.get("/?token=secret").status_code == 303
    assert set_state(page, by="Eve").json()["work"]["by"] == "Bo"


@pytest.mark.parametrize(("reached", "shown"), [("192.0.2.7", "192.0.2.7"), (None, "0.0.0.0")])
def test_a_wildcard_is_shown_as_an_address_that_others_can_open(monkeypatch, reached, shown):
    class Probe(contextlib.nullcontext):
        def __enter__(self):
            return self

        def connect(self, where):
            if reached is None:
                raise OSError("no network")

        def getsockname(self):
            return reached, 1

    monkeypatch.setattr(app.socket, "socket", lambda *_: Probe())
    assert app._reached("0.0.0.0") == shown
    assert [app._reached(host) for host in ("127.0.0.1", "::1", "lab")] == ["127.0.0.1", "[::1]", "lab"]


def test_a_state_is_of_the_revision_that_was_seen(page):
    save(page, drawn(page), 0)
    save(page, drawn(page), 1)
    answer = page.put("/api/clips/one/state", json={"state": "reviewed", "revision": 1, "by": "Ada"})
    assert (answer.status_code, answer.json()["annotation"]["revision"]) == (412, 2)
    answer = page.put("/api/clips/one/state", json={"state": "reviewed", "revision": 2, "by": "Ada"})
    assert answer.json()["work"]["revision"] == 2


def test_a_picture_that_changed_is_sent_again(clips, tmp_path):
    frames = shutil.copytree(clips / "frames" / "two", tmp_path / "two")
    [source] = find_clips(frames, annotations=tmp_path).values()
    page = client(Routes({"two": ClipSession(source, never)}))
    first = page.get("/api/clips/two/frames/0")
    again = {"if-none-match": first.headers["etag"]}
    assert page.get("/api/clips/two/frames/0", headers=again).status_code == 304
    path = source.frames[0]
    cv2.imwrite(str(path), 255 - cv2.imread(str(path)))
    second = page.get("/api/clips/two/frames/0", headers=again)
    assert (second.status_code, second.content != first.content) == (200, True)
    path.unlink()
    gone = page.get("/api/clips/two/frames/0", headers=again)
    assert (gone.status_code, str(path) in gone.json()["error"]) == (500, True)


@pytest.mark.parametrize("text", ["", "Ada\nAda\n", "x" * 101])
def test_a_file_that_names_no_team_is_refused(tmp_path, text):
    (tmp_path / "team").write_text(text)
    with pytest.raises(FileFormatError, match="team: expected"):
        app.read_team(tmp_path / "team")


def test_motion_by_itself_is_found_and_doubt_is_counted(page):
    groups = page.get("/api/clips/one/moving").json()["groups"]
    assert 15 < sum(group > 1 for group in groups) < 60
    assert page.get("/api/clips/two/moving").json()["groups"] is None
    doc = drawn(page)
    tiny = copy.deepcopy(doc)
    tiny["objects"][0]["key_frames"][0]["polygons"] = [[[200, 20], [206, 20], [206, 26], [200, 26]]]
    for revision, (given, weak) in enumerate([(doc, 0), (tiny, 5)]):
        save(page, given, revision)
        assert counted(page)[0]["weak"] == weak


def test_clip(page):
    reply = page.get("/api/clips/two").json()
    assert reply["image_size"] == [320, 200]
    assert reply["n_frames"] == 3
    assert reply["annotation"]["revision"] == 0
    assert reply["formats"]["cvat"] == ".xml"
    assert {"mseg", "tracklets", "masks"} <= set(reply["proposers"])


def test_frames(page, clips):
    answer = page.get("/api/clips/one/frames/2")
    assert answer.content == (clips / "frames" / "one" / "000003.png").read_bytes()
    assert answer.headers["content-type"] == "image/png"
    assert page.get("/api/clips/one/frames/6").status_code == 404
    assert page.get("/api/clips/one/frames/-1").status_code == 404
    assert page.get("/api/clips/one/frames/x").status_code == 404


def test_frames_that_browsers_do_not_show_are_sent_as_png(tmp_path):
    folder = tmp_path / "frames" / "odd"
    folder.mkdir(parents=True)
    image = np.arange(32 * 40, dtype=np.uint8).reshape(32, 40)
    for k in range(2):
        cv2.imwrite(str(folder / f"{k}.pgm"), image)
    found = find_clips(folder, annotations=tmp_path)
    page = client(Routes({n: ClipSession(s, never) for n, s in found.items()}))
    content = page.get("/api/clips/odd/frames/0").content
    assert (cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) == image).all()


def test_tracks_from_the_file(page, clips):
    answer = wait(page)
    count, frames = map(int, answer.headers["x-shape"].split(","))
    xy = np.frombuffer(answer.content, "<f4").reshape(count, frames, 2)
    assert np.allclose(xy, load(clips / "tracks" / "one.npz").dense.xy, atol=1e-3)


def test_tracks_are_computed_with_progress(clips, tmp_path):
    go = threading.Event()

    def slow(frames, progress):
        seen = [next(frames)]
        progress(1, 3)
        assert go.wait(20)
        seen += list(frames)
        xy = np.zeros((4, len(seen), 2))
        return Trajectories(xy, np.ones(xy.shape[:2], bool))

    page = client(routes(clips, tmp_path, slow, tracks=False))
    page.get("/api/clips/two/tracks")
    while (reply := page.get("/api/clips/two/tracks")).json()["done"] < 1:
        pass
    assert reply.status_code == 202
    assert reply.json() == {"done": 1, "total": 3, "error": ""}
    assert page.post("/api/clips/two/labels", json=drawn(page, "two")).status_code == 202
    go.set()
    assert wait(page, "two").headers["x-shape"] == "4,3"


def test_tracks_that_fail_say_why(clips, tmp_path):
    def broken(frames, progress):
        raise InvalidValueError("frames", expected="courage", found="none")

    page = client(routes(clips, tmp_path, broken, tracks=False))
    answer = wait(page)
    assert answer.status_code == 500
    assert "courage" in answer.json()["error"]
    assert "courage" in page.post("/api/clips/one/proposals/mseg", json=drawn(page)).json()["error"]


def test_tracks_of_another_clip_are_refused(clips, tmp_path):
    with pytest.raises(InputFileError, match="expected tracks of two, found one"):
        find_clips(clips / "frames" / "two", annotations=tmp_path, tracks=clips / "tracks" / "one.npz")
    found = find_clips(clips / "frames" / "two", annotations=tmp_path)
    source = replace(found["two"], tracks=clips / "tracks" / "one.npz")
    answer = wait(client(Routes({"two": ClipSession(source, never)})), "two")
    assert "3 frames" in answer.json()["error"]


def test_save_and_read(page, tmp_path):
    answer = save(page, drawn(page), 0)
    assert (answer.status_code, answer.json()) == (200, {"revision": 1})
    stored = load_annotation(tmp_path / "notes" / "one.json")
    assert stored.objects[0].name == "box"
    assert page.get("/api/clips/one").json()["annotation"] == to_json(stored)


def test_annotator_is_written(clips, tmp_path):
    page = client(routes(clips, tmp_path, annotator="me"))
    save(page, drawn(page), 0)
    assert load_annotation(tmp_path / "notes" / "one.json").annotator == "me"


def test_stale_revision_is_refused_with_the_present_document(page, tmp_path):
    first = drawn(page)
    second = json.loads(json.dumps(first))
    second["objects"][0]["name"] = "other"
    assert save(page, first, 0).status_code == 200
    answer = save(page, second, 0)
    assert answer.status_code == 412
    assert answer.json()["annotation"]["objects"][0]["name"] == "box"
    assert load_annotation(tmp_path / "notes" / "one.json").objects[0].name == "box"
    assert save(page, second, 1).json() == {"revision": 2}


def test_a_revision_from_the_future_is_refused(page):
    save(page, drawn(page), 0)
    answer = save(page, drawn(page), 5)
    assert answer.status_code == 412
    assert answer.json()["annotation"]["revision"] == 1


def test_a_file_that_vanished_is_written_again(page, tmp_path):
    save(page, drawn(page), 0)
    (tmp_path / "notes" / "one.json").unlink()
    assert save(page, drawn(page), 1).json() == {"revision": 2}
    assert len(load_annotation(tmp_path / "notes" / "one.json").objects) == 1


def test_an_annotation_of_another_folder_is_refused(page):
    folder = page.get("/api/clips/one").json()["folder"]
    assert save(page, drawn(page), 0, **{"x-folder": "elsewhere"}).status_code == 409
    assert save(page, drawn(page), 0, **{"x-folder": folder}).status_code == 200


def test_the_revision_is_required_and_checked(page):
    doc = drawn(page)
    del doc["revision"]
    answer = page.put("/api/clips/one/annotation", json=doc)
    assert (answer.status_code, "revision" in answer.json()["error"]) == (400, True)
    for bad in ("0", "*", None, -1, 0.5, 10**20):
        assert save(page, drawn(page), bad).status_code == 400


@pytest.mark.parametrize(
    ("body", "word"),
    [(b"", "JSON"), (b"{", "JSON"), (b"[]", "annotation"), (b"[" * 90_000, "JSON"), (b"\xff", "JSON")],
)
@pytest.mark.parametrize("route", ["labels", "regions", "proposals/mseg", "export/cvat"])
def test_bodies_that_are_no_annotation(page, route, body, word):
    wait(page)
    answer = page.post(f"/api/clips/one/{route}", content=body)
    assert answer.status_code == 400
    assert word in answer.json()["error"]


@pytest.mark.parametrize(
    ("field", "value"), [("clip", "two"), ("n_frames", 5), ("image_size", [1, 1]), ("objects", 3), ("x", 1)]
)
def test_annotations_of_another_clip_or_form_name_the_field(page, field, value, tmp_path):
    answer = save(page, drawn(page) | {field: value}, 0)
    assert answer.status_code == 400
    assert field in answer.json()["error"]
    assert not (tmp_path / "notes" / "one.json").exists()


@pytest.mark.parametrize("name", ["\ud800", " ", "x" * 501])
def test_texts_that_no_file_can_hold_are_refused(page, name, tmp_path):
    doc = drawn(page)
    doc["objects"][0]["name"] = name
    answer = page.put("/api/clips/one/annotation", content=json.dumps(doc).encode())
    assert answer.status_code == 400
    assert "objects[0].name" in answer.json()["error"]
    assert not (tmp_path / "notes" / "one.json").exists()


def test_a_damaged_annotation_file_is_reported_and_kept(page, tmp_path):
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "one.json").write_text("{ not json")
    assert "one.json" in page.get("/api/clips/one").json()["error"]
    assert "one.json" in counted(page)[0]["error"]
    doc = drawn(page, "two") | {"clip": "one", "n_frames": 6}
    assert save(page, doc, 0).status_code == 400
    assert (tmp_path / "notes" / "one.json").read_text() == "{ not json"


def test_an_unwritable_folder_is_reported(page, tmp_path):
    (tmp_path / "notes").write_text("a file where the folder should be")
    answer = save(page, drawn(page), 0)
    assert answer.status_code == 500
    assert "notes" in answer.json()["error"]


def test_labels_and_regions(page, clips):
    wait(page)
    reply = page.post("/api/clips/one/labels", json=drawn(page)).json()
    assert len(reply["label"]) == 400
    assert reply["counts"]["motions"].keys() <= {"0", "1", "2"}
    assert reply["counts"]["motions"]["2"] > 20
    last = page.post("/api/clips/one/regions", json=drawn(page)).json()["regions"]["1"][5]
    assert last["key"] is False
    assert np.allclose(last["polygons"][0], np.array(BOX) + np.array([20.0, 0.0]), atol=0.5)


def test_labels_are_those_of_label_tracks(page, clips):
    """What the server caches of former edits changes no answer."""
    wait(page)
    doc = drawn(page)
    for shift in (0.0, 30.0, 0.0):
        doc["objects"][0]["key_frames"][0]["polygons"] = [[[x + shift, y] for x, y in BOX]]
        reply = page.post("/api/clips/one/labels", json=doc).json()["label"]
        assert reply == label_tracks(load(clips / "tracks" / "one.npz").dense, from_json(doc)).label.tolist()


def test_proposals_accept_nothing_by_themselves(page, tmp_path):
    wait(page)
    answer = page.post("/api/clips/one/proposals/mseg", json=drawn(page))
    assert answer.status_code == 200
    assert all(item["id"] > 1 for item in answer.json()["objects"])
    assert not (tmp_path / "notes" / "one.json").exists()


def test_a_proposer_is_stopped_when_nobody_waits_for_it(clips, tmp_path, monkeypatch):
    begun, stopped = threading.Event(), threading.Event()

    def endless(*_, stop):
        begun.set()
        if stop.wait(60):
            stopped.set()
        return []

    monkeypatch.setattr("kt3dmoseg.annotate.server.routes.run_apart", endless)
    page = client(routes(clips, tmp_path))
    wait(page)
    body = json.dumps(drawn(page)).encode()
    scope = {
        "type": "http",
        "method": "POST",
        "path": "/api/clips/one/proposals/mseg",
        "query_string": b"",
        "headers": [(b"host", HOST.encode())],
    }
    messages = iter([{"type": "http.request", "body": body}])

    async def receive():
        return (
            next(messages, {"type": "http.disconnect"}) if not begun.is_set() else {"type": "http.disconnect"}
        )

    async def send(_):
        pass

    asyncio.run(page.app(scope, receive, send))
    assert stopped.wait(60)


@pytest.mark.parametrize(
    ("name", "status", "word"),
    [("tracklets", 500, "kitti=FOLDER"), ("masks", 500, "masks=FOLDER"), ("magic", 400, "proposer")],
)
def test_proposals_that_cannot_be_made_say_why(page, name, status, word):
    answer = page.post(f"/api/clips/one/proposals/{name}", json=drawn(page))
    assert answer.status_code == status
    assert word in answer.json()["error"]


def test_proposals_from_masks(clips, tmp_path):
    masks = tmp_path / "masks" / "one"
    masks.mkdir(parents=True)
    for k in range(6):
        mask = np.zeros((200, 320), np.uint8)
        mask[70:130, 60 + 4 * k : 140 + 4 * k] = 3
        cv2.imwrite(str(masks / f"{k + 1:05d}.png"), mask)
    page = client(routes(clips, tmp_path, masks=tmp_path / "masks"))
    (item,) = page.post("/api/clips/one/proposals/masks", json=drawn(page) | {"objects": []}).json()[
        "objects"
    ]
    assert (item["id"], item["motion"]) == (1, 3)
    assert len(item["key_frames"]) == 6
    assert item["key_frames"][0]["polygons"] == [[[59.5, 69.5], [139.5, 69.5], [139.5, 129.5], [59.5, 129.5]]]


def test_compare(clips, tmp_path):
    page = client(routes(clips, tmp_path, other=tmp_path / "other"))
    doc = drawn(page)
    assert "one.json" in page.post("/api/clips/one/compare", json=doc).json()["error"]
    half = [(60, 70), (100, 70), (100, 130), (60, 130)]
    drawn_by_hand(tmp_path / "other" / "one.json", "half", half, motion=4)
    reply = page.post("/api/clips/one/compare", json=doc).json()
    assert 0 < reply["different"] < 100
    assert 0.5 < reply["kappa"] < 1
    assert reply["agreement"] == pytest.approx(1 - reply["different"] / 400)
    (pair,) = reply["objects"]
    assert (pair["first"], pair["second"], pair["verdict"]) == ("box", "half", "labels differ: box / half")
    assert 0.4 < pair["iou"] < 0.6
    assert pair["motion"] == 1  # theirs is called 4


def test_compare_needs_another_annotator(page):
    assert page.post("/api/clips/one/compare", json=drawn(page)).status_code == 404


@pytest.mark.parametrize("name", ["cvat", "davis", "mots_txt", "mots_png", "coco", "labelme"])
def test_export_and_import(page, name):
    wait(page)
    content = page.post(f"/api/clips/one/export/{name}", json=drawn(page)).content
    back = page.post(f"/api/clips/one/import/{name}", content=content).json()
    assert len(back["objects"]) == 1
    assert back["clip"] == "one"


def test_an_import_says_what_it_does_and_takes_choices(page, tmp_path):
    content = page.post("/api/clips/one/export/davis", json=drawn(page)).content
    plan = page.post("/api/clips/one/import/davis", content=content).json()["plan"]
    assert plan["doubts"] == plan["skipped"] == []
    assert plan["lines"][0].startswith("1 object drawn in 6 of 6 frames")
    plan = page.post("/api/clips/one/import/davis?shift=1", content=content).json()["plan"]
    assert "000006.png" in plan["doubts"][0]
    for query in ("shift=x", "scale=", "scale=0", "scale=nan", "shift=1e9", f"shift={'9' * 5000}"):
        answer = page.post(f"/api/clips/one/import/davis?{query}", content=content)
        assert answer.status_code == (200 if query == "scale=" else 400)
        assert len(answer.json().get("error", "")) < 300
    assert not (tmp_path / "notes" / "one.json").exists()


def test_a_stream_that_ends_early_is_no_failure(page):
    scope = {
        "type": "http",
        "method": "POST",
        "path": "/api/clips/one/import/cvat",
        "raw_path": b"",
        "query_string": b"",
        "headers": [(b"host", HOST.encode())],
    }
    parts = iter([{"type": "http.request", "body": b"<anno", "more_body": True}, {"type": "http.disconnect"}])
    sent = []

    async def receive():
        return next(parts)

    async def send(message):
        sent.append(message)

    asyncio.run(page.app(scope, receive, send))
    assert sent[0]["status"] == 400
    assert page.app.held == 0


def test_what_is_held_of_bodies_is_bounded(page, monkeypatch):
    monkeypatch.setattr(app, "MAX_HELD", 1000)
    monkeypatch.setattr(app, "_SMALL", 500)
    assert page.post("/api/clips/one/import/cvat", content=b"x" * 1001).status_code == 503
    assert page.post("/api/clips/one/import/cvat", content=b"x" * 900).status_code == 400
    page.app.held = 10_000  # of others; what is small is always taken
    assert page.post("/api/clips/one/import/cvat", content=b"x" * 400).status_code == 400


def test_saves_do_not_wait_for_what_computes(clips, tmp_path):
    """Every worker that computes is busy until the save has been answered."""
    own, busy, release = routes(clips, tmp_path), threading.Barrier(_WORKERS + 2), threading.Event()
    page = client(own)

    def hold():
        busy.wait()
        release.wait()

    held = [own.quick.submit(hold) for _ in range(_WORKERS)] + [own.slow.submit(hold)]
    busy.wait()
    asked = threading.Thread(target=page.post, args=("/api/clips/one/labels",), kwargs={"json": drawn(page)})
    asked.start()
    assert save(page, drawn(page), 0).status_code == 200
    assert asked.is_alive()
    release.set()
    asked.join()
    assert all(work.result() is None for work in held)


def test_import_of_nonsense(page):
    answer = page.post("/api/clips/one/import/cvat", content=b"<!DOCTYPE x><annotations/>")
    assert answer.status_code == 400
    assert "DOCTYPE" in answer.json()["error"]
    assert page.post("/api/clips/one/import/excel", content=b"").status_code == 400
    assert page.post("/api/clips/one/export/excel", json=drawn(page)).status_code == 400


@pytest.mark.parametrize(
    "path",
    [
        "/nothing",
        "/api/clips/three",
        "/api/clips/three/frames/0",
        "/api/clips/..%2F..%2Fetc/annotation",
        "/api/clips/one%2F..%2Ftwo",
        "/static/..%2F..%2Fmodel.py",
        "/static/../model.py",
        "/static/model.py",
        "/static//etc/passwd",
        "/static/%00",
    ],
)
def test_what_is_not_there(page, path):
    answer = page.get(path)
    assert answer.status_code == 404
    assert answer.json()["error"]


def test_other_methods_are_refused(page):
    assert page.delete("/api/clips/one/annotation").status_code == 405
    assert page.post("/api/clips").status_code == 405


@pytest.mark.parametrize(
    "host",
    ["evil.example", "evil.example:8000", "127.0.0.1", "127.0.0.1:9", "", "127.0.0.1:8000.evil.example"],
)
def test_foreign_hosts_are_refused(page, host):
    assert page.get("/api/clips", headers={"Host": host}).status_code == 421


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1:9", "http://localhost:8000"]
)
def test_foreign_origins_are_refused(page, origin, tmp_path):
    assert page.get("/api/clips", headers={"Origin": origin}).status_code == 403
    assert save(page, drawn(page), 0, Origin=origin).status_code == 403
    assert not (tmp_path / "notes").exists()


def test_own_origin_is_served(page):
    assert save(page, drawn(page), 0, Origin=f"http://{HOST}").status_code == 200


def test_bodies_are_bounded(page, monkeypatch):
    monkeypatch.setattr(app, "MAX_BODY", 1000)
    huge = b"x" * 1001
    assert page.post("/api/clips/one/import/cvat", content=huge).status_code == 413

    def chunks():
        for _ in range(100):
            yield b"x" * 100

    answer = page.post("/api/clips/one/import/cvat", content=chunks())
    assert answer.status_code == 413


def test_token(clips, tmp_path):
    page = client(routes(clips, tmp_path), tokens={"secret": ""})
    assert page.get("/").status_code == 401
    assert page.get("/?token=wrong").status_code == 401
    assert page.get("/api/clips?token=secret").status_code == 401
    assert page.get("/api/clips", headers={"Authorization": "Bearer secret"}).status_code == 200
    welcome = page.get("/?token=secret", follow_redirects=False)
    assert welcome.status_code == 303
    assert "httponly" in welcome.headers["set-cookie"].lower()
    assert "samesite=lax" in welcome.headers["set-cookie"].lower()
    assert welcome.headers["location"] == "/"
    clip = page.get("/?clip=one&token=secret", follow_redirects=False)
    assert clip.headers["location"] == "/?clip=one"
    assert page.get("/api/clips").status_code == 200


def test_two_servers_on_one_machine_keep_their_own_tokens(clips, tmp_path):
    hosts = {"one": "localhost:8001", "two": "localhost:8002", "http": "localhost"}
    pages = {}
    for token, host in hosts.items():
        pages[token] = Client(
            create_app(routes(clips, tmp_path), hosts=[host], tokens={token: ""}), f"http://{host}"
        )
        pages[token].cookies = pages["one"].cookies  # as in a browser, for which they are one site
    for token, page in pages.items():
        page.get(f"/?token={token}", follow_redirects=False)
    assert [page.get("/api/clips").status_code for page in pages.values()] == [200, 200, 200]


def test_loopback():
    assert [is_loopback(h) for h in ("127.0.0.1", "::1", "localhost", "127.9.9.9")] == [True] * 4
    assert [is_loopback(h) for h in ("0.0.0.0", "::", "192.168.0.4", "example.org")] == [False] * 4


def test_find_clips(clips, tmp_path):
    def names(path, **options):
        return {
            n: (len(s.frames), s.tracks) for n, s in find_clips(path, annotations=tmp_path, **options).items()
        }

    one, two = clips / "tracks" / "one.npz", clips / "tracks" / "two.npz"
    assert names(clips / "frames") == {"one": (6, None), "two": (3, None)}
    assert names(clips / "frames" / "one") == {"one": (6, None)}
    assert names(one) == {"one": (6, one)}
    assert names(clips / "tracks", frames=clips / "frames") == {"one": (6, one), "two": (3, two)}
    assert names(one, frames=clips / "frames" / "one") == {"one": (6, one)}
    with pytest.raises(InputFileError, match="frames=FOLDER"):
        names(one, frames=tmp_path)
    with pytest.raises(InputFileError, match="clip"):
        names(tmp_path)


def test_saved_file_is_the_shared_model(page, tmp_path):
    save(page, drawn(page), 0)
    expected = AnnotatedObject(1, "box", "car", 1, (KeyFrame(0, polygons=(tuple(map(tuple, BOX)),)),))
    assert load_annotation(tmp_path / "notes" / "one.json").objects == (expected,)
