// The panel below the frame: the objects, their timelines, and the properties of the selected one. The timeline
// shows the regions of every object over the frames, its key frames, which can be dragged, and what is in doubt;
// above them a map of all frames; and the same as text.

import { doubtAt, moveKey, setMotion, setVisibility, update, weakFrames } from "./actions.js";
import { clamp, keyAt, objectOf } from "./annotation.js";
import {
  BACKGROUND, PROBLEM, REJECTED, begin, button, byId, chip, colourOfMotion, element, faint, fill, hatch, meaningOf, signOf,
} from "./dom.js";
import { cancel, edit, now, on, preview, regionOf, select, selectedObject, set, state, toggleObject } from "./state.js";
import { nextProblem, problems } from "./tracks.js";
import { fitObject, goTo } from "./view.js";

const FIRST_STEPS = [
  "Shift+O, then drag a box around something that moves; or N, and click around it. Or S for proposals.",
  "1 to 9 gives it its motion.",
  "→ on through the frames: it follows the image. Where it left the edge, drag it back.",
  "E where it leaves, O where it is hidden. ? shows all keys.",
];
const MOTIONS = [1, 2, 3, 4, 5, 6, 7, 8, 9, 0, "reject"];

const list = byId("objects");
const properties = byId("properties");

let waiting = false; // for the button to be released: a click on what is drawn again would be lost

function drawList() {
  waiting = Boolean(list.querySelector(":active"));
  if (!state.doc || state.dragging || waiting) return;
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
    className: "object", title: note || name, "aria-pressed": String(chosen), onclick: () => select(id), ondblclick: fitObject,
  }, chip(signOf(motion), colourOfMotion(motion), meaningOf(motion), `motion ${signOf(motion)}`),
  element("span", { className: "name" }, name), doubt);
  // Not on the way of Tab, which goes from object to object: both have keys.
  const toggle = (what, text, title) => button(text, () => toggleObject(what, id), "switch", {
    title, tabIndex: -1, "aria-label": `${title} ${name}`, "aria-pressed": String(state[what].has(id)),
  });
  return element("div", { className: chosen ? "entry on" : "entry", "data-id": id }, object,
    toggle("unseen", "H", "Hide (Shift+H)"), toggle("locked", "L", "Lock (Shift+R)"));
}

// The selected object's properties; without one, how the trajectories are labelled.

let shown = null;
let byPointer = false;

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
    b.ariaPressed = [visibility, String(shown.motion)].includes(b.value);
  }
  forget.disabled = !key;
}

function change({ target }) {
  const { name } = target;
  const value = target.value.trim();
  const { id } = state.doc.objects.find((item) => item.key_frames === shown.key_frames) ?? shown; // merging renumbers
  if (value !== (shown[name] ?? "") && (value || name !== "name")) update({ id }, { [name]: value });
  if (target.matches("select") && byPointer) target.blur(); // typed letters go on choosing
}

byId("motions").append(...MOTIONS.map((motion) => button(signOf(motion), () => setMotion(motion), "",
  { title: meaningOf(motion), value: motion, style: `background: ${colourOfMotion(motion)}` })));
properties.onclick = ({ target }) => target.name === "visibility" && setVisibility(target.value);
properties.onchange = change;
properties.onpointerdown = properties.onkeydown = ({ type }) => {
  byPointer = type === "pointerdown";
};
properties.addEventListener("focusout", drawProperties);

function counts() {
  const { labels, doc, tracks } = state;
  const head = (text) => element("h2", {}, text);
  if (!labels) return [head("Trajectories"), faint(tracks ? "labelling…" : "not there yet")];
  const { motions, rejected, short, conflict } = labels.counts;
  const names = new Map(doc.objects.toReversed().map((item) => [item.motion, item.name]));
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
  const found = problems();
  const open = doc.objects.filter(({ id }) => found.has(id)).map(({ id, name }) =>
    button(`${found.get(id).length} unlabelled at ${name}`, () => nextProblem(id)));
  return [head(`${labels.label.length} trajectories`), element("div", { className: "counts" }, cells), ...open];
}

addEventListener("pointerup", () => waiting && requestAnimationFrame(drawList));
list.onscroll = () => set({ scrolled: list.scrollTop });
on(["doc", "dragging", "selected", "clip", "unseen", "locked", "weak"], drawList);
on(["clip"], () => fill(properties.elements.kind, state.clip.kinds.map((kind) => element("option", {}, kind))));
on(["doc", "selected", "frame", "labels", "regions", "dragging", "clip"], drawProperties);

