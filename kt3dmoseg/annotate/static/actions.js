// What a person can do to the annotation, by key, button or pointer.

import {
  addObject, areaOf, boundsOf, changeObject, clamp, distance, inside, keyAt, middle, objectOf, rounded, setKey, simplify, splice,
} from "./annotation.js";
import { nextOf } from "./dom.js";
import { ask } from "./saving.js";
import {
  attempt, cancel, edit, editLast, editable, notify, now, regionOf, select, selectedObject, set, state,
} from "./state.js";
import { NOT_YET, rowsWhere, visitNext } from "./tracks.js";
import { goTo, inSight } from "./view.js";

const CARRIED = "It is being carried there: press C again";
// Blended outlines have more points than anyone should drag.
const TOLERANCE = 0.4;

/** The region of an object in a frame, thinned out where the first edit will make it a key frame. */
export function editableRegion(item, frame) {
  const region = regionOf(item, frame);
  if (region.key) return region;
  return { ...region, polygons: region.polygons.map((polygon) => rounded(simplify(polygon, TOLERANCE))) };
}

/** The selected object's region here, ready to be edited. */
export const regionHere = () => editableRegion(selectedObject(), state.frame);

/** An action on the selected object, if there is one that may be changed. */
const withObject = (action) => (...given) => {
  const item = editable();
  return item && action(item, ...given);
};

/** With a region drawn in a frame; what was outlined by itself elsewhere is outlined again. */
function withKey(doc, frame, ...region) {
  const id = state.selected;
  const drawn = objectOf(doc, id).key_frames.filter((key) => key.frame === frame || !doubts.has(key.polygons));
  if (drawn.length === objectOf(doc, id).key_frames.length) return setKey(doc, id, frame, ...region);
  makeKeysSoon(id);
  return setKey(changeObject(doc, id, { key_frames: drawn }), id, frame, ...region);
}

/** As it is seen there: what is reshaped behind something stays behind it. */
const seenAs = ({ visibility }) => (visibility === "occluded" ? visibility : "visible");

/** Make the selected object's region here a key frame. */
export const draw = (polygons, visibility = seenAs(regionHere()), doc = state.doc) =>
  edit(withKey(doc, state.frame, polygons.map(rounded), visibility));

/** The document in which the frame before keeps what is seen there: a first key frame counts before itself, too. */
function keptBefore(item) {
  const { doc, frame } = state;
  const drawn = item.key_frames.filter((key) => !doubts.has(key.polygons)); // the others are made again
  if (!frame || drawn[0]?.frame <= frame) return doc;
  const { polygons, visibility } = editableRegion(item, frame - 1);
  return setKey(doc, item.id, frame - 1, [...polygons], visibility);
}

/** Change an object's properties, while one is selected that may be changed. */
export const update = withObject((_, { id }, fields) => edit(changeObject(state.doc, id, fields)));

// Drawing

export function setTool(tool, mode = "object") {
  const pending = tool === "select" ? null : { points: [], mode, freehand: false, id: state.selected };
  set({ tool, pending, lassoed: null, vertex: null, cross: state.keyboard ? state.cross : null });
  if (tool === "click") deselect();
  else if (tool === "draw" && mode === "object") inTurn(() => state.tool === tool && select(null));
}

export const redraw = withObject((_, mode, tool = "draw") => setTool(tool, mode));

/** End the outline being drawn: a new object, the region of one, or a lasso. */
export function finish() {
  const { pending, tool, frame } = state;
  if (!pending || pending.points.length < 3) return notify("An outline needs at least three points");
  const { points, mode, freehand, id } = pending;
  const polygon = rounded(freehand ? simplify(points, 0.8 / Math.sqrt(state.view.scale)) : points);
  if (tool !== "lasso" && areaOf(polygon) < 1) {
    set({ pending: { ...pending, points: [], freehand: false } });
    return notify("This outline is smaller than a pixel: draw it again");
  }
  setTool("select");
  if (tool === "lasso") return catchTracks(frame, polygon);
  if (mode !== "object" && objectOf(state.doc, id)) {
    select(id); // another one may be selected since
    return mode === "part" ? draw([...regionHere().polygons, polygon]) : draw([polygon], "visible");
  }
  const first = { frame, visibility: "visible", polygons: [polygon] };
  editLast(addObject(state.doc, { key_frames: [first] }));
  return notify("Press 1 to 9 for its motion, x to reject; name it on the right");
}

