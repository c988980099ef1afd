// Regions, handles, the outline being drawn, the lasso and the keyboard's cross.

import { editableRegion, regionOf } from "./actions.js";
import { regionIn } from "./annotation.js";
import { begin, byId, colourOfMotion } from "./dom.js";
import { boundsOf } from "./geometry.js";
import { on, state } from "./state.js";
import { toScreen } from "./view.js";

const WHITE = "#ffffff";
const DARK = "#101216";

const canvas = byId("regions");
let context = null;

export function drawRegions() {
  context = begin(canvas);
  if (!state.doc || !state.view) return;
  const frame = state.flickered ?? state.frame;
  if (!state.hidden) {
    for (const item of state.doc.objects) if (!state.unseen.has(item.id)) drawObject(item, frame);
    for (const mark of state.doc.marks ?? []) {
      if (mark.frame === frame) outline(mark.polygon, colourOfMotion(mark.motion), [2, 3]);
    }
    for (const item of state.proposals ?? []) drawProposal(item, frame);
    if (state.compared && state.compared.at !== null) drawOther(state.compared, frame);
  }
  if (state.pending) drawPending(state.pending);
  if (state.lassoed?.frame === frame) outline(state.lassoed.polygon, WHITE, [4, 3]);
  if (state.cross) drawCross(state.cross);
}

function drawObject(item, frame) {
  const region = regionOf(item, frame);
  if (region.visibility === "outside") return;
  const chosen = item.id === state.selected;
  const colour = colourOfMotion(item.motion);
  const dash = region.visibility === "occluded" ? [6, 5] : region.key ? [] : [10, 3];
  for (const polygon of region.polygons) {
    outline(polygon, colour, dash, chosen ? 2.5 : 1.5);
    context.globalAlpha = state.opacity * (chosen ? 0.16 : item.id === state.hovered ? 0.14 : 0.07);
    context.fillStyle = colour;
    context.fill();
    context.globalAlpha = 1;
  }
  if (chosen && !state.pending && !state.locked.has(item.id)) drawHandles(editableRegion(item, frame), colour);
  drawName(item, region, colour, chosen);
}

function drawProposal(item, frame) {
  const region = regionIn(item, frame);
  const asked = state.review?.item === item;
  context.globalAlpha = asked ? 1 : 0.4;
  for (const polygon of region.polygons) outline(polygon, WHITE, asked ? [8, 3] : [2, 4], asked ? 2.5 : 1);
  if (asked) drawName({ ...item, motion: "?" }, region, WHITE, true);
  context.globalAlpha = 1;
}

/** The other annotator's regions, while differences are looked at. */
function drawOther(compared, frame) {
  for (const item of compared.theirs) {
    const region = compared.regions[item.id][frame];
    for (const polygon of region.polygons) outline(polygon, WHITE, [3, 4]);
    drawName({ ...item, name: `${item.name} (other)` }, region, WHITE, false, 1);
  }
}

function square([x, y], half, colour) {
  context.fillStyle = colour;
  context.fillRect(x - half, y - half, 2 * half, 2 * half);
}

function drawHandles({ polygons }, colour) {
  const { vertex } = state;
  context.strokeStyle = DARK;
  context.lineWidth = 1;
  polygons.forEach((polygon, part) => polygon.forEach((point, index) => {
    const chosen = vertex?.part === part && vertex.index === index;
    const [x, y] = toScreen(point);
    const half = chosen ? 5 : 3;
    square([x, y], half, chosen ? WHITE : colour);
    context.strokeRect(x - half, y - half, 2 * half, 2 * half);
  }));
}

function drawName(item, region, colour, chosen, row = 0) {
  const box = boundsOf(region.polygons);
  if (!box) return;
  const [left, top] = toScreen(box);
  const [right, bottom] = toScreen(box.slice(2));
  const { clientWidth, clientHeight } = canvas;
  if (right < 0 || bottom < 0 || left > clientWidth || top > clientHeight) return;
  const text = `${item.motion === "reject" ? "x" : item.motion} ${item.name}`;
  context.font = `${chosen ? "600" : "400"} 12px system-ui, sans-serif`;
  const { width } = context.measureText(text);
  const [x, y] = [Math.min(Math.max(2, left), clientWidth - width - 4), Math.max(15, top - 5 - 16 * row)];
  context.fillStyle = `${DARK}c8`;
  context.fillRect(x - 2, y - 11, width + 5, 15);
  context.fillStyle = colour;
  context.fillText(text, x, y);
}

function path(points) {
  context.beginPath();
  points.forEach((point, i) => context[i ? "lineTo" : "moveTo"](...toScreen(point)));
}

function stroke(colour, width) {
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.stroke();
}

function outline(polygon, colour, dash, width = 1.5) {
  path(polygon);
  context.closePath();
  context.setLineDash(dash);
  context.lineJoin = "round";
  stroke("#000a", width + 1.5);
  stroke(colour, width);
  context.setLineDash([]);
}

function drawPending({ points, freehand }) {
  const end = state.cross ?? state.pointer;
  path(end && !freehand ? [...points, end] : points);
  stroke(WHITE, 1.5);
  points.forEach((point, i) => {
    if (!freehand || !i) square(toScreen(point), i ? 2.5 : 4.5, WHITE);
  });
}

function drawCross(cross) {
  const [x, y] = toScreen(cross);
  context.beginPath();
  for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
    context.moveTo(x + 4 * dx, y + 4 * dy);
    context.lineTo(x + 16 * dx, y + 16 * dy);
  }
  stroke(WHITE, 1);
}

on(["frame", "view", "doc", "regions", "selected", "vertex", "pending", "pointer", "cross", "lassoed", "hidden",
  "flickered", "hovered", "tool", "unseen", "locked", "opacity", "proposals", "review", "compared"], drawRegions);
