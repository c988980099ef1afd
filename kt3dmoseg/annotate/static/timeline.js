// The list of objects, and next to it their key frames over time: one row per object, one column per frame.

import { regionOf } from "./actions.js";
import { colourOfMotion } from "./colours.js";
import { begin, byId, element, faint, fill, resize } from "./dom.js";
import { on, select, set, state } from "./state.js";
import { fitObject, goTo } from "./view.js";

const HEAD = 26;
const ROW = 26;
const DARK = "#1f2228";
const FIRST_STEPS = [
  "N, then click around something that moves; Enter closes the outline. Or S for proposals.",
  "1 to 9 gives it its motion.",
  "→ on through the frames: it follows the image. Where it left the edge, drag it back.",
  "E where it leaves, O where it is hidden. ? shows all keys.",
];

const list = byId("objects");
const canvas = byId("timeline");
const context = canvas.getContext("2d");

/** A square in a motion's colour. */
export function chip(text, colour) {
  const made = element("span", { className: "chip" }, text);
  made.style.background = colour;
  return made;
}

function drawList() {
  if (!state.doc) return;
  const { objects } = state.doc;
  fill(list, objects.length ? objects.map(objectButton)
    : element("ol", { className: "empty" }, FIRST_STEPS.map((step) => element("li", {}, step))));
  list.querySelector(".on")?.scrollIntoView({ block: "nearest" });
}

function objectButton(item) {
  const chosen = item.id === state.selected;
  return element("button", {
    className: chosen ? "object on" : "object", title: item.note ?? "", "aria-pressed": String(chosen),
    onclick: () => select(item.id), ondblclick: fitObject,
  }, chip(item.motion === "reject" ? "x" : String(item.motion), colourOfMotion(item.motion)),
  element("span", { className: "name" }, item.name), faint(item.kind));
}

function draw() {
  if (!state.doc) return;
  const { clientWidth: width, clientHeight: height } = canvas;
  resize(canvas, width, height);
  begin(canvas);
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
  const every = Math.max(1, Math.ceil(28 / column));
  for (let frame = 0; frame < state.clip.n_frames; frame++) {
    if (frame % every && frame !== state.frame) continue;
    context.fillStyle = frame === state.frame ? "#ffffff" : "#a9b1bf";
    context.fillText(String(frame), (frame + 0.5) * column, 17);
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
    if (key) drawKey(left + column / 2, middle, visibility === "visible", colour);
  }
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

canvas.addEventListener("pointerdown", click);
canvas.addEventListener("pointermove", (event) => event.buttons & 1 && click(event));
list.addEventListener("scroll", () => set({ scrolled: list.scrollTop }));
on(["doc", "selected", "clip"], drawList);
on(["doc", "frame", "selected", "clip", "regions", "scrolled", "resized"], draw);
