// The timeline: the regions of every object over the frames, its key frames, which can be dragged, and what is in
// doubt; above them a map of all frames; and the same as text.

import { doubtAt, moveKey, weakFrames } from "./actions.js";
import { clamp, keyAt } from "./annotation.js";
import { begin, byId, colourOfMotion, element, fill, hatch } from "./dom.js";
import { edit, now, on, preview, regionOf, select, set, state } from "./state.js";
import { goTo } from "./view.js";

// Heights of a row, as in the list, of the head, and of the map in it; half a key frame; fewest frames in sight.
const ROW = 26;
const MAP = 7;
const KEY = 7;
const FEWEST = 8;
const PINCH = 0.01;

const canvas = byId("timeline");
const list = byId("objects");
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
    drag = { item, frame, doc: state.doc };
  }
  goTo(frame);
  if (item) select(item.id);
}

function move(event) {
  if (!drag || !(event.buttons & 1)) return;
  const to = frameAt(event);
  goTo(to);
  const moved = drag.item && moveKey(drag.doc, drag.item, drag.frame, to);
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

Object.assign(canvas, { onpointerdown: down, onpointermove: move, onpointerup: up, onpointercancel: up });
canvas.addEventListener("wheel", wheel, { passive: false });
now(["frame"], follow);
on(["doc", "frame", "selected", "clip", "regions", "weak", "scrolled", "resized", "span", "theme"], drawTimeline);
on(["doc", "dragging", "clip", "regions", "weak"], writeText);
