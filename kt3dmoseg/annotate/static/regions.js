// Regions, handles, the outline being drawn, the lasso and the keyboard's cross.

import { clicksHere, editableRegion } from "./actions.js";
import { boundsOf } from "./annotation.js";
import { PROBLEM, begin, byId, colourOfMotion, hatch, signOf } from "./dom.js";
import { on, regionOf, state } from "./state.js";
import { toScreen } from "./view.js";

const WHITE = "#ffffff";
const DARK = "#101216";

const canvas = byId("regions");
let context = null;

export function drawRegions() {
  context = begin(canvas);
  const { doc, view, compared, pending, lassoed, cross } = state;
  if (!doc || !view) return;
  const frame = state.flickered ?? state.frame;
  if (!state.hidden) {
    const shown = doc.objects.filter((item) => !state.unseen.has(item.id)).map((item) => ({ item, ...regionOf(item, frame) }));
    shown.forEach((one) => drawObject(one, frame, shown));
    drawOverlaps(shown);
    const marks = (doc.marks ?? []).filter((mark) => mark.frame === frame);
    marks.forEach((mark) => outline(mark.polygon, colourOfMotion(mark.motion), [2, 3]));
    state.proposals?.forEach((item) => drawProposal(item, frame));
    const theirs = compared && compared.at !== null ? compared.theirs : [];
    theirs.forEach((item) => drawOther(item, compared.regions[item.id][frame]));
  }
  if (pending) drawPending(pending);
  if (state.tool === "click") for (const [x, y, adds] of clicksHere()) square(toScreen([x, y]), 3, adds ? WHITE : DARK);
  if (lassoed?.frame === frame) outline(lassoed.polygon, WHITE, [4, 3]);
  if (cross) drawCross(toScreen(cross));
}

function drawObject(one, frame, shown) {
  const { item, visibility, polygons, key } = one;
  if (visibility === "outside") return;
  const chosen = item.id === state.selected;
  const colour = colourOfMotion(item.motion);
  const hidden = visibility === "occluded";
  context.save();
  cutOut(one, shown);
  for (const polygon of polygons) {
    const path = outline(polygon, colour, hidden ? [1.5, 6] : key ? [] : [10, 3], chosen ? 2.5 : 1.5);
    context.globalAlpha = state.opacity * (hidden ? 0 : chosen ? 0.16 : item.id === state.hovered ? 0.14 : 0.07);
    context.fillStyle = colour;
    context.fill(path, "evenodd");
    context.globalAlpha = 1;
  }
  context.restore();
  if (chosen && !state.pending && !state.locked.has(item.id)) drawHandles(editableRegion(item, frame), colour);
  drawName(`${signOf(item.motion)} ${item.name}${hidden ? " (occluded)" : ""}`, polygons, colour, chosen);
}

/** The layer of an object that is seen: static things are in front of what moves, rejected ones in front of all. */
const layer = ({ visibility, item: { motion } }) =>
  (visibility !== "visible" ? -1 : motion === "reject" ? 2 : motion ? 0 : 1);

/** Draw nothing more where something is in front of an object. */
function cutOut(one, shown) {
  const front = shown.filter((other) => layer(other) > Math.max(0, layer(one)));
  for (const polygon of front.flatMap(({ polygons }) => polygons)) {
    const path = pathOf(polygon);
    path.rect(0, 0, canvas.clientWidth, canvas.clientHeight);
    context.clip(path, "evenodd");
  }
}

/** Hatch what two motions both claim: no trajectory there gets a label. */
function drawOverlaps(shown) {
  const moving = shown.filter((one) => layer(one) === 0);
  context.fillStyle = hatch(context, PROBLEM);
  moving.forEach((one, k) => one.polygons.forEach((polygon) => {
    context.save();
    cutOut(one, shown);
    context.clip(pathOf(polygon), "evenodd");
    const others = moving.slice(0, k).filter(({ item }) => item.motion !== one.item.motion);
    for (const theirs of others.flatMap(({ polygons }) => polygons)) context.fill(pathOf(theirs), "evenodd");
    context.restore();
  }));
}

function drawProposal(item, frame) {
  const { polygons } = regionOf(item, frame, null);
  const asked = state.review?.item === item;
  context.globalAlpha = asked ? 1 : 0.4;
  for (const polygon of polygons) outline(polygon, WHITE, asked ? [8, 3] : [2, 4], asked ? 2.5 : 1);
  if (asked) drawName(`? ${item.name}`, polygons, WHITE, true);
  context.globalAlpha = 1;
}

/** A region of the other annotator, while differences are looked at. */
function drawOther(item, { polygons }) {
  for (const polygon of polygons) outline(polygon, WHITE, [3, 4]);
  drawName(`${signOf(item.motion)} ${item.name} (other)`, polygons, WHITE, false, 1);
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

function drawName(text, polygons, colour, chosen, row = 0) {
  const box = boundsOf(polygons);
  if (!box) return;
  const [left, top] = toScreen(box);
  const [right, bottom] = toScreen(box.slice(2));
  const { clientWidth, clientHeight } = canvas;
  if (right < 0 || bottom < 0 || left > clientWidth || top > clientHeight) return;
  context.font = `${chosen ? "600" : "400"} 12px system-ui, sans-serif`;
  const { width } = context.measureText(text);
  const [x, y] = [Math.min(Math.max(2, left), clientWidth - width - 4), Math.max(15, top - 5 - 16 * row)];
  context.fillStyle = `${DARK}c8`;
  context.fillRect(x - 2, y - 11, width + 5, 15);
  context.fillStyle = colour;
  context.fillText(text, x, y);
}

function stroke(path, colour, width) {
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.stroke(path);
}

function pathOf(points) {
  const path = new Path2D();
  points.forEach((point) => path.lineTo(...toScreen(point)));
  return path;
}

function outline(polygon, colour, dash, width = 1.5) {
  const path = pathOf(polygon);
  path.closePath();
  context.setLineDash(dash);
  context.lineJoin = "round";
  stroke(path, "#000a", width + 1.5);
  stroke(path, colour, width);
  context.setLineDash([]);
  return path;
}

function drawPending({ points, freehand }) {
  if (state.tool === "brush") return drawBrush(points);
  const end = state.cross ?? state.pointer;
  stroke(pathOf(end && !freehand ? [...points, end] : points), WHITE, 1.5);
  points.forEach((point, i) => {
    if (!freehand || !i) square(toScreen(point), i ? 2.5 : 4.5, WHITE);
  });
}

/** The line that the brush painted, and its disc where it is. */
function drawBrush(points) {
  const radius = state.brush * state.view.scale;
  context.globalAlpha = 0.4;
  context.lineCap = "round";
  if (points.length) stroke(pathOf([...points, points.at(-1)]), WHITE, 2 * radius);
  context.globalAlpha = 1;
  const at = state.cross ?? state.pointer;
  if (!at) return;
  const disc = new Path2D();
  disc.arc(...toScreen(at), radius, 0, 2 * Math.PI);
  stroke(disc, DARK, 3);
  stroke(disc, WHITE, 1.5);
}

function drawCross([x, y]) {
  stroke(new Path2D(`M${x - 16} ${y}h12m8 0h12M${x} ${y - 16}v12m0 8v12`), WHITE, 1);
}

on(["frame", "view", "doc", "regions", "selected", "vertex", "pending", "pointer", "cross", "lassoed", "hidden",
  "flickered", "hovered", "tool", "brush", "unseen", "locked", "opacity", "proposals", "review", "compared"], drawRegions);