function catchTracks(frame, polygon) {
  const rows = rowsWhere(frame, (point) => inside(point, polygon));
  set({ lassoed: { frame, polygon, rows } });
  const caught = state.tracks ? `${rows.length} trajectories` : `${NOT_YET}; the lasso holds when they are`;
  notify(`${caught}: press 1 to 9, 0 for background, x to reject, Esc to deselect`);
}

const setPoints = (points) => set({ pending: { ...state.pending, points } });

export function addPoint(point) {
  const { points } = state.pending;
  const last = points.at(-1);
  if (!last || distance(last, point) * state.view.scale >= 2) setPoints([...points, point]);
}

export const takeBackPoint = () => setPoints(state.pending.points.slice(0, -1));

/** Enter: a point under the cross while drawing, or the end when the cross is on the last one. */
export function enter() {
  const { tool, pending, cross } = state;
  if (!pending) return cross && select(objectUnder(cross)?.id ?? null);
  if (tool === "brush") return cross && paint([cross], pending.mode === "add");
  const last = (tool === "click" ? clicksHere() : pending.points).at(-1);
  const further = cross && !(last && distance(last, cross) < 0.5);
  if (tool === "click") return further ? click(cross, true) : deselect();
  return further ? addPoint([...cross]) : finish();
}

export function escape() {
  if (state.dragging) return cancel();
  if (state.pending) return setTool("select");
  const first = ["lassoed", "vertex", "cross", "review", "compared"].find((key) => state[key]) ?? "selected";
  return set({ [first]: null, ...(first === "review" ? { proposals: null } : {}) });
}

// Outlines by clicks. What was asked for an outline, clicks and a box, is kept with it: undo takes both back.

const askedOf = new WeakMap();
const askedAt = (frame) => askedOf.get(keyAt(selectedObject() ?? { key_frames: [] }, frame)?.polygons);
export const clicksHere = () => askedAt(state.frame)?.clicks ?? [];

let turn = Promise.resolve();

/** Do what asks the server; one after the other, however fast they come. */
function inTurn(action) {
  const { clip, frame } = state;
  turn = turn.then(() => attempt(() => clip === state.clip && action(frame)));
  return turn;
}

// Whose the next clicks are: of the selected object, or of one that is not there before the first of them is answered.
let aim = { id: null };
let answering = false; // then what is selected was aimed at before
now(["selected"], () => !answering && state.selected !== aim.id && (aim = { id: state.selected }));

function unaimed(action) {
  answering = true;
  action();
  answering = false;
}

/** So that what was clicked before still belongs to what was selected. */
function deselect() {
  aim = { id: null };
  return inTurn(() => unaimed(() => select(null)));
}

/** An outline of what was aimed at when it was asked for, unless another object is selected in its turn. */
function outlineInTurn(askedIn) {
  const own = aim;
  return inTurn((frame) => (own.id === state.selected ? outline(askedIn(frame), own)
    : notify("Another object was selected meanwhile: click again")));
}

/** Outline what moves with a point: the selected object, else a new one. Where that is outlined, or carried to,
 *  clicks add to it or take away. */
export const click = (point, adds) => outlineInTurn((frame) => {
  const item = selectedObject();
  const { clicks = [], ...before } = askedAt(frame) ?? { like: item ? seenAt(item, frame) : [] };
  return { ...before, frame, clicks: [...clicks, [...point, adds]] };
});

const seenAt = (item, frame) => {
  const { visibility, polygons } = regionOf(item, frame);
  return visibility === "visible" ? polygons : [];
};

