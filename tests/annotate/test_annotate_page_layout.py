"""The labelling page's panels, its small screens, trackpads, keyboards of other countries, hidden objects."""

from __future__ import annotations

import pytest
from labeller_page import CORNERS, near

pytestmark = pytest.mark.browser

TRIANGLE = [[200, 20], [260, 20], [260, 50]]


def many(page, count=30):
    """Give the clip so many objects at once."""
    page.draw()
    page.value(
        "import('/static/state.js').then(({ edit, state }) => edit({ ...state.doc, objects: "
        f"Array.from({{ length: {count} }}, (_, k) => "
        "({ ...state.doc.objects[0], id: k + 1, name: `object ${k + 1}`, motion: k + 1 })) }))"
    )
    page.until(f"document.querySelectorAll('.object').length === {count}")


def box(page, selector):
    return page.box(selector)


def wheel(page, dx, dy, **more):
    """Turn the wheel over an image position, as a mouse, or with ctrlKey as a pinch on a trackpad does."""
    x, y = page.at((100, 100))
    init = {
        "deltaX": dx,
        "deltaY": dy,
        "clientX": x,
        "clientY": y,
        "bubbles": True,
        "cancelable": True,
    } | more
    page.tab.evaluate(
        "(init) => document.getElementById('stage').dispatchEvent(new WheelEvent('wheel', init))", init
    )
    return page.value("labeller.state.view")


@pytest.mark.parametrize("size", [(1280, 720), (1440, 900), (1920, 1080)])
def test_the_bar_stays_and_the_list_scrolls_to_any_object(page, size):
    page.tab.set_viewport_size({"width": size[0], "height": size[1]})
    many(page)
    page.press("Escape", "[")
    page.until("labeller.state.selected === 30")
    page.until("document.querySelector('.entry.on .object')?.textContent.includes('object 30')")
    page.until("labeller.state.scrolled > 0")
    assert box(page, "#bar")["y"] == 0
    assert page.value("document.scrollingElement.scrollTop + document.body.scrollTop") == 0
    shown, listed = box(page, ".entry.on"), box(page, "#objects")
    assert (
        listed["y"] <= shown["y"] < shown["y"] + shown["height"] <= listed["y"] + listed["height"] <= size[1]
    )
    page.tab.locator("#timeline").hover()
    page.tab.mouse.wheel(0, -2000)
    page.until("labeller.state.scrolled === 0")


def test_the_list_keeps_the_focus_when_it_is_drawn_again(page):
    many(page, 3)
    page.tab.get_by_role("button", name="motion 2 object 2").focus()
    page.press("4")
    page.value("new Promise(requestAnimationFrame)")
    page.tab.locator("#objects :focus").wait_for()
    page.press("Enter")
    page.until("labeller.state.selected === 2")


def test_the_panel_is_resized_by_its_edges_and_stays_so(page):
    height, width = box(page, "#panel")["height"], box(page, "#objects")["width"]
    edge = box(page, "#panel-edge")
    page.tab.mouse.move(600, edge["y"] + 3)
    page.tab.mouse.down()
    page.tab.mouse.move(600, edge["y"] - 97, steps=3)
    page.tab.mouse.up()
    assert box(page, "#panel")["height"] == pytest.approx(height + 100, abs=5)
    page.tab.get_by_role("separator", name="Width of the list").focus()
    page.press("ArrowRight", "ArrowRight")
    assert box(page, "#objects")["width"] == pytest.approx(width + 48, abs=2)
    assert page.value("labeller.state.frame") == 0
    page.until(
        "document.getElementById('timeline').width === document.getElementById('timeline').clientWidth"
    )
    page.tab.reload()
    page.ready()
    assert box(page, "#panel")["height"] == pytest.approx(height + 100, abs=5)
    assert box(page, "#bar")["y"] == 0


def test_a_phone_says_what_it_cannot_do(page):
    assert not page.tab.locator("#small").is_visible()
    page.tab.set_viewport_size({"width": 390, "height": 844})
    page.shows("#small", "too small to draw outlines")
    assert page.value("document.documentElement.scrollWidth") == 390
    for part in ("#bar", "#stage", "#panel"):
        found = box(page, part)
        assert found["height"] > 80
        assert 0 <= found["y"] < found["y"] + found["height"] <= 844.5


def test_two_fingers_pan_and_a_pinch_zooms_where_it_is(page):
    before = page.value("labeller.state.view")
    panned = wheel(page, 30, 20)
    assert panned["scale"] == before["scale"]
    assert (panned["x"] - before["x"]) * before["scale"] == pytest.approx(30)
    assert (panned["y"] - before["y"]) * before["scale"] == pytest.approx(20)
    where = page.at((100, 100))
    pinched = wheel(page, 0, -10, ctrlKey=True)
    assert 1.05 < pinched["scale"] / panned["scale"] < 1.2
    assert page.at((100, 100)) == pytest.approx(where, abs=1)
    notch = wheel(page, 0, -120, ctrlKey=True)
    assert 1.15 < notch["scale"] / pinched["scale"] < 1.5
    lines = wheel(page, 0, 3, deltaMode=1)
    assert (lines["y"] - notch["y"]) * notch["scale"] == pytest.approx(48)


