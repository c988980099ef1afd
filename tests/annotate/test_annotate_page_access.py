"""The labelling page for everybody: readable, named, in order, and complete on a small screen."""

from __future__ import annotations

import numpy as np
import pytest
from labeller_page import Page, stored
from make_screenshots import DOCS, keys_table

pytestmark = pytest.mark.browser

# Contrast of WCAG 2.2, of every visible text with what lies behind it: [text, ratio] of those below 4.5.
CONTRAST = """() => {
  const parse = (text) => text.match(/[\\d.]+/g).map(Number);
  const light = ([r, g, b]) => [r, g, b].map((v) => v / 255)
    .map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4))
    .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
  const mix = (top, below, a) => [0, 1, 2].map((i) => a * top[i] + (1 - a) * below[i]);
  const over = (top, below) => mix(top, below, top[3] ?? 1);
  const ground = (element) => {
    const layers = [];
    for (let e = element; e; e = e.parentElement) layers.unshift(parse(getComputedStyle(e).backgroundColor));
    return layers.reduce((below, layer) => over(layer, below), [255, 255, 255]);
  };
  const modal = document.querySelector("dialog[open]");
  const poor = [];
  for (const element of (modal ?? document).querySelectorAll("*")) {
    const own = [...element.childNodes].filter((n) => n.nodeType === 3).map((n) => n.data.trim()).join(" ");
    const shown = own || element.value || element.placeholder;
    if (!shown || !element.checkVisibility() || element.matches("option, :disabled")) continue;
    const ink = getComputedStyle(element, own || element.value ? null : "::placeholder");
    const below = ground(element);
    const [a, b] = [light(over(parse(ink.color), below)), light(below)].sort((x, y) => y - x);
    const ratio = (a + 0.05) / (b + 0.05);
    if (ratio < 4.5) poor.push([String(shown).slice(0, 30), Math.round(100 * ratio) / 100]);
  }
  return poor;
}"""

VIOLATIONS = """() => axe.run().then(({ violations }) =>
  violations.map(({ id, nodes }) => [id, nodes.map((node) => node.html.slice(0, 120))]))"""

CUT_OFF = """() => [...document.querySelectorAll("#bar *, #panel :is(button, input, select), dialog button")]
  .filter((e) => e.checkVisibility() && !e.closest(".scroll"))
  .map((e) => [e.textContent.slice(0, 20), e.getBoundingClientRect()])
  .filter(([, box]) => box.left < 0 || box.top < 0 || box.right > innerWidth || box.bottom > innerHeight)
  .map(([text]) => text)"""

STATES = {
    "drawn": [],
    "keys": ["?"],
    "clips": ["F2"],
    "proposals": ["s"],
    "files": ["Control+e"],
    "lasso": ["q"],
    "outline": ["n"],
    "nothing chosen": ["Escape", "Escape"],
    "view": [],
}


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_a_short_look_at_every_state(page, axe, theme):
    """In each state of the page: what axe-core checks, contrast, nothing cut off at 1280x720."""
    page.tab.emulate_media(color_scheme=theme)
    page.tab.evaluate(axe)
    page.draw()
    page.until("labeller.state.labels")
    for name, keys in STATES.items():
        page.press(*keys)
        if name in ("keys", "clips", "proposals", "files"):
            page.tab.locator("dialog[open] button").first.wait_for()
        if name == "view":
            page.tab.get_by_role("button", name="View").click()
        page.value("new Promise(requestAnimationFrame)")
        assert (name, page.tab.evaluate(VIOLATIONS)) == (name, [])
        assert (name, page.tab.evaluate(CONTRAST)) == (name, [])
        assert (name, page.tab.evaluate(CUT_OFF)) == (name, [])
        page.press("Escape")
    page.value("import('/static/state.js').then(({ set }) => set({ trouble: 'away' }))")
    page.shows("#banner", "away")
    assert page.tab.evaluate(CONTRAST) == []
    assert page.value("document.documentElement.scrollWidth") == 1280


def test_buttons_that_switch_something_say_whether_it_is_on(page):
    pressed = "[...document.querySelectorAll('#bar [aria-pressed=true]')].map((b) => b.dataset.tool ?? b.id)"
    page.until(f"{pressed}.join() === 'select'")
    page.press("q", "f")
    page.until(f"{pressed}.join() === 'lasso,flicker'")
    page.press("f", "Escape", "Space")
    page.until(f"{pressed}.join() === 'select,play'")


def test_the_timeline_is_there_as_text(page):
    page.draw([(200, 20), (206, 20), (206, 26), (200, 26)])
    page.press("ArrowRight", "ArrowRight", "o", "End", "e")
    page.until("labeller.state.weak?.[1]?.[1]")
    text = page.tab.get_by_role("list", name="Timeline").get_by_role("listitem")
    expected = "object 1: visible 1 to 2; occluded 3 to 5; outside 6; key frames 1, 3, 6; in doubt 2"
    page.until(f"document.getElementById('timeline-text').textContent === '{expected}'")  # of the last edit
    assert text.all_inner_texts() == [expected]