/** In a box, what is carried there from other frames is the shape to expect. */
export const outlineBox = (box) => outlineInTurn((frame) => {
  const item = selectedObject();
  const drawn = item && keyAt(item, frame);
  const like = !item || (drawn && !doubts.has(drawn.polygons)) ? [] : regionOf(item, frame).polygons;
  return { frame, box, clicks: [], like };
});

// Key frames made by themselves where a region is in doubt, and why it is; each outline makes them again.
const doubts = new WeakMap();
const QUIET = 400;
let quiet = 0; // the timer, while it runs
let made = Promise.resolve(); // once all that is being made is there

const sameKeys = ({ key_frames }) => (item) => item.key_frames === key_frames;

async function makeKeys(id) {
  const { clip } = state;
  const before = objectOf(state.doc, id);
  if (!before || before.key_frames.some((key) => doubts.has(key.polygons))) return;
  const answer = await ask(clip.name, "made", { ...state.doc, objects: [before] });
  while (state.dragging) await new Promise((later) => setTimeout(later, QUIET / 10));
  if (clip !== state.clip) return;
  // Edited meanwhile: make them of what is there now, but for what was undone.
  if (!state.doc.objects.some(sameKeys(before)) && !state.undone.length) makeKeysSoon(id);
  if (!answer.made.length) return;
  const after = objectOf(answer.made.reduce((doc, [frame, outlined, why]) => {
    const polygons = outlined.map(rounded);
    doubts.set(polygons, `outlined by itself: ${why}`);
    return setKey(doc, id, frame, polygons);
  }, { objects: [before] }), id);
  const { key_frames } = after;
  if (hiddenFrom.has(before.key_frames)) hiddenFrom.set(key_frames, hiddenFrom.get(before.key_frames));
  // Also in what undo and redo go to, where it is outlined as it was.
  const completed = (doc) => (!doc.objects.some(sameKeys(before)) ? doc
    : { ...doc, objects: doc.objects.map((item) => (sameKeys(before)(item) ? { ...item, key_frames } : item)) });
  set({ doc: completed(state.doc), done: state.done.map(completed), undone: state.undone.map(completed) });
  if (state.doc.objects.some(sameKeys(after))) {
    notify(`Outlined by itself where it was in doubt, in frames: ${answer.made.length}; Shift+W shows them`);
  }
}

/** Make them once it is quiet: further clicks do not wait for it. What another object waits for is made at once. */
function makeKeysSoon(id) {
  if (quiet && id !== state.making) makeKeysNow();
  clearTimeout(quiet);
  set({ making: id }); // which merging renumbers
  quiet = setTimeout(makeKeysNow, QUIET);
}

async function makeKeysNow() {
  clearTimeout(quiet);
  quiet = 0;
  const { making } = state;
  const own = made = Promise.all([made, attempt(() => makeKeys(making))]);
  await own;
  if (own === made && !quiet) set({ making: null });
}

/** Wait until all outlines and key frames that the server was asked for are there. */
export async function allOutlined() {
  await turn;
  for (; state.making !== null; await made) if (quiet) makeKeysNow();
}

/** Why an object's region is in doubt in a frame, if it is. */
export const doubtAt = (item, frame) =>
  doubts.get(keyAt(item, frame)?.polygons) ?? state.weak?.[item.id]?.[frame];

/** Whether what was asked about an object in a frame still holds; key frames made by themselves change nothing. */
function holds(clip, item, frame) {
  const drawn = (object) => [keyAt(object, frame)?.polygons].find((polygons) => !doubts.has(polygons));
  const now = item && objectOf(state.doc, item.id);
  return clip === state.clip && !state.dragging && (!item || (now && drawn(now) === drawn(item)));
}

