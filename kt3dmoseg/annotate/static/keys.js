// The keys; from the same table their help, and the menu of the right mouse button or of the key for it.

import * as actions from "./actions.js";
import { clips, openNext } from "./clips.js";
import { button, byId, close, element, fill, open, row, walk } from "./dom.js";
import { compare, exchange, nextDifference, propose, skip } from "./exchange.js";
import { at, isDragging } from "./pointer.js";
import { flush } from "./saving.js";
import { attempt, redo, select, selectedObject, state, toggleObject, undo } from "./state.js";
import { zoomTimeline } from "./panel.js";
import { nextProblem, nextUnexplained } from "./tracks.js";
import * as view from "./view.js";

const STEPS = { ArrowLeft: -1, "Shift+ArrowLeft": -5, ArrowRight: 1, "Shift+ArrowRight": 5 };
const DIRECTIONS = {
  i: [0, -1], k: [0, 1], j: [-1, 0], l: [1, 0],
  "Shift+I": [0, -10], "Shift+K": [0, 10], "Shift+J": [-10, 0], "Shift+L": [10, 0],
  "Ctrl+ArrowLeft": [80, 0], "Ctrl+ArrowRight": [-80, 0], "Ctrl+ArrowUp": [0, 80], "Ctrl+ArrowDown": [0, -80],
};
const ON_OFF = [true, false];

const step = (name) => view.goTo(state.frame + STEPS[name]);
const nudge = (name) => actions.nudge(...DIRECTIONS[name]);

/** A line of the help; `run` gets the name of the key that was pressed. */
const key = (names, shown, text, run) => ({ names: names.split(" "), shown, text, run });