def test_two_fingers_on_a_screen_zoom_and_draw_nothing(page):
    page.press("n")
    session = page.tab.context.new_cdp_session(page.tab)
    x, y = page.at((100, 100))

    def touch(kind, *points):
        fingers = [{"x": px, "y": py, "id": k} for k, (px, py) in enumerate(points)]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": fingers})

    before = page.value("labeller.state.view.scale")
    touch("touchStart", (x - 40, y))
    touch("touchMove", (x - 48, y))
    touch("touchStart", (x - 48, y), (x + 48, y))
    touch("touchMove", (x - 96, y), (x + 96, y))
    page.until(f"labeller.state.view.scale > {1.8 * before}")
    touch("touchEnd")
    assert page.value("labeller.state.pending.points") == []
    assert page.at((100, 100)) == pytest.approx((x, y), abs=3)


def test_tooltips_name_the_keys_that_work(page):
    buttons = "[...document.querySelectorAll('[data-key]')]"
    shown = "Object.values(KEYS).flat().find((key) => key.names.includes(b.dataset.key)).shown"
    titles = page.value(
        f"import('/static/keys.js').then(({{ KEYS }}) => {buttons}.map((b) => [b.title, {shown}]))"
    )
    assert len(titles) >= 9
    assert [title for title, shown in titles if not title.endswith(f"({shown})")] == []
    assert page.tab.get_by_role("button", name="Files").get_attribute("title") == "Import and export (Ctrl+E)"


@pytest.mark.parametrize("held", [{"altKey": True}, {"altKey": True, "ctrlKey": True}])
def test_brackets_made_with_option_or_altgr_choose_objects(page, held):
    many(page, 3)
    page.press("Escape")
    for key, selected in (("]", 1), ("]", 2), ("[", 1)):
        page.tab.evaluate(
            "(init) => document.getElementById('stage').dispatchEvent(new KeyboardEvent('keydown', init))",
            {"key": key, "bubbles": True} | held,
        )
        assert page.value("labeller.state.selected") == selected
    page.press("a", "Shift+A", "Control+Backspace")
    page.until("labeller.state.doc.objects[0].key_frames[0].visibility === 'outside'")


def test_frames_have_the_numbers_of_their_files(page):
    page.press("ArrowRight")
    page.shows("#frame-badge", "000002.png · 2 of 6")
    assert page.value("labeller.state.clip.numbers") == ["1", "2", "3", "4", "5", "6"]


def test_undo_and_redo_have_buttons(page):
    undo, redo = page.tab.locator("#undo"), page.tab.locator("#redo")
    assert undo.is_disabled()
    page.draw()
    undo.click()
    assert page.objects() == []
    redo.click()
    page.until("labeller.state.doc.objects.length === 1")
    page.until("document.getElementById('redo').disabled")


def test_frame_and_zoom_are_typed(page):
    frame, scale = page.tab.get_by_label("Frame", exact=True), page.tab.get_by_label("Zoom in percent")
    page.press("Shift+F")
    page.tab.keyboard.type("4")
    page.press("Enter")
    page.until("labeller.state.frame === 3")
    frame.fill("99")
    frame.press("Enter")
    page.shows("#hint", "There is no frame 99: they are 1 to 6")
    page.until("document.getElementById('frame').value === '4'")
    scale.fill("250")
    scale.press("Enter")
    page.until(
        "labeller.state.view.scale.toFixed(3) === '2.500' "
        "&& document.getElementById('scale').value === '250 %'"
    )
    page.tab.get_by_role("button", name="Zoom out").click()
    page.until("document.getElementById('scale').value === '179 %'")


def test_how_things_are_shown_is_set_and_kept(page):
    page.tab.get_by_role("button", name="View").click()
    form = page.tab.get_by_role("form", name="View")
    form.get_by_label("Brightness").fill("2")
    form.get_by_label("Contrast").fill("1.5")
    page.until("document.getElementById('picture').style.filter === 'brightness(2) contrast(1.5)'")
    form.get_by_label("Fill of regions").fill("4")
    form.get_by_label("Pixels").select_option("square")
    form.get_by_label("Trails").uncheck()
    ground = "getComputedStyle(document.body).backgroundColor"
    assert page.value(ground) == "rgb(238, 240, 243)"
    form.get_by_label("Theme").select_option("dark")
    page.until(f"{ground} === 'rgb(22, 24, 28)'")
    page.tab.reload()
    page.ready()
    assert page.value(ground) == "rgb(22, 24, 28)"
    kept = "[state.brightness, state.contrast, state.opacity, state.pixels, state.trails, state.theme]"
    assert page.value(kept.replace("state", "labeller.state")) == [1, 1, 4, "square", False, "dark"]
    page.tab.get_by_role("button", name="View").click()
    page.tab.get_by_role("button", name="As usual").click()
    page.until(f"{ground} === 'rgb(238, 240, 243)' && labeller.state.pixels === 'smooth'")
    page.tab.emulate_media(color_scheme="dark")
    page.until(f"{ground} === 'rgb(22, 24, 28)'")


