// The page's state: plain values, their listeners, undo and redo.

import { objectOf } from "./annotation.js";

// What every clip begins with.
const FRESH = {
  doc: null, frame: 0, selected: null, vertex: null, tool: "select", pending: null, lassoed: null, cross: null,
  pointer: null, hovered: null, tracks: null, labels: null, regions: null, weak: null, moving: null, view: null, conflict: null,
  computing: "loading", proposals: null, review: null, compared: null, dragging: false, flickered: null,
  playing: false, hint: "", scrolled: 0, undoable: 0, redoable: 0, unseen: new Set(), locked: new Set(),
};

export const state = {
  ...FRESH, clip: null, saving: { kind: "saved", revision: 0 }, trails: true, hidden: false, problems: false,
  colouring: "label", brightness: 0, opacity: 1, keyboard: false, resized: 0, summaries: null, trouble: "",
};

const listeners = [];
const changed = new Set();

/** Call `listener` in the next animation frame after any of `keys` changed: for drawing. */
export const on = (keys, listener) => listeners.push({ keys, listener, now: false });

/** Call `listener` at once when any of `keys` changes: for what must not wait for a picture. */
export const now = (keys, listener) => listeners.push({ keys, listener, now: true });

/** Change values and call the listeners. */
export function set(changes) {
  const fresh = Object.keys(changes).filter((key) => state[key] !== changes[key]);
  Object.assign(state, changes);
  if (!changed.size && fresh.length) requestAnimationFrame(draw);
  fresh.forEach((key) => changed.add(key));
  call(fresh, true);
}

function draw() {
  const keys = [...changed];
  changed.clear();
  call(keys, false);
}

function call(keys, immediately) {
  for (const { keys: wanted, listener, now: immediate } of listeners) {
    if (immediate === immediately && wanted.some((key) => keys.includes(key))) listener();
  }
}

// Documents are never changed in place, so keeping all of them costs nothing.
const done = [];
const undone = [];
let start = null;

/** Forget the clip at hand and begin with another. */
export function begin(clip, values) {
  done.length = undone.length = 0;
  start = null;
  set({ ...FRESH, clip, ...values });
}

/** Make `doc` the present document, as one edit. */
export function edit(doc) {
  const before = start ?? state.doc;
  start = null;
  if (doc !== before) {
    done.push(before);
    undone.length = 0;
  }
  set({ doc, dragging: false, undoable: done.length, redoable: undone.length });
}

/** Show a document while something is being dragged; `edit` or `cancel` ends it. */
export function preview(doc) {
  start ??= state.doc;
  set({ doc, dragging: true });
}

export function cancel() {
  if (start) set({ doc: start, dragging: false });
  start = null;
}

export const undo = () => travel(done, undone, "Nothing to undo");

export const redo = () => travel(undone, done, "Nothing to redo");

function travel(source, target, nothing) {
  if (source.length && !state.dragging) {
    target.push(state.doc);
    set({ doc: source.pop(), undoable: done.length, redoable: undone.length });
  } else notify(nothing);
  set({ vertex: null });
  if (!selectedObject()) set({ selected: null });
}

let hintTimer = 0;

export function notify(hint) {
  set({ hint });
  clearTimeout(hintTimer);
  hintTimer = setTimeout(() => set({ hint: "" }), 4000);
}

/** Run an action; a failure, for instance because the server is away, becomes a hint. */
export async function attempt(action) {
  try {
    await action();
  } catch (error) {
    notify(error.message);
  }
}

export const selectedObject = () => state.doc && objectOf(state.doc, state.selected);

/** The selected object, or a hint that there is none. */
export function chosen() {
  const item = selectedObject();
  if (!item) notify("Select an object first: click it, or press ]");
  return item;
}

/** The selected object where it may be changed, or a hint why not. */
export function editable() {
  const item = chosen();
  if (!item || !state.locked.has(item.id)) return item;
  notify(`${item.name} is locked: Shift+R unlocks it`);
  return null;
}

/** Hide the selected object, lock it, or take that back; `kind` is "unseen" or "locked". */
export function toggleObject(kind, id = chosen()?.id) {
  if (id === undefined) return;
  const changed = new Set(state[kind]);
  if (!changed.delete(id)) changed.add(id);
  set({ [kind]: changed });
}

export function select(id) {
  if (id !== state.selected) set({ selected: id, vertex: null });
}
