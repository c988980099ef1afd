// What a person can do to the annotation, by key, button or pointer.

import * as annotation from "./annotation.js";
import { clamp, distance, inside, rounded, simplify } from "./geometry.js";
import { cancel, edit, editable, notify, select, selectedObject, set, state } from "./state.js";
import { rowsWhere } from "./tracks.js";
import { goTo, inSight } from "./view.js";

// Blended outlines have more points than anyone should drag.
const TOLERANCE = 0.4;

/** The region of an object in a frame, as it is drawn. */
export const regionOf = (item, frame) => annotation.regionIn(item, frame, state.regions);

/** The same, thinned out where the first edit will make it a key frame. */
export function editableRegion(item, frame) {
  const region = regionOf(item, frame);
  if (region.key) return region;
  return { ...region, polygons: region.polygons.map((polygon) => rounded(simplify(polygon, TOLERANCE))) };
}

/** The selected object's region here, ready to be edited. */
export const regionHere = () => editableRegion(selectedObject(), state.frame);

/** The document with a key frame of the selected object. */
const withKey = (doc, frame, ...region) => annotation.setKey(doc, state.selected, frame, ...region);

/** Make the selected object's region here a key frame. */
export const draw = (polygons, visibility) => edit(withKey(state.doc, state.frame, polygons, visibility));

/** Change an object's properties. */
export function update(item, fields) {
  if (editable()) edit(annotation.update(state.doc, item.id, fields));
}

// Drawing

export function setTool(tool, mode = "object") {
  const pending = tool === "select" ? null : { points: [], mode, freehand: false };
  set({ tool, pending, lassoed: null, vertex: null, cross: state.keyboard ? state.cross : null });
}

export const redraw = (mode) => editable() && setTool("draw", mode);

/** End the outline being drawn: a new object, the region of one, or a lasso. */
export function finish() {
  const { pending, tool, frame } = state;
  if (!pending || pending.points.length < 3) return notify("An outline needs at least three points");
  const tolerance = pending.freehand ? 0.8 / Math.sqrt(state.view.scale) : 0;
  const polygon = rounded(tolerance ? simplify(pending.points, tolerance) : pending.points);
  if (tool === "lasso") return catchTracks(polygon);
  let selected = state.selected;
  if (pending.mode === "object" || !selectedObject()) {
    edit(annotation.addObject(state.doc, { key_frames: [{ frame, visibility: "visible", polygons: [polygon] }] }));
    selected = state.doc.objects.at(-1).id;
  } else draw(pending.mode === "part" ? [...regionHere().polygons, polygon] : [polygon]);
  setTool("select");
  set({ selected });
  if (pending.mode === "object") notify("Press 1 to 9 for its motion, x to reject; name it on the right");
}

function catchTracks(polygon) {
  const { frame } = state;
  const rows = rowsWhere(frame, (point) => inside(point, polygon));
  setTool("select");
  set({ lassoed: { frame, polygon, rows } });
  notify(`${rows.length} trajectories: press 1 to 9, 0 for background, x to reject, Esc to deselect`);
}

export function addPoint(point) {
  const { pending } = state;
  const last = pending.points.at(-1);
  if (last && distance(last, point) * state.view.scale < 2) return;
  set({ pending: { ...pending, points: [...pending.points, point] } });
}

export const takeBackPoint = () => set({ pending: { ...state.pending, points: state.pending.points.slice(0, -1) } });

/** Enter: a point under the cross while drawing, or the end when the cross is on the last one. */
export function enter() {
  const { pending, cross } = state;
  if (!pending) return cross && select(objectUnder(cross)?.id ?? null);
  const last = pending.points.at(-1);
  return cross && !(last && distance(last, cross) < 0.5) ? addPoint([...cross]) : finish();
}

export function escape() {
  if (state.dragging) cancel();
  else if (state.pending) setTool("select");
  else if (state.lassoed) set({ lassoed: null });
  else if (state.vertex) set({ vertex: null });
  else if (state.cross) set({ cross: null });
  else if (state.review) set({ proposals: null, review: null });
  else if (state.compared) set({ compared: null });
  else set({ selected: null });
}

// Objects

export function cycleObject(by) {
  const ids = state.doc.objects.map((item) => item.id);
  if (!ids.length) return notify("No objects yet: press N and click around one");
  const at = ids.indexOf(state.selected);
  select(ids[(at + by + ids.length + (at < 0 && by < 0 ? 1 : 0)) % ids.length]);
}

export function objectUnder(point) {
  return [...state.doc.objects].reverse().find((item) => {
    if (state.unseen.has(item.id) || state.locked.has(item.id)) return false;
    const region = regionOf(item, state.frame);
    return region.visibility !== "outside" && region.polygons.some((polygon) => inside(point, polygon));
  });
}

/** One key, one label: of the lassoed trajectories, else of the selected object. */
export function setMotion(motion) {
  const { lassoed } = state;
  if (lassoed) {
    const mark = { frame: lassoed.frame, motion, polygon: lassoed.polygon };
    edit({ ...state.doc, marks: [...(state.doc.marks ?? []), mark] });
    set({ lassoed: null });
    notify(`${lassoed.rows.length} trajectories marked`);
    return;
  }
  const item = editable();
  if (item && item.motion !== motion) update(item, { motion });
}

export function removeMarksHere() {
  const before = state.doc.marks ?? [];
  const marks = before.filter((mark) => mark.frame !== state.frame);
  if (marks.length !== before.length) edit({ ...state.doc, marks });
}