async function outline(asked, own) {
  const item = selectedObject();
  if (item && !editable()) return undefined;
  if (!state.tracks) return notify("The trajectories are not there yet");
  const { frame, box, clicks, like } = asked;
  if (!box && !like.length && !clicks[0][2]) return notify("Click on what moves first; then Alt+click takes away");
  const { clip } = state;
  const answer = await ask(clip.name, "outline", asked);
  if (!holds(clip, item, frame) || (item && item.id !== state.selected)) return notify("Edited meanwhile: click again");
  if (!answer.polygons.length) return notify("No outline there: click on what moves, where trajectories are");
  const polygons = answer.polygons.map(rounded);
  askedOf.set(polygons, asked);
  if (item) {
    edit(withKey(state.doc, frame, polygons));
  } else {
    const doc = addObject(state.doc, { key_frames: [{ frame, visibility: "visible", polygons }] });
    own.id = doc.objects.at(-1).id;
    unaimed(() => editLast(doc));
  }
  return makeKeysSoon(state.selected);
}

// Brush and eraser

/** Add to the outline what a disc covers along a line, or take it away. */
export const paint = (stroke, adds, id = state.selected) => inTurn(async (frame) => {
  if (id !== state.selected) return notify("Another object was selected meanwhile: paint again");
  const item = editable();
  if (!item) return undefined;
  const { clip, brush } = state;
  const { polygons, visibility } = editableRegion(item, frame);
  const answer = await ask(clip.name, "paint", { polygons, stroke, radius: brush, adds });
  if (!holds(clip, item, frame)) return notify("Edited meanwhile: paint again");
  if (!answer.polygons.length) return notify("Nothing would be left; Delete takes the object out of this frame");
  return edit(setKey(state.doc, item.id, frame, answer.polygons.map(rounded), seenAs({ visibility })));
});

export function resizeBrush(factor) {
  set({ brush: clamp(Math.round(state.brush * factor * 2) / 2, 1, 100) });
  notify(`Brush: ${2 * state.brush} pixels wide`);
}

// Objects

export function cycleObject(by) {
  const { objects } = state.doc;
  if (!objects.length) return notify("No objects yet: press N and click around one");
  return select(nextOf(objects, objects.indexOf(selectedObject()), by).id);
}

/** Select the n-th object of the list, from 1. */
export const selectNth = (n) => select(state.doc.objects[n - 1]?.id ?? state.selected);

export const objectUnder = (point) => state.doc.objects.findLast((item) => {
  if (state.unseen.has(item.id) || state.locked.has(item.id)) return false;
  const { visibility, polygons } = regionOf(item, state.frame);
  return visibility !== "outside" && polygons.some((polygon) => inside(point, polygon));
});

const setMarks = (marks) => edit({ ...state.doc, marks });

/** One key, one label: of the lassoed trajectories, else of the selected object. */
export function setMotion(motion) {
  const { lassoed, doc } = state;
  if (!lassoed) return setOwnMotion(motion);
  const { frame, polygon } = lassoed;
  setMarks([...(doc.marks ?? []), { frame, motion, polygon }]);
  set({ lassoed: null });
  const rows = rowsWhere(frame, (point) => inside(point, polygon));
  return notify(state.tracks ? `${rows.length} trajectories marked` : `Marked. ${NOT_YET}`);
}

const setOwnMotion = withObject((item, motion) => item.motion !== motion && update(item, { motion }));

export function removeMarksHere() {
  const before = state.doc.marks ?? [];
  const marks = before.filter((mark) => mark.frame !== state.frame);
  if (marks.length !== before.length) setMarks(marks);
}

/** Whether what is seen here is, to two pixels, what the regions were carried from. */
function asCarried({ id }) {
  const [now, then] = [regionHere(), state.regions[id]?.[state.frame]].map((region) => boundsOf(region?.polygons ?? []));
  return Boolean(now && then) && now.every((value, k) => Math.abs(value - then[k]) < 2);
}

