// Mouse, pen and touch on the stage. What is being dragged is an object with `move` and `up`.

import * as actions from "./actions.js";
import { insertPoint, replacePoint, setKey, shift } from "./annotation.js";
import { byId } from "./dom.js";
import { clamp, distance, nearestEdge, nearestVertex } from "./geometry.js";
import { cancel, edit, editable, preview, select, selectedObject, set, state } from "./state.js";
import { pan, toImage, toScreen, zoom } from "./view.js";

const REACH = 8;
const FREEHAND = 4;
// Pixels of a line of a wheel; the most that one notch counts while zooming; zoom for a pixel of pinching.
const LINE = 16;
const NOTCH = 25;
const PINCH = 0.01;

const stage = byId("stage");
let drag = null;

/** Where an event is, on the screen and on the image. */
function at(event) {
  const box = stage.getBoundingClientRect();
  const screen = [event.clientX - box.left, event.clientY - box.top];
  return { screen, point: toImage(screen) };
}

function down(event) {
  if (!state.view || event.target.closest(".strip")) return;
  set({ keyboard: false, cross: null });
  stage.focus({ preventScroll: true });
  stage.setPointerCapture(event.pointerId);
  if (pinch(event)) return;
  const { screen, point } = at(event);
  if (event.button === 1) drag = panning(screen);
  else if (event.button === 2) removeVertex(point);
  else if (state.pending) drag = drawing(screen, point);
  else drag = grab(point, screen);
}

/** What is under the pointer: a point, an edge or the inside of the selected region, or nothing. */
function grab(point, screen) {
  const reach = REACH / state.view.scale;
  const own = selectedObject();
  const item = state.hidden || !own || state.unseen.has(own.id) || state.locked.has(own.id) ? null : own;
  const region = item && actions.regionHere();
  const vertex = item && nearestVertex(point, region.polygons, reach);
  if (vertex) {
    set({ vertex: { part: vertex.part, index: vertex.index } });
    return movingVertex(item, region, vertex);
  }
  const edge = item && nearestEdge(point, region.polygons, reach * 0.7);
  if (edge) return movingVertex(item, { ...region, polygons: withPoint(region, edge) }, edge);
  const under = state.hidden ? null : actions.objectUnder(point);
  return under && under === item ? movingRegion(item, region, point) : panning(screen, under);
}

const withPoint = ({ polygons }, { part, index, point }) => insertPoint(polygons, part, index, point);

function reshape(item, region, polygons) {
  const visibility = region.visibility === "occluded" ? "occluded" : "visible";
  preview(setKey(state.doc, item.id, state.frame, polygons, visibility));
}

function movingVertex(item, region, { part, index }) {
  return {
    move(_, point) {
      reshape(item, region, replacePoint(region.polygons, part, index, point));
      set({ vertex: { part, index } });
    },
    up: () => state.dragging && edit(state.doc),
  };
}

function movingRegion(item, region, from) {
  return {
    move: (_, point) => reshape(item, region, shift(region.polygons, point[0] - from[0], point[1] - from[1])),
    up: () => (state.dragging ? edit(state.doc) : set({ vertex: null })),
  };
}

/** Pan; a click that does not move selects what is under it. */
function panning(from, under) {
  let moved = false;
  stage.classList.add("panning");
  return {
    move(screen) {
      if (!moved && distance(screen, from) < FREEHAND) return;
      pan(screen[0] - from[0], screen[1] - from[1]);
      moved = true;
      from = screen;
    },
    up: () => moved || select(under?.id ?? null),
  };
}

/** Draw freehand; a click that does not move adds a point, or closes the outline on its first. */
function drawing(from, start) {
  let moved = false;
  return {
    move(screen, point) {
      if (distance(screen, from) < FREEHAND) return;
      if (!moved) {
        set({ pending: { ...state.pending, freehand: true } });
        actions.addPoint(start);
      }
      moved = true;
      from = screen;
      actions.addPoint(point);
    },
    up(point) {
      const { points } = state.pending;
      const closing = points.length >= 3 && distance(toScreen(points[0]), toScreen(point)) < REACH;
      if (moved ? points.length > 8 : closing) actions.finish();
      else if (!moved) actions.addPoint(point);
    },
  };
}

function move(event) {
  if (!state.view || (fingers.has(event.pointerId) && pinch(event))) return;
  const { screen, point } = at(event);
  if (drag) drag.move(screen, point);
  else if (state.pending) set({ pointer: point });
  else set({ pointer: point, hovered: state.doc ? actions.objectUnder(point)?.id ?? null : null });
}

function up(event) {
  fingers.delete(event.pointerId);
  const ended = drag;
  release();
  ended?.up(at(event).point);
}

function doubleClick(event) {
  if (state.pending) {
    if (state.pending.points.length >= 3) actions.finish();
    return;
  }
  if (!editable()) return;
  const { point } = at(event);
  const region = actions.regionHere();
  const edge = nearestEdge(point, region.polygons, REACH / state.view.scale);
  if (edge && !nearestVertex(point, region.polygons, 2 / state.view.scale)) actions.draw(withPoint(region, edge));
}

function removeVertex(point) {
  if (state.pending) return actions.takeBackPoint();
  if (!selectedObject()) return undefined;
  const found = nearestVertex(point, actions.regionHere().polygons, REACH / state.view.scale);
  return found && actions.deleteVertex(found);
}

function wheel(event) {
  event.preventDefault();
  if (!state.view) return;
  const unit = [1, LINE, stage.clientHeight][event.deltaMode];
  const [dx, dy] = [event.deltaX * unit, event.deltaY * unit];
  // Browsers report a pinch on a trackpad as many small turns of the wheel with Ctrl.
  if (event.ctrlKey || event.metaKey) zoom(Math.exp(-clamp(dy, -NOTCH, NOTCH) * PINCH), at(event).screen);
  else if (event.shiftKey && !dx) pan(-dy, 0);
  else pan(-dx, -dy);
}

// Two fingers: their middle pans, their distance zooms.
const fingers = new Map();

/** Keep where a finger is; true while two or more are down, which draw and drag nothing. */
function pinch(event) {
  if (event.pointerType !== "touch") return false;
  const before = [...fingers.values()];
  fingers.set(event.pointerId, at(event).screen);
  const now = [...fingers.values()];
  if (now.length < 2) return false;
  if (drag) {
    if (state.pending?.freehand) set({ pending: { ...state.pending, points: [], freehand: false } });
    release();
    cancel();
  }
  if (before.length > 1 && event.type === "pointermove") {
    const [from, to] = [centre(before), centre(now)];
    pan(to[0] - from[0], to[1] - from[1]);
    zoom(distance(now[0], now[1]) / Math.max(1, distance(before[0], before[1])), to);
  }
  return true;
}

const centre = ([a, b]) => [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];

function release() {
  drag = null;
  stage.classList.remove("panning");
}

stage.addEventListener("pointerdown", down);
stage.addEventListener("pointermove", move);
stage.addEventListener("pointerup", up);
stage.addEventListener("pointercancel", (event) => (fingers.delete(event.pointerId), release(), cancel()));
stage.addEventListener("dblclick", doubleClick);
stage.addEventListener("contextmenu", (event) => event.preventDefault());
stage.addEventListener("wheel", wheel, { passive: false });