export function copyToNext() {
  const item = editable();
  const next = state.frame + 1;
  if (!item || next >= state.clip.n_frames) return;
  if (!state.regions) notify("No trajectories yet: copied without motion");
  const region = editableRegion(item, next);
  if (region.visibility !== "visible" || !region.polygons.length) return notify("It is not visible there");
  if (!region.key) edit(withKey(state.doc, next, region.polygons));
  goTo(next);
}

export function setVisibility(visibility) {
  const item = editable();
  if (!item) return;
  let { polygons } = regionHere();
  if (!polygons.length) polygons = nearestPolygons(item);
  if (visibility === "visible" && !polygons.length) return notify("Draw it here first: press R");
  draw(visibility === "outside" ? [] : polygons, visibility);
}

export function toggleVisibility(visibility) {
  if (editable()) setVisibility(regionHere().visibility === visibility ? "visible" : visibility);
}

function nearestPolygons(item) {
  const far = (key) => Math.abs(key.frame - state.frame);
  const drawn = item.key_frames.filter((key) => key.polygons?.length).sort((a, b) => far(a) - far(b));
  return drawn[0]?.polygons ?? [];
}

/** The object enters in this frame: drawn here, outside in the frame before. */
export function enterHere() {
  if (!editable()) return;
  const { doc, frame } = state;
  const { polygons, visibility } = regionHere();
  if (visibility !== "visible") return notify("It is not visible here");
  const drawn = withKey(doc, frame, polygons);
  edit(frame ? withKey(drawn, frame - 1, [], "outside") : drawn);
}

export function deleteHere() {
  const item = editable();
  if (!item) return;
  const { doc, frame, clip } = state;
  // Outside here, and back in the next frame as it is there.
  const after = frame + 1 < clip.n_frames ? regionOf(item, frame + 1) : { visibility: "outside" };
  const back = after.visibility !== "outside" && !after.key;
  edit(withKey(back ? withKey(doc, frame + 1, after.polygons, after.visibility) : doc, frame, [], "outside"));
  notify(`${item.name} is not in this frame; Shift+Delete removes it from the whole clip`);
}

export function deleteObject() {
  const item = editable();
  if (!item) return;
  edit({ ...state.doc, objects: state.doc.objects.filter((other) => other !== item) });
  set({ selected: null, vertex: null });
  notify(`${item.name} deleted from the whole clip; Ctrl+Z restores it`);
}

export function forgetKey() {
  const item = editable();
  if (!item || !annotation.keyAt(item, state.frame)) return;
  if (item.key_frames.length === 1) return notify("This is its only key frame; Shift+Delete deletes the object");
  update(item, { key_frames: item.key_frames.filter((key) => key.frame !== state.frame) });
}

/** Frames that an object was carried to with doubt: [frame, why]. */
export const weakFrames = (item) => [...(state.weak?.[item.id] ?? []).entries()].filter(([, why]) => why);

/** Go to the next of them, of this object or the next one. */
export function nextWeak() {
  const all = state.doc.objects.flatMap((item) => weakFrames(item).map(([frame, why]) => ({ item, frame, why })));
  if (!all.length) return notify("No frame is in doubt");
  const order = state.doc.objects.map((item) => item.id);
  const own = order.indexOf(state.selected);
  const after = all.findIndex(({ item, frame }) =>
    order.indexOf(item.id) > own || (item.id === state.selected && frame > state.frame));
  const { item, frame, why } = all[Math.max(0, after)];
  select(item.id);
  goTo(frame);
  return notify(`${item.name}: ${why} (${Math.max(0, after) + 1} of ${all.length} weak frames)`);
}

// Points

export function cycleVertex(by) {
  if (!editable()) return;
  const all = regionHere().polygons.flatMap((polygon, part) => polygon.map((_, index) => ({ part, index })));
  if (!all.length) return;
  const { vertex } = state;
  const at = vertex ? all.findIndex((v) => v.part === vertex.part && v.index === vertex.index) : by > 0 ? -1 : 0;
  set({ vertex: all[(at + by + all.length) % all.length], cross: null });
}

/** Move the selected point, or else the keyboard's cross, by whole pixels. */
export function nudge(dx, dy) {
  const { vertex, cross } = state;
  if (vertex && selectedObject()) {
    if (!editable()) return undefined;
    const { polygons } = regionHere();
    const [x, y] = polygons[vertex.part][vertex.index];
    return draw(annotation.replacePoint(polygons, vertex.part, vertex.index, [x + dx, y + dy]));
  }
  const [width, height] = state.clip.image_size;
  const [x, y] = cross ? [cross[0] + dx, cross[1] + dy] : inSight().map(Math.round);
  return set({ keyboard: true, cross: [clamp(x, 0, width - 1), clamp(y, 0, height - 1)] });
}

export function insertVertex() {
  const { vertex } = state;
  if (!editable() || !vertex) return notify("Choose a point first: press V");
  const { part, index } = vertex;
  const { polygons } = regionHere();
  const [a, b] = [polygons[part][index], polygons[part][(index + 1) % polygons[part].length]];
  const middle = [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];
  draw(annotation.insertPoint(polygons, part, index + 1, middle).map(rounded));
  set({ vertex: { part, index: index + 1 } });
}

export function deleteVertex(which = state.vertex) {
  if (!editable() || !which) return notify("Choose a point first: press V");
  const changed = annotation.removePoint(regionHere().polygons, which.part, which.index);
  if (!changed.length) return notify("An outline needs three points; Delete takes the object out of this frame");
  draw(changed);
  set({ vertex: null });
}
