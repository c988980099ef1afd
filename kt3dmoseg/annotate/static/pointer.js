// Mouse, pen and touch on the stage. What is being dragged is an object with `move` and `up`.

import * as actions from "./actions.js";
import { clamp, distance, middle, nearestEdge, nearestVertex, rounded, setKey, shift, splice } from "./annotation.js";
import { byId } from "./dom.js";
import { cancel, edit, editable, preview, select, selectedObject, set, state } from "./state.js";
import { pan, stop, toImage, toScreen, zoom } from "./view.js";

const REACH = 8;
const FREEHAND = 4;
// How near to its first point a click closes an outline.
const CLOSE = 5;
// Dragged less, a press is a click.
const STILL = 2;
// Pixels of a line of a wheel; the most that one notch counts while zooming; zoom for a pixel of pinching.
const LINE = 16;
const NOTCH = 25;
const PINCH = 0.01;

const stage = byId("stage");
let drag = null;

/** Whether something is being dragged, drawn or painted. */
export const isDragging = () => drag !== null;
addEventListener("keydown", ({ key }) => key === "Escape" && (drag = null), true); // what it did so far is taken back

/** Where an event is, on the screen and on the image. */
export function at(event) {
  const box = stage.getBoundingClientRect();
  const screen = [event.clientX - box.left, event.clientY - box.top];
  return { screen, point: toImage(screen) };
}

/** A point near the border of the frame, or outside, is on it. */
const snapped = (point) => point.map((value, axis) => {
  const [reach, last] = [REACH / state.view.scale, state.clip.image_size[axis] - 0.5];
  return value < reach - 0.5 ? -0.5 : value > last - reach ? last : value;
});

function down(event) {
  if (!state.view || event.target.closest(".strip")) return;
  stop(); // what is drawn is of the frame in view
  set({ keyboard: false, cross: null });
  stage.focus({ preventScroll: true });
  stage.setPointerCapture(event.pointerId);
  if (pinch(event)) return;
  const { screen, point } = at(event);
  if (event.button === 2) return; // the menu, or removing a point
  if (event.button === 1) drag = panning(screen);
  else if (state.tool === "click") drag = boxing(screen, point, !event.altKey);
  else if (state.tool === "brush") drag = painting(point, (state.pending.mode === "add") !== event.altKey);
  else drag = state.pending ? drawing(screen, point) : grab(point, screen);
}

/** What is under the pointer: a point, an edge or the inside of the selected region, or nothing. */
function grab(point, screen) {
  const reach = REACH / state.view.scale;
  const own = selectedObject();
  const item = state.hidden || !own || state.unseen.has(own.id) || state.locked.has(own.id) ? null : own;
  const { polygons, visibility } = item ? actions.regionHere() : { polygons: [] };
  const reshaping = (...change) => reshape(item, visibility === "occluded" ? visibility : "visible", screen, ...change);
  const vertex = nearestVertex(point, polygons, reach);
  if (vertex) {
    set({ vertex });
    return reshaping(vertex, (to) => splice(polygons, vertex, 1, snapped(to)));
  }
  const edge = nearestEdge(point, polygons, reach * 0.7);
  if (edge) return reshaping(edge, (to) => splice(polygons, edge, 0, snapped(to)));
  const under = state.hidden ? null : actions.objectUnder(point);
  if (!under || under !== item) return panning(screen, () => select(under?.id ?? null));
  set({ vertex: null });
  return reshaping(null, (to) => shift(polygons, to[0] - point[0], to[1] - point[1]));
}

/** Drag a region, or a point of it; `change` makes its polygons from where the pointer is. */
const reshape = (item, visibility, from, vertex, change) => ({
  move(screen, point) {
    if (!state.dragging && distance(screen, from) < STILL) return;
    preview(setKey(state.doc, item.id, state.frame, change(point).map(rounded), visibility));
    set({ vertex });
  },
  up: () => state.dragging && edit(state.doc),
});

/** Pan, or do something else at a click that does not move. */
function panning(from, click = () => select(null)) {
  let moved = false;
  stage.style.cursor = "grabbing";
  return {
    move(screen) {
      if (!moved && distance(screen, from) < FREEHAND) return;
      pan(screen[0] - from[0], screen[1] - from[1]);
      moved = true;
      from = screen;
    },
    up: () => moved || click(),
  };
}

