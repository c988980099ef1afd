// The panel below the frame: the objects, their key frames over time, and the properties of the selected one.

import { deleteHere, deleteObject, forgetKey, setMotion, setVisibility, update, weakFrames } from "./actions.js";
import {
  BACKGROUND, PROBLEM, REJECTED, begin, button, byId, chip, colourOfMotion, element, faint, fill, meaningOf, row, signOf,
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
const VISIBILITY = { visible: "seen here", occluded: "occluded from here on (O)", outside: "outside from here on (E)" };

const list = byId("objects");
const canvas = byId("timeline");
const properties = byId("inspector");
const context = canvas.getContext("2d");

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
  }, chip(signOf(motion), colourOfMotion(motion), meaningOf(motion)), element("span", { className: "name" }, name), doubt);
  // Not on the way of Tab, which goes from object to object: both have keys.
  const toggle = (what, text, title) => button(text, () => toggleObject(what, id), "switch", {
    title, tabIndex: -1, "aria-label": `${title} ${name}`, "aria-pressed": String(state[what].has(id)),
  });
  return element("div", { className: chosen ? "entry on" : "entry", "data-id": id }, object,
    toggle("unseen", "H", "Hide (Shift+H)"), toggle("locked", "L", "Lock (Shift+R)"));
}

/** One row per object, one column per frame. */
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
    if (state.weak?.[item.id]?.[frame]) hatch(left, top + 3, column, ROW - 6);
    if (key) drawKey(left + column / 2, middle, visibility === "visible", colour);
  }
}

function hatch(left, top, width, height) {
  context.save();
  context.beginPath();
  context.rect(left, top, width, height);
  context.clip();
  context.beginPath();
  for (let x = left - height; x < left + width; x += 5) {
    context.moveTo(x, top + height);
    context.lineTo(x + height, top);
  }
  context.strokeStyle = "#eceff4";
  context.lineWidth = 1.2;
  context.stroke();
  context.restore();
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

function drawProperties() {
  const focused = properties.contains(document.activeElement) ? document.activeElement : null;
  if (!state.doc || state.dragging || focused?.matches("input")) return;
  const item = selectedObject();
  fill(properties, item ? propertiesOf(item) : counts());
  if (focused) properties.querySelector(`[data-focus="${focused.dataset.focus}"]`)?.focus();
}

function propertiesOf(item) {
  const region = regionOf(item, state.frame);
  return [
    field("Name", input(item, "name")),
    field("Kind", kinds(item)),
    field("Motion", element("div", { className: "keys" }, MOTIONS.map((motion) => motionButton(item, motion)))),
    field("Here", element("div", { className: "three" }, Object.entries(VISIBILITY).map(([name, title]) =>
      choice(name, title, () => setVisibility(name), region.visibility === name ? "on" : "")))),
    field("Note", input(item, "note", "why, when it is not obvious")),
    row(
      choice("Forget key", "Let it follow the motion here (Backspace)", forgetKey, "", { disabled: !region.key }),
      choice("Delete here", "Not in this frame (Delete)", deleteHere),
      choice("Delete object", "From the whole clip (Shift+Delete)", deleteObject, "danger")),
  ];
}

const field = (name, content) => row(element("label", {}, name), content);

const choice = (text, title, run, className, more) => button(text, run, className, { title, "data-focus": text, ...more });

function input(item, name, placeholder = "") {
  const commit = (event) => {
    const value = event.target.value.trim();
    if (value !== (item[name] ?? "") && (value || name !== "name")) update(item, { [name]: value });
  };
  return element("input", {
    value: item[name] ?? "", maxLength: 200, "aria-label": name, "data-focus": name, placeholder, onchange: commit,
    // Not before the focus has gone to where Tab sends it: what is drawn again cannot take it.
    onblur: () => setTimeout(drawProperties),
  });
}

function kinds(item) {
  const choose = (event) => {
    update(item, { kind: event.target.value });
    event.target.blur();
  };
  return element("select", { "aria-label": "Kind", "data-focus": "kind", onchange: choose },
    state.clip.kinds.map((kind) => element("option", { value: kind, selected: kind === item.kind }, kind)));
}

function motionButton(item, motion) {
  const chosen = item.motion === motion;
  return choice(signOf(motion), meaningOf(motion), () => setMotion(motion), chosen ? "on" : "",
    { style: `background: ${colourOfMotion(motion)}`, "aria-pressed": String(chosen) });
}

function counts() {
  const { labels, doc, tracks } = state;
  const head = (text) => element("h2", {}, text);
  if (!labels) return [head("Trajectories"), element("p", { className: "faint" }, tracks ? "labelling…" : "not there yet")];
  const { motions, rejected, short, conflict } = labels.counts;
  const names = new Map(doc.objects.map((item) => [item.motion, item.name]));
  const numbers = Object.keys(motions).map((label) => label - 1).filter((motion) => motion >= 1);
  const rows = [
    ["background (label 1)", BACKGROUND, motions[1] ?? 0],
    ...numbers.map((motion) =>
      [`${names.get(motion) ?? `motion ${motion}`} (label ${motion + 1})`, colourOfMotion(motion), motions[motion + 1]]),
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
on(["doc", "selected", "frame", "labels", "regions", "dragging", "clip"], drawProperties);
