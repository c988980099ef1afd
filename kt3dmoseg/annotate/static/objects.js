// The panel below the frame: the objects, their key frames over time, and the properties of the selected one.

import {
  deleteHere, deleteObject, forgetKey, regionOf, setMotion, setVisibility, update, weakFrames,
} from "./actions.js";
import {
  BACKGROUND, PROBLEM, REJECTED, begin, byId, chip, colourOfMotion, element, faint, fill, row,
} from "./dom.js";
import { on, select, selectedObject, set, state, toggleObject } from "./state.js";
import { fitObject, goTo, numberOf } from "./view.js";

const HEAD = 26;
const ROW = 26;
const DARK = "#1f2228";
const FIRST_STEPS = [
  "N, then click around something that moves; Enter closes the outline. Or S for proposals.",
  "1 to 9 gives it its motion.",
  "→ on through the frames: it follows the image. Where it left the edge, drag it back.",
  "E where it leaves, O where it is hidden. ? shows all keys.",
];

const MOTIONS = [1, 2, 3, 4, 5, 6, 7, 8, 9, 0, "reject"];
const MEANING = { reject: "reject: ambiguous (X)", 0: "static, in front (0)" };
const VISIBILITY = { visible: "seen here", occluded: "occluded from here on (O)", outside: "outside from here on (E)" };
const list = byId("objects");
const canvas = byId("timeline");
const properties = byId("inspector");
const context = canvas.getContext("2d");

function drawList() {
  if (!state.doc) return;
  const { objects } = state.doc;
  const focused = list.contains(document.activeElement) && document.activeElement.closest(".entry")?.dataset.id;
  fill(list, objects.length ? objects.map(objectButton)
    : element("ol", { className: "empty" }, FIRST_STEPS.map((step) => element("li", {}, step))));
  if (focused) list.querySelector(`[data-id="${focused}"] .object`)?.focus();
  list.querySelector(".on")?.scrollIntoView({ block: "nearest" });
}

function objectButton(item) {
  const chosen = item.id === state.selected;
  const weak = weakFrames(item).length;
  const made = element("button", {
    className: "object", title: item.note ?? "", "aria-pressed": String(chosen),
    "aria-label": `${item.name}, ${item.kind}, motion ${item.motion}${weak ? `, ${weak} weak frames` : ""}`,
    onclick: () => select(item.id), ondblclick: fitObject,
  }, chip(item.motion === "reject" ? "x" : String(item.motion), colourOfMotion(item.motion)),
  element("span", { className: "name" }, item.name), weak ? element("span", { className: "weak" }, `${weak} weak`)
    : faint(item.kind));
  return element("div", { className: chosen ? "entry on" : "entry", "data-id": item.id }, made,
    toggleButton(item, "unseen", "H", "Hide (Shift+H)"), toggleButton(item, "locked", "L", "Lock (Shift+R)"));
}

// Not on the way of Tab, which goes from object to object: both have keys.
const toggleButton = (item, kind, text, title) => element("button", {
  className: "switch", title, tabIndex: -1, "aria-label": `${title} ${item.name}`,
  "aria-pressed": String(state[kind].has(item.id)), onclick: () => toggleObject(kind, item.id),
}, text);

/** One row per object, one column per frame. */
function drawTimeline() {
  if (!state.doc) return;
  begin(canvas);
  const { clientWidth: width, clientHeight: height } = canvas;
  const column = width / state.clip.n_frames;
  context.fillStyle = "#2f6f9660";
  context.fillRect(state.frame * column, 0, Math.max(2, column), height);
  state.doc.objects.forEach((item, k) => drawRow(item, HEAD + k * ROW - state.scrolled, column, width));
  drawHead(column, width);
}

function drawHead(column, width) {
  context.fillStyle = DARK;
  context.fillRect(0, 0, width, HEAD);
  context.fillStyle = "#2f6f96";
  context.fillRect(state.frame * column, 0, Math.max(2, column), HEAD);
  context.font = "11px ui-monospace, monospace";
  context.textAlign = "center";
  const widest = 8 + 7 * numberOf(state.clip.n_frames - 1).length;
  const every = Math.max(1, Math.ceil(widest / column));
  for (let frame = 0; frame < state.clip.n_frames; frame++) {
    if (frame % every && frame !== state.frame) continue;
    context.fillStyle = frame === state.frame ? "#ffffff" : "#a9b1bf";
    context.fillText(numberOf(frame), (frame + 0.5) * column, 17);
  }
}

