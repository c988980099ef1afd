"""The labelling page for everybody: readable, named, in order, and complete on a small screen."""

from __future__ import annotations

import pytest
from labeller_page import Page

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

NAMELESS = """() => [...document.querySelectorAll("button, input, select, textarea, a[href], [tabindex]")]
  .filter((e) => e.checkVisibility())
  .filter((e) => !(e.getAttribute("aria-label") || e.textContent.trim() || e.labels?.length))
  .map((e) => e.outerHTML.slice(0, 80))"""

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
}


def test_a_short_look_at_every_state(page):
    """In each state of the page: contrast, names, nothing cut off at 1280x720."""
    assert page.tab.evaluate(CONTRAST) == []
    page.draw()
    page.until("labeller.state.labels")
    for name, keys in STATES.items():
        page.press(*keys)
        if name in ("keys", "clips", "proposals", "files"):
            page.tab.locator("dialog[open] button").first.wait_for()
        page.value("new Promise(requestAnimationFrame)")
        assert (name, page.tab.evaluate(CONTRAST)) == (name, [])
        assert (name, page.tab.evaluate(NAMELESS)) == (name, [])
        assert (name, page.tab.evaluate(CUT_OFF)) == (name, [])
        page.press("Escape")
    assert page.value("document.documentElement.scrollWidth") == 1280


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
    for _ in range(16):
        page.press("Shift+Tab")
        before.append(focused(page))
    tools = ["clips", "state", "select", "draw", "lasso", "undo"]
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