export const KEYS = {
  "Frames": [
    key("ArrowLeft Shift+ArrowLeft", "←", "previous frame (Shift: 5)", step),
    key("ArrowRight Shift+ArrowRight", "→", "next frame (Shift: 5)", step),
    key("Home", "Home", "first frame", () => view.goTo(0)),
    key("End", "End", "last frame", () => view.goTo(Infinity)),
    key("Space", "Space", "play, stop", view.play),
    key("Shift+F", "Shift+F", "go to a frame by its number", () => byId("frame").select()),
    key("f", "F", "flicker this frame and the next", view.flicker),
    key(",", ",", "previous key frame of the object", () => view.toKeyFrame(-1)),
    key(".", ".", "next key frame", () => view.toKeyFrame(1)),
    key("Shift+N Shift+M", "Shift+N M", "move the key frame to the frame before, after",
      (name) => actions.shiftKey(name === "Shift+N" ? -1 : 1)),
    key("< >", "< >", "timeline: more frames, fewer (Ctrl with wheel)",
      (name) => zoomTimeline(name === "<" ? 1.5 : 1 / 1.5)),
  ],
  "Labels": [
    key("1 2 3 4 5 6 7 8 9", "1 – 9", "motion of the object or lasso; its label in files is one more",
      (name) => actions.setMotion(Number(name))),
    key("0", "0", "background: static, in front of a motion", () => actions.setMotion(0)),
    key("x", "X", "reject: ambiguous", () => actions.setMotion("reject")),
    key("q", "Q", "lasso trajectories, then a label", () => actions.setTool("lasso")),
    key("Shift+Q", "Shift+Q", "remove the lassos of this frame", actions.removeMarksHere),
  ],
  "Objects": [
    key("n", "N", "outline a new object", () => actions.setTool("draw")),
    key("Shift+O", "Shift+O", "outline what moves: click, or drag a box (Alt: take away)",
      () => actions.setTool("click")),
    key("Shift+P Shift+X", "Shift+P X", "brush, eraser (Alt: the other)",
      (name) => actions.redraw(name === "Shift+P" ? "add" : "erase", "brush")),
    key("ArrowUp ArrowDown", "↑ ↓", "larger brush, smaller", (name) => actions.resizeBrush(name === "ArrowUp" ? 1.25 : 0.8)),
    key("r", "R", "outline it again in this frame", () => actions.redraw("region")),
    key("p", "P", "outline another part of it", () => actions.redraw("part")),
    key("] a", "]", "next object, or proposal (or A)", () => skip() || actions.cycleObject(1)),
    key("[ Shift+A", "[", "previous object (or Shift+A)", () => actions.cycleObject(-1)),
    key("Shift+1 Shift+2 Shift+3 Shift+4 Shift+5 Shift+6 Shift+7 Shift+8 Shift+9", "Shift+1 – 9",
      "first to ninth object of the list", (name) => actions.selectNth(Number(name.at(-1)))),
    key("c", "C", "copy to the next frame by motion", actions.copyToNext),
    key("o", "O", "occluded from here on", () => actions.toggleVisibility("occluded")),
    key("e", "E", "leaves: outside from here on", () => actions.toggleVisibility("outside")),
    key("Shift+E", "Shift+E", "enters here: outside before", actions.enterHere),
    key("Backspace", "Backspace", "forget this key frame (while drawing: last point)",
      () => (state.pending ? actions.takeBackPoint() : actions.forgetKey())),
    key("Delete Ctrl+Backspace", "Delete", "not in this frame (or Ctrl+Backspace)", actions.deleteHere),
    key("Shift+Delete Ctrl+Shift+Backspace", "Shift+Delete", "delete the object from the clip", actions.deleteObject),
  ],
  "Points": [
    key("v Shift+V", "V", "next point (Shift: previous)", (name) => actions.cycleVertex(name === "v" ? 1 : -1)),
    key("i k j l", "I J K L", "move the point, or the cross to draw with", nudge),
    key("Shift+I Shift+K Shift+J Shift+L", "Shift", "10 pixels at once", nudge),
    key("Enter", "Enter", "point at the cross; again: done", actions.enter),
    key("Escape", "Esc", "deselect, step by step", actions.escape),
    key("w", "W", "insert a point after this one", actions.insertVertex),
    key("d", "D", "delete the point (or right click)", () => actions.deleteVertex()),
  ],
  "View": [
    key("+ = Shift++", "+", "zoom in at the cursor (pinch, Ctrl with wheel)", () => view.zoom(1.4)),
    key("-", "−", "zoom out", () => view.zoom(1 / 1.4)),
    key("z", "Z", "zoom to the object", view.fitObject),
    key("Shift+Z", "Shift+Z", "whole frame", view.fitAll),
    key("Ctrl+ArrowLeft Ctrl+ArrowRight Ctrl+ArrowUp Ctrl+ArrowDown", "Ctrl+arrows", "pan (two fingers, wheel, drag)",
      (name) => view.pan(...DIRECTIONS[name])),
    key("t", "T", "trails", () => view.cycle("trails", ON_OFF)),
    key("y", "Y", "colour by label, by length, none",
      () => view.cycle("colouring", ["label", "length", "none"], "Colour of trajectories: ")),
    key("u", "U", "only unlabelled and conflicts", () => view.cycle("problems", ON_OFF)),
    key("g", "G", "go to the next of them, of the selected object if it has any", () => nextProblem(state.selected)),
    key("Shift+U", "Shift+U", "go to what leaves the scene's motion, without an object", nextUnexplained),
    key("Shift+W", "Shift+W", "go to the next weak frame (hatched)", actions.nextWeak),
    key("h", "H", "hide the regions", () => view.cycle("hidden", ON_OFF)),
    key("Shift+H", "Shift+H", "hide the object", () => toggleObject("unseen")),
    key("Shift+R", "Shift+R", "lock the object", () => toggleObject("locked")),
    key("b", "B", "brighter picture", () => view.cycle("brightness", [1, 1.7, 2.6], "Brightness: ")),
    key("Shift+B", "Shift+B", "fill regions strongly, not at all, as usual",
      () => view.cycle("opacity", [1, 3, 0])),
    key("Shift+S", "Shift+S", "smooth or square pixels", () => view.cycle("pixels", ["smooth", "square"], "Pixels: ")),
  ],
  "Work": [
    key("Ctrl+z", "Ctrl+Z", "undo, without limit", undo),
    key("Ctrl+Shift+Z Ctrl+y", "Ctrl+Shift+Z", "redo", redo),
    key("Ctrl+s", "Ctrl+S", "save now (saving is automatic)", flush),
    key("s", "S", "propose regions", propose),
    key("m", "M", "compare with the other annotator", compare),
    key("Shift+G", "Shift+G", "next object that the other drew otherwise", nextDifference),
    key("Ctrl+e", "Ctrl+E", "import and export", exchange),
    key("PageDown", "PageDown", "next clip", () => openNext(1)),
    key("PageUp", "PageUp", "previous clip", () => openNext(-1)),
    key("F2 Shift+C", "F2", "all clips and their state (or Shift+C)", clips),
    key("? Shift+?", "?", "these keys", help),
  ],
};

export const TABLE = new Map(Object.values(KEYS).flat().flatMap((entry) => entry.names.map((name) => [name, entry])));

/** A key as this computer's keyboard names it. */
export const here = (shown) => (/Mac|iP(hone|ad)/.test(navigator.platform) ? shown.replace("Ctrl+", "⌘") : shown);

function help() {
  const sections = Object.entries(KEYS).map(([title, lines]) => element("section", {}, element("h3", {}, title),
    element("dl", {}, lines.flatMap(({ shown, text }) =>
      [element("dt", {}, element("kbd", {}, here(shown))), element("dd", {}, text)]))));
  const mouse = "Mouse: click a region to select it, drag its points, edges or inside; double click an edge to add a "
    + "point, right click a point to delete it; while drawing, click points or draw freehand, and click the first "
    + "point to close.";
  open("Keys", element("div", { className: "help" }, sections), element("p", { className: "faint" }, mouse),
    row(button("Close", close)));
}