function drawRow(item, top, column, width) {
  if (top < 0 || top > canvas.clientHeight) return;
  if (item.id === state.selected) {
    context.fillStyle = "#56b4e926";
    context.fillRect(0, top, width, ROW);
  }
  const colour = colourOfMotion(item.motion);
  for (let frame = 0; frame < state.clip.n_frames; frame++) {
    const { visibility, key } = regionOf(item, frame);
    const [left, middle] = [frame * column, top + ROW / 2];
    if (visibility !== "outside") {
      context.fillStyle = colour;
      context.globalAlpha = visibility === "occluded" ? 0.25 : 0.6;
      context.fillRect(left, middle - 3, column + 0.5, 6);
      context.globalAlpha = 1;
    }
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
  context.beginPath();
  for (const [dx, dy] of [[0, -7], [7, 0], [0, 7], [-7, 0]]) context.lineTo(x + dx, y + dy);
  context.closePath();
  context.fillStyle = seen ? colour : DARK;
  context.fill();
  context.strokeStyle = seen ? "#101216" : colour;
  context.lineWidth = 1.5;
  context.stroke();
}

function click(event) {
  if (!state.doc) return;
  const box = canvas.getBoundingClientRect();
  const y = event.clientY - box.top - HEAD;
  goTo(Math.floor(((event.clientX - box.left) / box.width) * state.clip.n_frames));
  const item = state.doc.objects[Math.floor((y + state.scrolled) / ROW)];
  if (event.type === "pointerdown" && item && y > 0) select(item.id);
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
      choice(name, title, () => setVisibility(name), { className: region.visibility === name ? "on" : "" })))),
    field("Note", input(item, "note", "why, when it is not obvious")),
    row(
      choice("Forget key", "Let it follow the motion here (Backspace)", forgetKey, { disabled: !region.key }),
      choice("Delete here", "Not in this frame (Delete)", deleteHere),
      choice("Delete object", "From the whole clip (Shift+Delete)", deleteObject, { className: "danger" })),
  ];
}

const field = (name, content) => row(element("label", {}, name), content);

const choice = (text, title, run, more = {}) =>
  element("button", { title, "data-focus": text, onclick: () => run(), ...more }, text);

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
  const made = choice(motion === "reject" ? "x" : String(motion), MEANING[motion] ?? `motion ${motion}, label ${motion + 1} in files`,
    () => setMotion(motion), { className: chosen ? "on" : "", "aria-pressed": String(chosen) });
  made.style.background = colourOfMotion(motion);
  return made;
}

function counts() {
  const { labels, doc, tracks } = state;
  if (!labels) {
    const text = tracks ? "labelling…" : "not there yet";
    return [element("h2", {}, "Trajectories"), element("p", { className: "faint" }, text)];
  }
  const { motions, rejected, short, conflict } = labels.counts;
  const names = new Map(doc.objects.map((item) => [item.motion, item.name]));
  const numbers = Object.keys(motions).map((label) => label - 1).filter((motion) => motion >= 1);
  const rows = [
    ["background (label 1)", BACKGROUND, motions[1] ?? 0],
    ...numbers.map((motion) => [`${names.get(motion) ?? `motion ${motion}`} (label ${motion + 1})`, colourOfMotion(motion), motions[motion + 1]]),
    ["rejected", REJECTED, rejected],
    ["too short to label", PROBLEM, short],
    ["in conflict", PROBLEM, conflict],
  ];
  const cells = rows.flatMap(([name, colour, count]) =>
    [chip(" ", colour), element("span", {}, name), element("span", { className: "n" }, String(count))]);
  return [element("h2", {}, `${labels.label.length} trajectories`), element("div", { className: "counts" }, cells)];
}

canvas.addEventListener("pointerdown", click);
canvas.addEventListener("pointermove", (event) => event.buttons & 1 && click(event));
canvas.addEventListener("wheel", (event) => (list.scrollTop += event.deltaY), { passive: true });
list.addEventListener("scroll", () => set({ scrolled: list.scrollTop }));
on(["doc", "selected", "clip", "unseen", "locked", "weak"], drawList);
on(["doc", "frame", "selected", "clip", "regions", "weak", "scrolled", "resized"], drawTimeline);
on(["doc", "selected", "frame", "labels", "regions", "dragging", "clip"], drawProperties);