export const copyToNext = withObject((item) => {
  const next = state.frame + 1;
  if (next >= state.clip.n_frames) return undefined;
  if (!state.regions) notify("No trajectories yet: copied without motion");
  else if (state.saving.kind === "offline") notify("The server is away: copied as far as it is known");
  else if (objectOf(state.carried, item.id)?.key_frames !== item.key_frames && !asCarried(item)) return notify(CARRIED);
  const { key, visibility, polygons } = editableRegion(item, next);
  if (visibility !== "visible" || !polygons.length) return notify("It is not visible there");
  if (!key) edit(withKey(state.doc, next, polygons));
  return goTo(next);
});

// Where an object was made occluded or outside: { frame, key_frames } from before, by the key frames since then.
const hiddenFrom = new WeakMap();

/** The key frames from before an object was made occluded or outside here, while it was as wanted. */
function asBefore(key_frames, wanted) {
  const before = hiddenFrom.get(key_frames);
  if (before?.frame !== state.frame) return null;
  return wanted(regionOf(before, before.frame, null).visibility) ? before.key_frames : asBefore(before.key_frames, wanted);
}

export const setVisibility = withObject((item, visibility) => {
  const { frame } = state;
  const key_frames = asBefore(item.key_frames, (was) => was === visibility);
  if (key_frames) return update(item, { key_frames });
  const far = (key) => Math.abs(key.frame - frame);
  const drawn = item.key_frames.filter((key) => key.polygons?.length).sort((a, b) => far(a) - far(b));
  const polygons = [regionHere(), ...drawn].find((region) => region.polygons.length)?.polygons ?? [];
  if (visibility === "visible") return polygons.length ? draw(polygons, visibility) : notify("Draw it here first: press R");
  draw(visibility === "outside" ? [] : polygons, visibility, keptBefore(item));
  return hiddenFrom.set(selectedObject().key_frames, { frame, key_frames: item.key_frames });
});

export const toggleVisibility = withObject((item, wanted) => {
  if (regionHere().visibility !== wanted) return setVisibility(wanted);
  const before = asBefore(item.key_frames, (was) => was !== wanted);
  if (before) return update(item, { key_frames: before });
  // The key that says so goes again, where the object is seen without it.
  const key_frames = item.key_frames.filter((key) => key.frame !== state.frame);
  const seen = key_frames.length && regionOf({ key_frames }, state.frame, null).visibility === "visible";
  return seen ? update(item, { key_frames }) : setVisibility("visible");
});

/** The object enters in this frame: drawn here, outside in the frame before. */
export const enterHere = withObject(() => {
  const { doc, frame } = state;
  const { polygons, visibility } = regionHere();
  if (visibility !== "visible") return notify("It is not visible here");
  const drawn = withKey(doc, frame, polygons);
  return edit(frame ? withKey(drawn, frame - 1, [], "outside") : drawn);
});

export const deleteHere = withObject((item) => {
  const { frame, clip } = state;
  // Outside here, and back in the next frame as it is there.
  const { visibility, polygons, key } = regionOf(item, frame + 1);
  const back = frame + 1 < clip.n_frames && visibility !== "outside" && (!key || doubts.has(polygons));
  const doc = keptBefore(item);
  edit(withKey(back ? withKey(doc, frame + 1, [...polygons], visibility) : doc, frame, [], "outside"));
  notify(`${item.name} is not in this frame; Shift+Delete removes it from the whole clip`);
});

export const deleteObject = withObject((item) => {
  edit({ ...state.doc, objects: state.doc.objects.filter((other) => other !== item) });
  select(null);
  notify(`${item.name} deleted from the whole clip; Ctrl+Z restores it`);
});

export const forgetKey = withObject((item) => {
  const key_frames = item.key_frames.filter((key) => key.frame !== state.frame);
  if (!key_frames.length) notify("This is its only key frame; Shift+Delete deletes the object");
  else if (keyAt(item, state.frame)) {
    update(item, { key_frames });
    set({ vertex: null });
  }
});

/** The document in which a key frame is in another frame: between its neighbours, for it replaces none. It takes the
 *  outline that is carried there, where that is its own. */
