// The panel below the frame: the objects, their key frames over time, and the properties of the selected one.

import { setMotion, setVisibility, update, weakFrames } from "./actions.js";
import {
  BACKGROUND, PROBLEM, REJECTED, begin, button, byId, chip, colourOfMotion, element, faint, fill, meaningOf, signOf,
} from "./dom.js";
import { on, regionOf, select, selectedObject, set, state, toggleObject } from "./state.js";
import { fitObject, goTo } from "./view.js";

// Height of a row of the list and the timeline, and of the timeline's head.
const ROW = 26;
const DARK = "#1f2228";
const FIRST_STEPS = [
  "N, then click around something that moves; Enter closes the outline. Or S for proposals.",
  "1 to 9 gives it its motion.",
  "→ on through the frames: it follows the image. Where it left the edge, drag it back.",
  "E where it leaves, O where it is hidden. ? shows all keys.",
];
const MOTIONS = [1, 2, 3, 4, 5, 6, 7, 8, 9, 0, "reject"];

const list = byId("objects");
const canvas = byId("timeline");
const properties = byId("properties");
const context = canvas.getContext("2d");

// A square of 5 pixels of slanted lines, for weak frames.
const tile = new OffscreenCanvas(5, 5).getContext("2d");
Object.assign(tile, { strokeStyle: "#eceff4", lineWidth: 1.2 });
tile.stroke(new Path2D("M-1 6L6 -1M-1 1L1 -1M4 6L6 4"));
const HATCH = context.createPattern(tile.canvas, "repeat");

function drawList() {
  if (!state.doc) return;
  const { objects } = state.doc;
  const focused = list.contains(document.activeElement) && document.activeElement.closest(".entry")?.dataset.id;
  fill(list, objects.length ? objects.map(entry)
    : element("ol", { className: "empty" }, FIRST_STEPS.map((step) => element("li", {}, step))));
  if (focused) list.querySelector(`[data-id="${focused}"] .object`)?.focus();
  list.querySelector(".on")?.scrollIntoView({ block: "nearest" });
}

function entry(item) {
  const { id, name, kind, motion, note = "" } = item;
  const chosen = id === state.selected;
  const weak = weakFrames(item).length;
  const doubt = weak ? element("span", { className: "weak" }, `${weak} weak`) : faint(kind);
  const object = element("button", {
    className: "object", title: note, "aria-pressed": String(chosen), onclick: () => select(id), ondblclick: fitObject,
    "aria-label": `${name}, ${kind}, motion ${motion}${weak ? `, ${weak} weak frames` : ""}`,
  }, chip(signOf(motion), colourOfMotion(motion), meaningOf(motion)),
  element("span", { className: "name" }, name), doubt);
  // Not on the way of Tab, which goes from object to object: both have keys.
  const toggle = (what, text, title) => button(text, () => toggleObject(what, id), "switch", {
    title, tabIndex: -1, "aria-label": `${title} ${name}`, "aria-pressed": String(state[what].has(id)),
  });
  return element("div", { className: chosen ? "entry on" : "entry", "data-id": id }, object,
    toggle("unseen", "H", "Hide (Shift+H)"), toggle("locked", "L", "Lock (Shift+R)"));
}

function drawTimeline() {
  if (!state.doc) return;
  begin(canvas);
  const { clientWidth: width, clientHeight: height } = canvas;
  const column = width / state.clip.n_frames;
  bar("#2f6f9660", state.frame * column, 0, Math.max(2, column), height);
  state.doc.objects.forEach((item, k) => drawRow(item, ROW + k * ROW - state.scrolled, column, width));
  drawHead(column, width);
}

function bar(colour, ...box) {
  context.fillStyle = colour;
  context.fillRect(...box);
}

function drawHead(column, width) {
  const { n_frames, numbers } = state.clip;
  bar(DARK, 0, 0, width, ROW);
  bar("#2f6f96", state.frame * column, 0, Math.max(2, column), ROW);
  context.font = "11px ui-monospace, monospace";
  context.textAlign = "center";
  const every = Math.max(1, Math.ceil((8 + 7 * numbers.at(-1).length) / column));
  for (let frame = 0; frame < n_frames; frame++) {
    if (frame % every && frame !== state.frame) continue;
    context.fillStyle = frame === state.frame ? "#ffffff" : "#a9b1bf";
    context.fillText(numbers[frame], (frame + 0.5) * column, 17);
  }
}

