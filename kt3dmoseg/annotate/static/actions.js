// Everything a person can do, by key, button or pointer. Each is a function of the app.

import * as edits from "./edits.js";
import { boundsOf, distance, inside, rounded, simplify } from "./geometry.js";
import { editableRegion, regionOf } from "./region.js";
import * as views from "./view.js";

const FRAME_TIME = 110;
const FLICKER_TIME = 220;

const clamp = (value, low, high) => Math.min(high, Math.max(low, value));
export const selectedObject = ({ state }) => state.doc && edits.objectOf(state.doc, state.selected);

/** The selected object's region here, ready to be edited. */
export const regionHere = (app) => editableRegion(app.state, selectedObject(app), app.state.frame);

export function say(app, text) {
  app.state.set({ hint: text });
  clearTimeout(app.hintTimer);
  app.hintTimer = setTimeout(() => app.state.set({ hint: "" }), 4000);
}

function chosen(app) {
  const item = selectedObject(app);
  if (!item) say(app, "Select an object first: click it, or press ]");
  return item;
}

// Frames

export function goTo(app, frame) {
  app.state.set({ frame: clamp(frame, 0, app.state.clip.n_frames - 1), vertex: null, lassoed: null });
}

export const step = (app, by) => goTo(app, app.state.frame + by);

export function play(app) {
  stopTimer(app, "flickerTimer", { flickered: null });
  if (stopTimer(app, "playTimer", { playing: false })) return;
  app.state.set({ playing: true });
  app.playTimer = setInterval(() => goTo(app, (app.state.frame + 1) % app.state.clip.n_frames), FRAME_TIME);
}

export function flicker(app) {
  stopTimer(app, "playTimer", { playing: false });
  if (stopTimer(app, "flickerTimer", { flickered: null })) return;
  const other = () => {
    const { frame, clip, flickered } = app.state;
    const next = frame + 1 < clip.n_frames ? frame + 1 : frame - 1;
    app.state.set({ flickered: flickered === null || flickered === frame ? next : frame });
  };
  other();
  app.flickerTimer = setInterval(other, FLICKER_TIME);
}

function stopTimer(app, name, changes) {
  if (!app[name]) return false;
  clearInterval(app[name]);
  app[name] = null;
  app.state.set(changes);
  return true;
}

export function toKeyFrame(app, direction) {
  const item = chosen(app);
  if (!item) return;
  const frames = item.key_frames.map((key) => key.frame).filter((f) => (f - app.state.frame) * direction > 0);
  if (frames.length) goTo(app, direction > 0 ? Math.min(...frames) : Math.max(...frames));
}

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

// View

export function zoom(app, factor, at = null) {
  const { view, pointer, cross } = app.state;
  const focus = at ?? (cross || pointer ? views.toScreen(view, cross ?? pointer) : app.screenMiddle());
  app.state.set({ view: views.zoomed(view, factor, focus, app.farthest()) });
}

export function pan(app, dx, dy) {
  app.state.set({ view: views.panned(app.state.view, dx, dy) });
}

export function fitAll(app) {
  app.state.set({ view: views.fit(app.state.clip.image_size, app.stage()) });
}

export function fitObject(app) {
  const item = chosen(app);
  const box = item && boundsOf(regionOf(app.state, item, app.state.frame).polygons);
  if (box) app.state.set({ view: views.around(box, app.stage()) });
}

export const toggle = (app, name) => app.state.set({ [name]: !app.state[name] });

export function cycleColouring(app) {
  const order = ["label", "length", "none"];
  const colouring = order[(order.indexOf(app.state.colouring) + 1) % order.length];
  app.state.set({ colouring });
  say(app, { label: "Trajectories by label", length: "Trajectories by length", none: "No trajectories" }[colouring]);
}

export function brighten(app) {
  app.brightness = ((app.brightness ?? 0) + 1) % 3;
  app.pictureCanvas.className = `bright${app.brightness}`;
}

/** Go to the next trajectory that is unlabelled or in conflict. */
export function nextProblem(app) {
  const { labels, tracks } = app.state;
  const rows = labels ? [...labels.reason.keys()].filter((row) => labels.reason[row] === 2 || labels.reason[row] === 3) : [];
  if (!rows.length) return say(app, "No trajectory is unlabelled or in conflict");
  app.problem = ((app.problem ?? -1) + 1) % rows.length;
  const row = rows[app.problem];
  const seen = [...Array(tracks.frames).keys()].filter((f) => !Number.isNaN(tracks.xy[2 * (row * tracks.frames + f)]));
  show(app, row, seen[Math.floor(seen.length / 2)]);
  const reason = labels.reason[row] === 3 ? "in conflict" : "too short to tell";
  say(app, `trajectory ${row} is ${reason} (${app.problem + 1} of ${rows.length}); lasso it with Q`);
}

/** Show one trajectory in one frame. */
export function show(app, row, frame) {
  const { tracks } = app.state;
  const at = 2 * (row * tracks.frames + frame);
  const point = [tracks.xy[at], tracks.xy[at + 1]];
  goTo(app, frame);
  const scale = Math.max(app.state.view.scale, 4);
  app.state.set({ cross: point, view: views.centred(...point, scale, app.stage()) });
}