def test_a_whole_clip_is_labelled_with_the_keyboard_alone(page, shared, moving):
    """Outline, motion, name, kind, the end of the clip, saving, its state: no mouse."""
    page.press("n", "i")
    page.until("labeller.state.cross")
    x, y = page.value("labeller.state.cross")
    walk = {"Shift+J": (x - 60) // 10, "j": (x - 60) % 10, "Shift+I": (y - 70) // 10, "i": (y - 70) % 10}
    page.press(*(key for key, count in walk.items() for _ in range(round(count))), "Enter")
    page.press(*["Shift+L"] * 8, "Enter", *["Shift+K"] * 6, "Enter", *["Shift+J"] * 8, "Enter", "Enter")
    page.until("labeller.state.doc.objects.length === 1")
    page.press("1")
    page.until("labeller.state.labels.counts.motions[2]")
    for _ in range(40):
        page.press("Tab")
        if page.value("document.activeElement.name") == "name":
            break
    page.tab.keyboard.type("drifting box")
    page.press("Tab")
    page.tab.keyboard.type("other")
    page.press("Escape", "End", "c", "Shift+W")
    page.shows("#hint", "No frame is in doubt")
    page.tab.locator("#stage").focus()
    for _ in range(40):
        page.press("Shift+Tab")
        if page.value("document.activeElement.id") == "state":
            break
    page.press("d")
    page.until("document.activeElement.ariaLabel === 'your name'")
    page.tab.keyboard.type("Ada")
    page.press("Enter")
    page.until("labeller.state.work.state === 'done'")
    page.saved()
    (item,) = stored(shared).objects
    assert (item.name, item.kind, item.motion) == ("drifting box", "other", 1)
    label = np.array(page.value("labeller.state.labels.label"))
    x, y = np.array(page.value("[...labeller.state.tracks.xy]")).reshape(len(label), -1, 2)[:, 0].T
    hidden = (x > 136) & (x < 164) & (y > 66) & (y < 134)  # by the box, later on
    assert (label == 1 + np.array(moving))[~hidden].mean() >= 0.98


def focused(page):
    return page.value(
        "(e => e.id || e.dataset.key || e.dataset.tool || e.getAttribute('aria-label') || e.textContent)"
        "(document.activeElement)"
    )


def test_tab_goes_through_the_page_from_left_to_right_and_down(page):
    page.draw()
    page.until("document.querySelector('#inspector input').checkVisibility()")
    assert focused(page) == "stage"
    behind = []
    for _ in range(25):
        page.press("Tab")
        behind.append(focused(page))
    assert behind[:4] == ["-", "scale", "+", "Shift+Z"]
    behind = behind[4:]
    assert "object 1" in behind[0]
    assert behind[1:3] == ["name", "Kind"]
    assert behind[3:14] == [*"1234567890", "x"]
    assert behind[14:17] == ["visible", "occluded", "outside"]
    assert behind[17:21] == ["note", "Backspace", "Delete", "Shift+Delete"]
    before = []
    page.tab.locator("#stage").focus()
    for _ in range(18):
        page.press("Shift+Tab")
        before.append(focused(page))
    tools = ["clips", "state", "select", "draw", "click", "Shift+P", "lasso", "undo"]
    playback = ["ArrowLeft", "frame", "ArrowRight", "play", "flicker"]
    assert before[::-1] == [*tools, *playback, "s", "Ctrl+e", "compare", "View ▾", "?"]


def test_every_key_is_in_the_help(page):
    page.press("?")
    listed = page.tab.locator("dialog kbd").all_inner_texts()
    shown = page.value(
        "import('/static/keys.js').then(m => Object.values(m.KEYS).flat().map(k => k.shown).filter(Boolean))"
    )
    assert listed == shown
    assert len(listed) > 40
    # In the docs, too: python tools/make_screenshots.py DEMO writes them.
    assert keys_table(page.tab) in DOCS.read_text(encoding="utf-8")


def test_a_large_screen_and_a_small_one(context, shared):
    page = Page(context, shared.address)
    for size in ((1920, 1080), (1280, 720), (1024, 600)):
        page.tab.set_viewport_size({"width": size[0], "height": size[1]})
        page.until(f"document.getElementById('regions').width === {size[0]}")
        left, top = page.at((0, 0))
        right, bottom = page.at((319, 199))
        box = page.box("#stage")
        assert box["x"] <= left < right <= box["x"] + box["width"]
        assert box["y"] <= top < bottom <= box["y"] + box["height"]
    assert page.errors == []