/** A click, or a box around what moves. */
function boxing(from, start, adds) {
  let box = null;
  return {
    move(screen, to) {
      if (!box && distance(screen, from) < FREEHAND) return;
      const { clip: { image_size: [width, height] } } = state;
      const [xs, ys] = [[0, width - 1], [1, height - 1]].map(([axis, last]) =>
        [start[axis], to[axis]].map((place) => clamp(place, 0, last)).sort((a, b) => a - b));
      box = [xs[0], ys[0], xs[1], ys[1]];
      const points = [[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]].map(([x, y]) => [xs[x], ys[y]]);
      set({ pending: { ...state.pending, points, freehand: true } });
    },
    up() {
      set({ pending: { ...state.pending, points: [], freehand: false } });
      if (box) actions.outlineBox(box);
      else actions.click(start, adds);
    },
  };
}

/** Paint with a disc; the line is shown until the outline is there. */
function painting(start, adds) {
  const stroke = [start];
  const show = (points) => set({ pending: { ...state.pending, points, freehand: true } });
  show(stroke);
  return {
    move(_, point) {
      if (distance(stroke.at(-1), point) < state.brush / 4) return;
      stroke.push(point);
      show([...stroke]);
    },
    up: () => actions.paint(stroke, adds).then(() => state.tool === "brush" && show([])),
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
        actions.addPoint(snapped(start));
      }
      moved = true;
      from = screen;
      actions.addPoint(snapped(point));
    },
    up(point) {
      const { points } = state.pending;
      const closing = points.length >= 3 && distance(toScreen(points[0]), toScreen(point)) < CLOSE;
      if (moved ? points.length > 8 : closing) actions.finish();
      else if (!moved) actions.addPoint(snapped(point));
    },
  };
}

function move(event) {
  if (!state.view || (fingers.has(event.pointerId) && pinch(event))) return;
  const { screen, point } = at(event);
  if (drag) return drag.move(screen, point);
  const hovered = state.doc && !state.pending ? actions.objectUnder(point)?.id ?? null : state.hovered;
  set({ pointer: point, hovered });
}

function up(event) {
  const ended = drag;
  release(event);
  ended?.up(at(event).point);
}

function release(event) {
  fingers.delete(event.pointerId);
  drag = null;
  stage.style.cursor = "";
}

function doubleClick(event) {
  const { pending, tool } = state;
  if (pending) return ["draw", "lasso"].includes(tool) && pending.points.length >= 3 && actions.finish();
  if (!editable()) return undefined;
  const { point } = at(event);
  const { polygons } = actions.regionHere();
  const edge = nearestEdge(point, polygons, REACH / state.view.scale);
  const onPoint = nearestVertex(point, polygons, 2 / state.view.scale);
  return edge && !onPoint && actions.draw(splice(polygons, edge, 0, edge.point));
}

/** The right button takes back a point while drawing, deletes one under it, and else opens the menu. */
function removeVertex(event) {
  if (!state.view) return;
  const shown = !state.hidden && !state.unseen.has(state.selected);
  const found = selectedObject() && shown && !state.pending && event.pointerType !== ""
    && nearestVertex(at(event).point, actions.regionHere().polygons, REACH / state.view.scale);
  if (found) actions.deleteVertex(found);
  else if (state.pending) actions.takeBackPoint();
  else return;
  event.preventDefault();
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
    drag = null;
    cancel();
  }
  if (before.length > 1 && event.type === "pointermove") {
    const [from, to] = [middle(...before), middle(...now)];
    pan(to[0] - from[0], to[1] - from[1]);
    zoom(distance(now[0], now[1]) / Math.max(1, distance(before[0], before[1])), to);
  }
  return true;
}

Object.assign(stage, {
  onpointerdown: down,
  onpointermove: move,
  onpointerup: up,
  onpointercancel: (event) => (release(event), cancel()),
  ondblclick: doubleClick,
  oncontextmenu: removeVertex,
});
stage.addEventListener("wheel", wheel, { passive: false });