/** Run the action of a key; true when it has one. */
export function press(name) {
  const entry = TABLE.get(name);
  if (!entry || !state.doc) return false;
  if ((state.dragging || isDragging()) && name !== "Escape") return true; // nothing else changes under the pointer
  attempt(() => entry.run(name));
  return true;
}

function nameOf(event) {
  // On keyboards without Latin letters the key counts, wherever it is on a Latin one.
  const latin = !/^\p{L}$/u.test(event.key) || /\p{Script=Latin}/u.test(event.key);
  const letterOf = latin ? event.key : event.code.replace(/^Key/, "");
  const pressed = event.key === " " ? "Space" : letterOf;
  // What Shift makes of a digit depends on the keyboard.
  const digit = event.shiftKey && /^Digit[1-9]$/.test(event.code) && !/\d/.test(pressed) && !TABLE.has(pressed);
  if (digit) return `Shift+${event.code.at(-1)}`;
  // Of other signs, Shift is part of the sign.
  const shifted = event.shiftKey && (pressed.length > 1 || /[+\p{L}]/u.test(pressed));
  const letter = pressed.length > 1 ? pressed : shifted ? pressed.toUpperCase() : pressed.toLowerCase();
  // Some keyboards make brackets with Option (Mac) or AltGr, which browsers report as Ctrl and Alt.
  const ctrl = (event.ctrlKey || event.metaKey) && !event.altKey;
  return `${ctrl ? "Ctrl+" : ""}${shifted ? "Shift+" : ""}${letter}`;
}

addEventListener("keydown", (event) => {
  const { target } = event;
  if (document.querySelector("dialog[open]")) return;
  if (target.matches("input, select, textarea")) {
    if (event.key === "Escape" || (event.key === "Enter" && target.matches("input"))) target.blur();
    const page = target.matches("select") && event.key.startsWith("Page"); // opens clips here, too
    if (!page && !(event.ctrlKey && "sz".includes(event.key.toLowerCase()))) return;
    target.blur();
  }
  if (target.matches("button") && (event.key === "Enter" || event.key === " ")) return;
  if ((!event.altKey || "[]".includes(event.key)) && press(nameOf(event))) event.preventDefault();
});

// A button that the pointer pressed does not keep Space and Enter to itself.
addEventListener("click", ({ detail, target }) => {
  if (detail && target.closest(":is(#bar, #zoom, #panel) button")) byId("stage").focus({ preventScroll: true });
});

for (const b of document.querySelectorAll("[data-key]")) {
  const { shown, text } = TABLE.get(b.dataset.key);
  b.title = `${text[0].toUpperCase()}${text.slice(1)} (${here(shown)})`;
  b.onclick = () => press(b.dataset.key);
}

// The menu: actions on what is under the pointer, or on what is selected

const OF_OBJECT = "r p c o e Shift+E Backspace z Shift+H Shift+R Delete Shift+Delete".split(" ");
const OF_PLACE = "Shift+O n q s Shift+Z h t y".split(" ");

const menu = byId("menu");

/** Open the menu of an object, or of none, at a place of the window. */
function showMenu(item, x, y) {
  if (item) select(item.id);
  fill(menu, (item ? OF_OBJECT : OF_PLACE).map((name) => {
    const { shown, text } = TABLE.get(name);
    const run = () => (menu.hidePopover(), press(name));
    return button([text.replace(/ \(.*/, ""), element("kbd", {}, here(shown))], run, "", { role: "menuitem" });
  }));
  menu.setAttribute("aria-label", item ? item.name : "Clip");
  menu.showPopover();
  menu.style.left = `${Math.max(0, Math.min(x, innerWidth - menu.offsetWidth - 4))}px`;
  menu.style.top = `${Math.max(0, Math.min(y, innerHeight - menu.offsetHeight - 4))}px`;
  menu.firstChild.focus();
}

/** What a place on the stage, in the list or on the timeline is about. */
function itemAt(event) {
  const { target, pointerType } = event;
  const listed = target.closest(".entry");
  if (listed) return state.doc.objects.find((item) => String(item.id) === listed.dataset.id);
  if (!target.closest("#stage") || pointerType === "") return selectedObject(); // asked for by key
  return actions.objectUnder(at(event).point);
}

addEventListener("contextmenu", (event) => {
  const { target, clientX, clientY } = event;
  if (event.defaultPrevented || !state.doc || !target.closest("#stage, .entry, #timeline")) return;
  event.preventDefault();
  showMenu(itemAt(event), clientX, clientY);
});

menu.onkeydown = (event) => {
  event.stopPropagation();
  if (event.key === "Tab") menu.hidePopover();
  walk(event, [...menu.children]);
};
menu.ontoggle = ({ newState }) => newState === "closed" && byId("stage").focus({ preventScroll: true });