function drawRow(item, top, column, width) {
  if (top < 0 || top > canvas.clientHeight) return;
  if (item.id === state.selected) bar("#56b4e926", 0, top, width, ROW);
  const colour = colourOfMotion(item.motion);
  for (let frame = 0; frame < state.clip.n_frames; frame++) {
    const { visibility, key } = regionOf(item, frame);
    const [left, middle] = [frame * column, top + ROW / 2];
    context.globalAlpha = { visible: 0.6, occluded: 0.25, outside: 0 }[visibility];
    bar(colour, left, middle - 3, column + 0.5, 6);
    context.globalAlpha = 1;
    if (state.weak?.[item.id]?.[frame]) bar(HATCH, left, top + 3, column, ROW - 6);
    if (key) drawKey(left + column / 2, middle, visibility === "visible", colour);
  }
}

function drawKey(x, y, seen, colour) {
  const diamond = new Path2D(`M${x} ${y - 7}l7 7l-7 7l-7 -7z`);
  context.fillStyle = seen ? colour : DARK;
  context.fill(diamond);
  context.strokeStyle = seen ? "#101216" : colour;
  context.lineWidth = 1.5;
  context.stroke(diamond);
}

function click({ type, offsetX, offsetY }) {
  if (!state.doc) return;
  goTo(Math.floor((offsetX / canvas.clientWidth) * state.clip.n_frames));
  const item = state.doc.objects[Math.floor((offsetY - ROW + state.scrolled) / ROW)];
  if (type === "pointerdown" && item && offsetY > ROW) select(item.id);
}

// The selected object's properties; without one, how the trajectories are labelled.

let shown = null;

function drawProperties() {
  if (!state.doc || state.dragging || properties.querySelector("input:focus")) return;
  shown = selectedObject();
  properties.hidden = !shown;
  fill(byId("counts"), shown ? [] : counts());
  if (!shown) return;
  const { visibility, key } = regionOf(shown, state.frame);
  const { name, kind, note, forget } = properties.elements;
  for (const field of [name, kind, note]) field.value = shown[field.name] ?? "";
  for (const b of properties.querySelectorAll("[value]")) {
    const on = [visibility, String(shown.motion)].includes(b.value);
    b.classList.toggle("on", on);
    b.ariaPressed = on;
  }
  forget.disabled = !key;
}

function change({ target }) {
  const { name } = target;
  const value = target.value.trim();
  if (value !== (shown[name] ?? "") && (value || name !== "name")) update(shown, { [name]: value });
  if (target.matches("select")) target.blur();
}

byId("motions").append(...MOTIONS.map((motion) => button(signOf(motion), () => setMotion(motion), "",
  { title: meaningOf(motion), value: motion, style: `background: ${colourOfMotion(motion)}` })));
properties.onclick = ({ target }) => target.name === "visibility" && setVisibility(target.value);
properties.onchange = change;
properties.addEventListener("focusout", drawProperties);

function counts() {
  const { labels, doc, tracks } = state;
  const head = (text) => element("h2", {}, text);
  if (!labels) return [head("Trajectories"), faint(tracks ? "labelling…" : "not there yet")];
  const { motions, rejected, short, conflict } = labels.counts;
  const names = new Map(doc.objects.map((item) => [item.motion, item.name]));
  const numbers = Object.keys(motions).map((label) => label - 1).filter((motion) => motion >= 1);
  const rows = [
    ["background (label 1)", BACKGROUND, motions[1] ?? 0],
    ...numbers.map((m) => [`${names.get(m) ?? `motion ${m}`} (label ${m + 1})`, colourOfMotion(m), motions[m + 1]]),
    ["rejected", REJECTED, rejected],
    ["too short to label", PROBLEM, short],
    ["in conflict", PROBLEM, conflict],
  ];
  const cells = rows.flatMap(([name, colour, count]) =>
    [chip(" ", colour), element("span", {}, name), element("span", { className: "n" }, String(count))]);
  return [head(`${labels.label.length} trajectories`), element("div", { className: "counts" }, cells)];
}

canvas.onpointerdown = click;
canvas.onpointermove = (event) => event.buttons & 1 && click(event);
canvas.addEventListener("wheel", (event) => (list.scrollTop += event.deltaY), { passive: true });
list.onscroll = () => set({ scrolled: list.scrollTop });
on(["doc", "selected", "clip", "unseen", "locked", "weak"], drawList);
on(["doc", "frame", "selected", "clip", "regions", "weak", "scrolled", "resized"], drawTimeline);
on(["clip"], () => fill(properties.elements.kind, state.clip.kinds.map((kind) => element("option", {}, kind))));
on(["doc", "selected", "frame", "labels", "regions", "dragging", "clip"], drawProperties);