export function moveKey(doc, item, from, wanted) {
  if (state.locked.has(item.id)) return notify(`${item.name} is locked: Shift+R unlocks it`);
  const others = item.key_frames.filter((key) => key.frame !== from).map((key) => key.frame);
  const least = Math.max(-1, ...others.filter((frame) => frame < from)) + 1;
  const most = Math.min(state.clip.n_frames, ...others.filter((frame) => frame > from)) - 1;
  const to = clamp(wanted, least, most);
  if (to === from) return doc;
  const { visibility, polygons } = keyAt(item, from);
  const there = editableRegion(item, to);
  const own = objectOf(state.carried ?? { objects: [] }, item.id)?.key_frames === item.key_frames
    && there.visibility === visibility && there.polygons.length;
  const kept = visibility === "outside" ? [] : own ? there.polygons : polygons;
  const without = { key_frames: item.key_frames.filter((key) => key.frame !== from) };
  return setKey(changeObject(doc, item.id, without), item.id, to, kept, visibility);
}

/** Move the key frame here by one frame, and go there. */
export const shiftKey = withObject((item, by) => {
  const { frame, doc } = state;
  if (!keyAt(item, frame)) return notify("No key frame here: , and . go to one");
  const moved = moveKey(doc, item, frame, frame + by);
  if (moved === doc) return notify("There is another key frame, or the end of the clip");
  edit(moved);
  return goTo(frame + by);
});

/** Frames that an object was carried to with doubt: [frame, why]. */
export const weakFrames = (item) =>
  Array.from({ length: state.clip.n_frames }, (_, frame) => [frame, doubtAt(item, frame)]).filter(([, why]) => why);

/** Go to the next of them, of this object or the next one. */
export function nextWeak() {
  const { objects } = state.doc;
  const all = objects.flatMap((item, k) => weakFrames(item).map(([frame, why]) => ({ item, k, frame, why })));
  const own = objects.indexOf(selectedObject());
  const after = all.findIndex(({ k, frame }) => k > own || (k === own && frame > state.frame));
  visitNext("weak", all, state.weak ? "No frame is in doubt" : NOT_YET, ({ item, frame, why }, which) => {
    select(item.id);
    goTo(frame);
    return `${item.name}: ${why} (${which} weak frames)`;
  }, Math.max(0, after));
}

// Points

export const cycleVertex = withObject((_, by) => {
  const all = regionHere().polygons.flatMap((polygon, part) => polygon.map((_, index) => ({ part, index })));
  const { vertex } = state;
  const at = all.findIndex(({ part, index }) => part === vertex?.part && index === vertex.index);
  if (all.length) set({ vertex: nextOf(all, at, by), cross: null });
});

/** Move the selected point, or else the keyboard's cross, by whole pixels. */
export function nudge(dx, dy) {
  const { vertex, cross, clip: { image_size: [width, height] } } = state;
  if (vertex && selectedObject()) return movePoint(dx, dy);
  const [x, y] = cross ? [cross[0] + dx, cross[1] + dy] : inSight().map(Math.round);
  return set({ keyboard: true, cross: [clamp(x, 0, width - 1), clamp(y, 0, height - 1)] });
}

const movePoint = withObject((_, dx, dy) => {
  const { polygons } = regionHere();
  const [x, y] = polygons[state.vertex.part][state.vertex.index];
  draw(splice(polygons, state.vertex, 1, [x + dx, y + dy]));
});

export const insertVertex = withObject(() => {
  if (!state.vertex) return notify("Choose a point first: press V");
  const { part, index } = state.vertex;
  const { polygons } = regionHere();
  const vertex = { part, index: index + 1 };
  const [point] = rounded([middle(polygons[part][index], polygons[part][(index + 1) % polygons[part].length])]);
  draw(splice(polygons, vertex, 0, point));
  return set({ vertex });
});

export const deleteVertex = withObject((_, which = state.vertex) => {
  if (!which) return notify("Choose a point first: press V");
  const changed = splice(regionHere().polygons, which, 1);
  if (!changed.length) return notify("An outline needs three points; Delete takes the object out of this frame");
  draw(changed);
  return set({ vertex: null });
});