def test_square_pixels_have_edges(page):
    levels = (
        "import('/static/view.js').then(({ zoomTo }) => { zoomTo(3000); })"
        ".then(() => new Promise(requestAnimationFrame))"
        ".then(() => document.getElementById('picture').getContext('2d').getImageData(400, 150, 300, 1).data)"
        ".then((data) => new Set(data).size)"
    )
    smooth = page.value(levels)
    page.press("Shift+S")
    assert page.value(levels) < smooth / 2


def test_the_menu_of_the_right_button_acts_on_what_is_under_it(page):
    page.draw()
    page.press("Escape", "Escape")
    page.click((100, 100), button="right")
    menu = page.tab.get_by_role("menu", name="object 1")
    assert page.value("labeller.state.selected") == 1
    menu.get_by_role("menuitem", name="occluded from here on").click()
    page.until("labeller.state.doc.objects[0].key_frames[0].visibility === 'occluded'")
    page.click((250, 30), button="right")
    page.tab.get_by_role("menu", name="Clip").get_by_role("menuitem", name="outline a new object").click()
    page.until("labeller.state.tool === 'draw'")
    page.press("Escape")
    page.tab.locator(".entry").click(button="right")
    page.press("ArrowUp", "Enter")
    page.until("labeller.state.doc.objects.length === 0 && document.activeElement.id === 'stage'")


def at_frame(page, frame, top):
    box = page.box("#timeline")
    return box["x"] + (frame + 0.5) * box["width"] / 6, box["y"] + top


def test_a_key_frame_is_dragged_along_the_timeline(page):
    page.draw()
    page.press("End", "e", "Home")
    page.until("labeller.state.carried === labeller.state.doc")
    for frame, to in ((5, 3), (0, 2)):
        page.tab.mouse.move(*at_frame(page, frame, 39))
        page.tab.mouse.down()
        page.tab.mouse.move(*at_frame(page, to, 39), steps=4)
        page.tab.mouse.up()
        page.until(f"labeller.state.frame === {to} && labeller.state.carried === labeller.state.doc")
    first, last = page.objects()[0]["key_frames"]
    assert (first["frame"], last["frame"], last["visibility"]) == (2, 3, "outside")
    # The outline is the one that was shown there, where the object is.
    assert near(first["polygons"][0], [(x + 8, y) for x, y in CORNERS], 1.5)
    page.press("Shift+M")
    page.shows("#hint", "another key frame")
    page.press("Shift+N")
    page.until("labeller.state.frame === 1 && labeller.state.doc.objects[0].key_frames[0].frame === 1")
    page.press("Control+z", "Control+z", "Control+z")
    assert [key["frame"] for key in page.objects()[0]["key_frames"]] == [0, 5]


def test_the_timeline_shows_fewer_frames_and_a_map_of_all(page):
    page.value(
        "import('/static/state.js').then(({ set, state }) => set({ clip: { ...state.clip, n_frames: 60, "
        "frame_names: Array.from({ length: 60 }, (_, k) => `${k + 1}.png`), "
        "numbers: Array.from({ length: 60 }, (_, k) => String(k + 1)) } }))"
    )
    page.press(">", ">", ">")
    page.until("labeller.state.span?.count < 20")
    box = page.box("#timeline")
    page.tab.mouse.click(box["x"] + box["width"] * 0.99, box["y"] + 3)
    page.until("labeller.state.frame === 59 && labeller.state.span.from > 40")
    page.tab.mouse.click(box["x"] + box["width"] / 2, box["y"] + 20)
    page.until("(({ frame, span }) => frame === Math.floor(span.from + span.count / 2))(labeller.state)")
    page.press("<", "<", "<", "<")
    page.until("labeller.state.span === null")


def test_regions_are_filled_strongly_or_not_at_all(page):
    page.draw()
    x, y = (round(v) for v in page.at((120, 120)))
    top = box(page, "#stage")["y"]
    alpha = f"document.getElementById('regions').getContext('2d').getImageData({x}, {y - top}, 1, 1).data[3]"
    page.until(f"{alpha} > 0")
    usual = page.value(alpha)
    page.press("Shift+B")
    page.until(f"{alpha} > {2 * usual}")
    page.press("Shift+B")
    page.until(f"{alpha} === 0")
    page.press("Shift+B")
    page.until(f"{alpha} === {usual}")


def test_a_hidden_object_is_not_seen_and_a_locked_one_not_changed(page):
    page.draw()
    before = page.objects()
    page.press("Shift+R")
    page.drag((100, 100), (120, 100))
    page.press("3", "Delete", "Shift+Delete", "o")
    page.shows("#hint", "locked")
    assert page.objects() == before
    page.press("Escape", "]")
    page.tab.get_by_role("button", name="Lock (Shift+R) object 1").click()
    page.press("3")
    assert page.objects()[0]["motion"] == 3
    page.press("Shift+H", "Escape", "Escape")
    page.click(CORNERS[0])
    page.click((100, 100))
    assert page.value("labeller.state.selected") is None
    assert page.saved() >= 1
