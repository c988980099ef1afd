// Mouse, pen and touch on the stage.

import * as actions from "./actions.js";
import { insertPoint, replacePoint, setKey, shift } from "./annotation.js";
import { byId } from "./dom.js";
import { distance, nearestEdge, nearestVertex } from "./geometry.js";
import { cancel, edit, preview, select, selectedObject, set, state } from "./state.js";
import { pan, toImage, toScreen, zoom } from "./view.js";

const REACH = 8;
const FREEHAND = 4;

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
  const { screen, point } = at(event);
  if (event.button === 1) drag = { kind: "pan", from: screen };
  else if (event.button === 2) removeVertex(point);
  else if (state.pending) drag = { kind: "draw", from: screen, point };
  else drag = grab(point, screen);
  stage.classList.toggle("panning", drag?.kind === "pan");
}

/** What is under the pointer: a point, an edge or the inside of the selected region, or nothing. */
function grab(point, screen) {
  const reach = REACH / state.view.scale;
  const item = state.hidden ? null : selectedObject();
  const region = item && actions.regionHere();
  if (item) {
    const vertex = nearestVertex(point, region.polygons, reach);
    if (vertex) {
      set({ vertex: { part: vertex.part, index: vertex.index } });
      return { ...vertex, ...region, kind: "vertex", id: item.id };
    }
    const edge = nearestEdge(point, region.polygons, reach * 0.7);
    if (edge) {
      const polygons = insertPoint(region.polygons, edge.part, edge.index, edge.point);
      return { ...edge, ...region, kind: "vertex", id: item.id, polygons };
    }
  }
  const under = state.hidden ? null : actions.objectUnder(point);
  if (under && under.id === state.selected) return { ...region, kind: "region", id: item.id, from: point };
  return { kind: "pan", from: screen, under };
}

function move(event) {
  if (!state.view) return;
  const { screen, point } = at(event);
  if (!drag) hover(point);
  else if (drag.kind === "pan") panTo(screen);
  else if (drag.kind === "draw") drawFreehand(screen, point);
  else reshape(point);
}

function hover(pointer) {
  if (state.pending) set({ pointer });
  else set({ pointer, hovered: state.doc ? actions.objectUnder(pointer)?.id ?? null : null });
}

function panTo(screen) {
  const [dx, dy] = [screen[0] - drag.from[0], screen[1] - drag.from[1]];
  if (!drag.moved && Math.hypot(dx, dy) < FREEHAND) return;
  drag.moved = true;
  drag.from = screen;
  pan(dx, dy);
}

function drawFreehand(screen, point) {
  if (distance(screen, drag.from) < FREEHAND) return;
  if (!drag.moved) {
    drag.moved = true;
    set({ pending: { ...state.pending, freehand: true } });
    actions.addPoint(drag.point);
  }
  drag.from = screen;
  actions.addPoint(point);
}

function reshape(point) {
  const { kind, part, index, from } = drag;
  drag.moved = true;
  const polygons = kind === "vertex"
    ? replacePoint(drag.polygons, part, index, point)
    : shift(drag.polygons, point[0] - from[0], point[1] - from[1]);
  const visibility = drag.visibility === "occluded" ? "occluded" : "visible";
  preview(setKey(state.doc, drag.id, state.frame, polygons, visibility));
  if (kind === "vertex") set({ vertex: { part, index } });
}

function up(event) {
  const ended = drag;
  release();
  if (!ended) return;
  if (ended.kind === "draw") endDraw(ended, at(event).point);
  else if (ended.kind === "pan") {
    if (!ended.moved) select(ended.under?.id ?? null);
  } else if (ended.moved) edit(state.doc);
  else if (ended.kind === "region") set({ vertex: null });
}

function endDraw({ moved }, point) {
  const { points } = state.pending;
  if (moved) {
    if (points.length > 8) actions.finish();
    return;
  }
  const closing = points.length >= 3 && distance(toScreen(points[0]), toScreen(point)) < REACH;
  if (closing) actions.finish();
  else actions.addPoint(point);
}

function doubleClick(event) {
  if (state.pending) {
    if (state.pending.points.length >= 3) actions.finish();
    return;
  }
  if (!selectedObject()) return;
  const { point } = at(event);
  const { polygons } = actions.regionHere();
  const edge = nearestEdge(point, polygons, REACH / state.view.scale);
  if (edge && !nearestVertex(point, polygons, 2 / state.view.scale)) {
    actions.draw(insertPoint(polygons, edge.part, edge.index, edge.point));
  }
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
  if (event.shiftKey) pan(-event.deltaY, 0);
  else zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)), at(event).screen);
}

function release() {
  drag = null;
  stage.classList.remove("panning");
}

stage.addEventListener("pointerdown", down);
stage.addEventListener("pointermove", move);
stage.addEventListener("pointerup", up);
stage.addEventListener("pointercancel", () => (release(), cancel()));
stage.addEventListener("dblclick", doubleClick);
stage.addEventListener("contextmenu", (event) => event.preventDefault());
stage.addEventListener("wheel", wheel, { passive: false });
