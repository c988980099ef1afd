// Everything a person can do, by key, button or pointer: edits here, the rest in navigation.js. Each is a
// function of the app.

import * as edits from "./edits.js";
import { distance, inside, rounded, simplify } from "./geometry.js";
import { goTo } from "./navigation.js";
import { editableRegion, regionOf } from "./region.js";
import { chosen, say, selectedObject } from "./selection.js";

export * from "./navigation.js";
export { say, selectedObject } from "./selection.js";

const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

/** The selected object's region here, ready to be edited. */
export const regionHere = (app) => editableRegion(app.state, selectedObject(app), app.state.frame);

// Objects

export function select(app, id) {
  if (id !== app.state.selected) app.state.set({ selected: id, vertex: null });
}

export function cycleObject(app, by) {
  const ids = app.state.doc.objects.map((item) => item.id);
  if (!ids.length) return say(app, "No objects yet: press N and click around one");
  const at = ids.indexOf(app.state.selected);
  select(app, ids[(at + by + ids.length + (at < 0 && by < 0 ? 1 : 0)) % ids.length]);
}

export function setTool(app, tool, mode = "object") {
  const pending = tool === "select" ? null : { points: [], mode, freehand: false };
  app.state.set({ tool, pending, lassoed: null, vertex: null, cross: app.keyboard ? app.state.cross : null });
}

export function redraw(app, mode) {
  if (chosen(app)) setTool(app, "draw", mode);
}

/** End the outline being drawn: a new object, the region of one, or a lasso. */
export function finish(app) {
  const { pending, tool, frame } = app.state;
  if (!pending || pending.points.length < 3) {
    say(app, "An outline needs at least three points");
    return;
  }
  const tolerance = pending.freehand ? 0.8 / Math.sqrt(app.state.view.scale) : 0;
  const polygon = rounded(tolerance ? simplify(pending.points, tolerance) : pending.points);
  if (tool === "lasso") return catchTracks(app, polygon);
  const { doc } = app.state;
  let changed;
  let id = app.state.selected;
  if (pending.mode === "object" || !selectedObject(app)) {
    changed = edits.addObject(doc, frame, polygon);
    id = changed.objects.at(-1).id;
  } else {
    const others = pending.mode === "part" ? regionHere(app).polygons : [];
    changed = edits.setKey(doc, id, edits.visible(frame, [...others, polygon]));
  }
  app.history.edit(changed);
  setTool(app, "select");
  app.state.set({ selected: id });
  if (pending.mode === "object") say(app, "Press 1 to 9 for its motion, x to reject; name it on the right");
}

function catchTracks(app, polygon) {
  const { frame } = app.state;
  const rows = app.tracks.rowsWhere(frame, (point) => inside(point, polygon));
  setTool(app, "select");
  app.state.set({ lassoed: { frame, polygon, rows } });
  say(app, `${rows.length} trajectories: press 1 to 9, 0 for background, x to reject, Esc to let go`);
}

export function addPoint(app, point) {
  const { pending } = app.state;
  const last = pending.points.at(-1);
  if (last && distance(last, point) * app.state.view.scale < 2) return;
  app.state.set({ pending: { ...pending, points: [...pending.points, point] } });
}

export function takeBackPoint(app) {
  const { pending } = app.state;
  app.state.set({ pending: { ...pending, points: pending.points.slice(0, -1) } });
}

/** Enter: a point under the cross while drawing, or the end when the cross stands on the last one. */
export function enter(app) {
  const { pending, cross } = app.state;
  if (!pending) {
    if (cross) select(app, objectUnder(app, cross)?.id ?? null);
    return;
  }
  const last = pending.points.at(-1);
  if (cross && !(last && distance(last, cross) < 0.5)) addPoint(app, [...cross]);
  else finish(app);
}

export function escape(app) {
  const { pending, lassoed, vertex, cross } = app.state;
  if (app.state.dragging) app.history.cancel();
  else if (pending) setTool(app, "select");
  else if (lassoed) app.state.set({ lassoed: null });
  else if (vertex) app.state.set({ vertex: null });
  else if (cross) app.state.set({ cross: null });
  else if (app.state.review) app.state.set({ proposals: null, review: null });
  else if (app.state.compared) app.state.set({ compared: null });
  else app.state.set({ selected: null });
}

/** One key, one label: of the lassoed trajectories, else of the selected object. */
export function setMotion(app, motion) {
  const { lassoed, doc } = app.state;
  if (lassoed) {
    app.history.edit(edits.addMark(doc, lassoed.frame, motion, lassoed.polygon));
    app.state.set({ lassoed: null });
    say(app, `${lassoed.rows.length} trajectories marked`);
    return;
  }
  const item = chosen(app);
  if (item && item.motion !== motion) app.history.edit(edits.update(doc, item.id, { motion }));
}

export function removeMarksHere(app) {
  const { doc, frame } = app.state;
  const marks = (doc.marks ?? []).filter((mark) => mark.frame !== frame);
  if (marks.length !== (doc.marks ?? []).length) app.history.edit({ ...doc, marks });
}

export function copyToNext(app) {
  const item = chosen(app);
  const { frame, clip, doc, regions } = app.state;
  if (!item || frame + 1 >= clip.n_frames) return;
  if (!regions) say(app, "No trajectories yet: copied without motion");
  const region = editableRegion(app.state, item, frame + 1);
  if (region.visibility !== "visible" || !region.polygons.length) return say(app, "It is not visible there");
  if (!region.key) app.history.edit(edits.setKey(doc, item.id, edits.visible(frame + 1, region.polygons)));
  goTo(app, frame + 1);
}