// The timeline

// Heights of a row, as in the list, of the head, and of the map in it; half a key frame; fewest frames in sight.
const ROW = 26;
const MAP = 7;
const KEY = 7;
const FEWEST = 8;
const PINCH = 0.01;

const canvas = byId("timeline");
const context = canvas.getContext("2d");
let colours = {};
let drag = null;

/** The frames in sight: the first, how many, and pixels of each. */
function span() {
  const { from = 0, count = state.clip.n_frames } = state.span ?? {};
  return { from, count, column: canvas.clientWidth / count };
}

function show(from, count) {
  const all = state.clip.n_frames;
  set({ span: count < all ? { from: clamp(from, 0, all - count), count } : null });
}

/** Show fewer or more frames; the one at a share of the width stays there. */
export function zoomTimeline(factor, share = (state.frame + 0.5 - span().from) / span().count) {
  const { from, count } = span();
  const next = clamp(count * factor, Math.min(FEWEST, state.clip.n_frames), state.clip.n_frames);
  show(from + share * (count - next), next);
}

function follow() {
  if (!state.clip || !state.span) return;
  const { from, count } = span();
  if (state.frame < from || state.frame + 1 > from + count) show(state.frame + 0.5 - count / 2, count);
}

function drawTimeline() {
  if (!state.doc) return;
  begin(canvas);
  const { color, backgroundColor, outlineColor, caretColor } = getComputedStyle(canvas);
  colours = { ink: color, ground: backgroundColor, faint: outlineColor, accent: caretColor, doubt: hatch(context, color) };
  const { from, column } = span();
  bar(colours.accent, 0.25, (state.frame - from) * column, 0, Math.max(2, column), canvas.clientHeight);
  state.doc.objects.forEach((item, k) => drawRow(item, ROW + k * ROW - state.scrolled));
  drawHead();
  drawMap();
}

function bar(colour, alpha, ...box) {
  context.globalAlpha = alpha;
  context.fillStyle = colour;
  context.fillRect(...box);
  context.globalAlpha = 1;
}

function drawHead() {
  const { numbers, n_frames } = state.clip;
  const { from, count, column } = span();
  bar(colours.ground, 1, 0, 0, canvas.clientWidth, ROW);
  bar(colours.accent, 0.45, (state.frame - from) * column, MAP, Math.max(2, column), ROW - MAP);
  context.font = "11px ui-monospace, monospace";
  context.textAlign = "center";
  const every = Math.max(1, Math.ceil((8 + 7 * numbers.at(-1).length) / column));
  for (let frame = Math.floor(from); frame < Math.min(n_frames, from + count); frame++) {
    if (frame % every && frame !== state.frame) continue;
    context.fillStyle = frame === state.frame ? colours.ink : colours.faint;
    context.fillText(numbers[frame], (frame + 0.5 - from) * column, 20);
  }
}

/** All frames: key frames, doubtful ones, those in sight below, and the present one. */
function drawMap() {
  const { n_frames } = state.clip;
  const { from, count } = span();
  const pixels = canvas.clientWidth / n_frames;
  bar(colours.accent, 0.3, from * pixels, 0, count * pixels, MAP);
  for (const item of state.doc.objects) {
    for (const [frame] of weakFrames(item)) bar(colours.doubt, 0.7, frame * pixels, 0, Math.max(2, pixels), MAP);
    const colour = colourOfMotion(item.motion);
    for (const { frame } of item.key_frames) bar(colour, 1, (frame + 0.5) * pixels - 1, 1, 2, MAP - 2);
  }
  bar(colours.ink, 1, (state.frame + 0.5) * pixels - 1, 0, 2, MAP);
}

function drawRow(item, top) {
  if (top < 0 || top > canvas.clientHeight) return;
  const { from, count, column } = span();
  if (item.id === state.selected) bar(colours.accent, 0.15, 0, top, canvas.clientWidth, ROW);
  const colour = colourOfMotion(item.motion);
  for (let frame = Math.floor(from); frame < Math.min(state.clip.n_frames, from + count); frame++) {
    const { visibility, key } = regionOf(item, frame);
    const [left, middle] = [(frame - from) * column, top + ROW / 2];
    const half = { visible: 3, occluded: 0.5, outside: -1 }[visibility];
    bar(colours.faint, 0.7, left, middle - half - 1, column + 0.5, 2 * half + 2);
    if (half > 0) bar(colour, 0.7, left, middle - half, column + 0.5, 2 * half);
    if (doubtAt(item, frame)) bar(colours.doubt, 0.7, left, top + 3, column, ROW - 6);
    if (key) drawKey(left + column / 2, middle, visibility === "visible", colour);
  }
}