export function setVisibility(app, visibility) {
  const item = chosen(app);
  if (!item) return;
  const { doc, frame } = app.state;
  const region = regionHere(app);
  let polygons = region.polygons;
  if (!polygons.length) polygons = nearestPolygons(item, frame);
  if (visibility === "visible" && !polygons.length) return say(app, "Draw it here first: press R");
  const key = { frame, visibility, polygons: visibility === "outside" ? [] : polygons };
  app.history.edit(edits.setKey(doc, item.id, key));
}

export function toggleVisibility(app, visibility) {
  const item = chosen(app);
  if (item) setVisibility(app, regionHere(app).visibility === visibility ? "visible" : visibility);
}

export function enterHere(app) {
  const item = chosen(app);
  if (!item) return;
  const { polygons, visibility } = regionHere(app);
  if (visibility !== "visible") return say(app, "It is not visible here");
  app.history.edit(edits.enterHere(app.state.doc, item.id, app.state.frame, polygons));
}

export function deleteHere(app) {
  const item = chosen(app);
  if (!item) return;
  const { doc, frame, clip } = app.state;
  const after = frame + 1 < clip.n_frames ? regionOf(app.state, item, frame + 1) : null;
  app.history.edit(edits.deleteHere(doc, item.id, frame, after));
  say(app, `${item.name} is not in this frame; Shift+Delete removes it from the whole clip`);
}

export function deleteObject(app) {
  const item = chosen(app);
  if (!item) return;
  app.history.edit(edits.removeObject(app.state.doc, item.id));
  app.state.set({ selected: null, vertex: null });
  say(app, `${item.name} deleted from the whole clip; Ctrl+Z brings it back`);
}

export function forgetKey(app) {
  const item = chosen(app);
  if (!item || !edits.keyAt(item, app.state.frame)) return;
  if (item.key_frames.length === 1) return say(app, "This is its only key frame; Shift+Delete deletes the object");
  app.history.edit(edits.removeKey(app.state.doc, item.id, app.state.frame));
}

function nearestPolygons(item, frame) {
  const drawn = item.key_frames.filter((key) => key.polygons?.length);
  drawn.sort((a, b) => Math.abs(a.frame - frame) - Math.abs(b.frame - frame));
  return drawn[0]?.polygons ?? [];
}

export function objectUnder(app, point) {
  const { doc, frame } = app.state;
  return [...doc.objects].reverse().find((item) => {
    const region = regionOf(app.state, item, frame);
    return region.visibility !== "outside" && region.polygons.some((polygon) => inside(point, polygon));
  });
}

// Points

export function cycleVertex(app, by) {
  if (!chosen(app)) return;
  const { polygons } = regionHere(app);
  const all = polygons.flatMap((polygon, part) => polygon.map((_, index) => ({ part, index })));
  if (!all.length) return;
  const { vertex } = app.state;
  const at = vertex ? all.findIndex((v) => v.part === vertex.part && v.index === vertex.index) : by > 0 ? -1 : 0;
  app.state.set({ vertex: all[(at + by + all.length) % all.length], cross: null });
}

/** Move the selected point, or else the keyboard's cross, by whole pixels. */
export function nudge(app, dx, dy) {
  const { vertex, doc, frame, cross } = app.state;
  const item = selectedObject(app);
  if (vertex && item) {
    const { polygons } = regionHere(app);
    const [x, y] = polygons[vertex.part][vertex.index];
    const moved = edits.replacePoint(polygons, vertex.part, vertex.index, [x + dx, y + dy]);
    app.history.edit(edits.setKey(doc, item.id, edits.visible(frame, moved)));
    return;
  }
  app.keyboard = true;
  const [width, height] = app.state.clip.image_size;
  const [x, y] = cross ?? app.middle().map(Math.round);
  app.state.set({ cross: cross ? [clamp(x + dx, 0, width - 1), clamp(y + dy, 0, height - 1)] : [x, y] });
}

export function insertVertex(app) {
  const { vertex, doc, frame } = app.state;
  const item = chosen(app);
  if (!item || !vertex) return say(app, "Choose a point first: press V");
  const { polygons } = regionHere(app);
  const polygon = polygons[vertex.part];
  const [a, b] = [polygon[vertex.index], polygon[(vertex.index + 1) % polygon.length]];
  const middle = [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];
  const changed = edits.insertPoint(polygons, vertex.part, vertex.index + 1, middle);
  app.history.edit(edits.setKey(doc, item.id, edits.visible(frame, rounded2(changed))));
  app.state.set({ vertex: { part: vertex.part, index: vertex.index + 1 } });
}

export function deleteVertex(app, which = app.state.vertex) {
  const item = chosen(app);
  if (!item || !which) return say(app, "Choose a point first: press V");
  const changed = edits.removePoint(regionHere(app).polygons, which.part, which.index);
  if (!changed.length) return say(app, "An outline needs three points; Delete takes the object out of this frame");
  app.history.edit(edits.setKey(app.state.doc, item.id, edits.visible(app.state.frame, changed)));
  app.state.set({ vertex: null });
}

const rounded2 = (polygons) => polygons.map(rounded);