function drawKey(x, y, seen, colour) {
  const diamond = new Path2D(`M${x} ${y - KEY}l7 7l-7 7l-7 -7z`);
  context.fillStyle = seen ? colour : colours.ground;
  context.fill(diamond);
  context.strokeStyle = seen ? "#101216" : colours.faint;
  context.lineWidth = 1.5;
  context.stroke(diamond);
}

// The pointer: the map and the head go to frames, a row also selects, a key frame is dragged

function frameAt({ offsetX }) {
  const { from, column } = span();
  const last = state.clip.n_frames - 1;
  const frame = drag === "map" ? (offsetX / canvas.clientWidth) * (last + 1) : from + offsetX / column;
  return clamp(Math.floor(frame), 0, last);
}

function down(event) {
  if (!state.doc || event.button) return;
  canvas.setPointerCapture(event.pointerId);
  const { offsetX, offsetY } = event;
  drag = offsetY < MAP ? "map" : "frame";
  const frame = frameAt(event);
  const item = offsetY > ROW && state.doc.objects[Math.floor((offsetY - ROW + state.scrolled) / ROW)];
  const { from, column } = span();
  if (item && keyAt(item, frame) && Math.abs((frame + 0.5 - from) * column - offsetX) <= KEY) {
    drag = { id: item.id, frame };
  }
  if (goTo(frame) && item) select(item.id);
}

function move(event) {
  if (!drag || !(event.buttons & 1)) return;
  const to = frameAt(event);
  goTo(to);
  const doc = state.dragging ?? state.doc; // somebody else's work may have come in since the pointer went down
  const item = objectOf(doc, drag.id);
  const moved = item && keyAt(item, drag.frame) && moveKey(doc, item, drag.frame, to);
  if (moved) preview(moved);
}

function up() {
  drag = null;
  if (state.dragging) edit(state.doc);
}

function wheel(event) {
  event.preventDefault();
  if (!state.clip) return;
  const { from, count, column } = span();
  const factor = Math.exp(clamp(event.deltaY, -25, 25) * PINCH);
  if (event.ctrlKey || event.metaKey) zoomTimeline(factor, event.offsetX / canvas.clientWidth);
  else if (event.deltaX || event.shiftKey) show(from + (event.deltaX || event.deltaY) / column, count);
  else list.scrollTop += event.deltaY;
}

// As text, for who does not see it

/** [3, 4, 5, 9] as "3 to 5, 9", in the numbers of the files. */
function runs(frames) {
  const starts = frames.filter((frame, k) => frames[k - 1] !== frame - 1);
  const ends = frames.filter((frame, k) => frames[k + 1] !== frame + 1);
  const { numbers } = state.clip;
  const run = (start, end) => (start === end ? numbers[start] : `${numbers[start]} to ${numbers[end]}`);
  return starts.map((start, k) => run(start, ends[k])).join(", ");
}

function sentence(item) {
  const frames = [...Array(state.clip.n_frames).keys()];
  const shown = (wanted) => frames.filter((frame) => regionOf(item, frame).visibility === wanted);
  const parts = [
    ...["visible", "occluded", "outside"].map((what) => [what, shown(what)]),
    ["key frames", item.key_frames.map((key) => key.frame)], ["in doubt", weakFrames(item).map(([frame]) => frame)],
  ];
  const said = parts.filter(([, found]) => found.length).map(([what, found]) => `${what} ${runs(found)}`);
  return `${item.name}: ${said.join("; ")}`;
}

function writeText() {
  const { doc, dragging } = state;
  if (doc && !dragging) fill(byId("timeline-text"), doc.objects.map((item) => element("li", {}, sentence(item))));
}

addEventListener("keydown", ({ key }) => key === "Escape" && (drag = null), true);
Object.assign(canvas, { onpointerdown: down, onpointermove: move, onpointerup: up, onpointercancel: () => (drag = null, cancel()) });
canvas.addEventListener("wheel", wheel, { passive: false });
now(["frame"], follow);
on(["doc", "frame", "selected", "clip", "regions", "weak", "scrolled", "resized", "span", "theme"], drawTimeline);
on(["doc", "dragging", "clip", "regions", "weak"], writeText);
