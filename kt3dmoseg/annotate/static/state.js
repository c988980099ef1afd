// The page's state: plain values, their listeners, undo and redo, and what is selected.

import { ORIGIN, keyAt, objectOf } from "./annotation.js";

// What every clip begins with. `dragging` is the document from before what is being dragged, `carried` the one that
// regions are of.
const FRESH = {
  doc: null, frame: 0, selected: null, vertex: null, tool: "select", pending: null, lassoed: null, cross: null,
  pointer: null, hovered: null, tracks: null, labels: null, regions: null, weak: null, carried: null, moving: null, view: null,
  computing: "loading", proposals: null, review: null, compared: null, dragging: null, making: null,
  span: null, flickered: null, playing: false, hint: "", scrolled: 0, done: [], undone: [],
  unseen: new Set(), locked: new Set(), brightness: 1, contrast: 1, brush: 8,
};

// How things are shown, unless somebody wishes otherwise, which this browser keeps.
export const USUAL = {
  brightness: 1, contrast: 1, opacity: 1, pixels: "smooth", colouring: "label", trails: true, problems: false,
  hidden: false, theme: "light dark",
};

export const state = {
  ...FRESH, ...USUAL, clip: null, saving: { kind: "saved", revision: 0 }, keyboard: false, resized: 0, summaries: null,
  trouble: "",
};

const listeners = [];

/** Call `listener` at once when any of `keys` changes: for what must not wait for a picture. */
export const now = (keys, listener) => listeners.push({ keys, listener });

/** Call `listener` in the next animation frame after any of `keys` changed: for drawing. */
export function on(keys, listener) {
  let waiting = 0;
  const run = () => {
    waiting = 0;
    listener();
  };
  now(keys, () => (waiting ||= requestAnimationFrame(run)));
}

export function set(changes) {
  const changed = Object.keys(changes).filter((key) => state[key] !== changes[key]);
  Object.assign(state, changes);
  for (const { keys, listener } of listeners) if (changed.some((key) => keys.includes(key))) listener();
}

export const begin = (clip, values) => set({ ...FRESH, clip, ...values });

// Documents are never changed in place, so keeping all of them costs nothing.

/** Make `doc` the present document, as one edit. */
export function edit(doc) {
  const before = state.dragging ?? state.doc;
  set({ doc, dragging: null, ...(doc === before ? {} : { done: [...state.done, before], undone: [] }) });
}

/** The same, and select its last object. */
export function editLast(doc) {
  edit(doc);
  select(doc.objects.at(-1)?.id ?? null);
}

/** Show a document while something is being dragged; `edit` or `cancel` ends it. */
export const preview = (doc) => set({ doc, dragging: state.dragging ?? state.doc });
export const cancel = () => state.dragging && set({ doc: state.dragging, dragging: null });
export const undo = () => travel("done", "undone", "Nothing to undo");
export const redo = () => travel("undone", "done", "Nothing to redo");

function travel(source, target, nothing) {
  const { [source]: from, [target]: to, dragging, doc } = state;
  if (!from.length || dragging) return notify(nothing);
  set({ doc: from.at(-1), [source]: from.slice(0, -1), [target]: [...to, doc], vertex: null });
  return selectedObject() || set({ selected: null });
}

let hintTimer = 0;

export function notify(hint) {
  set({ hint });
  clearTimeout(hintTimer);
  hintTimer = setTimeout(() => set({ hint: "" }), 4000);
}

// An id that is free again must not stay hidden or locked.
now(["doc"], () => {
  for (const kind of ["unseen", "locked"]) {
    const left = [...state[kind]].filter((id) => state.doc && objectOf(state.doc, id));
    if (left.length < state[kind].size) set({ [kind]: new Set(left) });
  }
});

// A point that its outline has no more is not chosen.
now(["doc"], () => {
  const { vertex, frame } = state;
  const item = vertex && selectedObject();
  if (vertex && !(item && regionOf(item, frame).polygons[vertex.part]?.[vertex.index])) set({ vertex: null });
});

/** Run an action; a failure, for instance because the server is away, becomes a hint. */
export const attempt = (action) => (async () => action())().catch(({ message }) => notify(message));

export const selectedObject = () => state.doc && objectOf(state.doc, state.selected);

/** The selected object, or a hint that there is none. */
export function chosen() {
  const item = selectedObject();
  if (!item) notify("Select an object first: click it, or press ]");
  return item;
}

/** An object, by default the selected one, where it may be changed; or a hint why not. */
export function editable(item = chosen()) {
  if (!item || !state.locked.has(item.id)) return item;
  notify(`${item.name} is locked: Shift+R unlocks it`);
  return null;
}

/** Hide the selected object, lock it, or take that back; `kind` is "unseen" or "locked". */
export function toggleObject(kind, id = chosen()?.id) {
  if (id !== undefined) set({ [kind]: state[kind].symmetricDifference(new Set([id])) });
}

export function select(id) {
  if (id !== state.selected) set({ selected: id, vertex: null, lassoed: null });
}

/** The server's regions, where they are of this object and not of one that had its number. */
function regionsOf(item) {
  const known = state.carried && objectOf(state.carried, item.id);
  return known && known[ORIGIN] === item[ORIGIN] ? state.regions : null;
}

/** The region of an object in a frame: the document's where a person drew it, else the server's. */
export function regionOf(item, frame, regions = regionsOf(item)) {
  const key = keyAt(item, frame);
  const found = regions?.[item.id]?.[frame];
  if (!key && found && !found.key) return found;
  const { visibility, polygons } = key ?? item.key_frames.findLast((k) => k.frame < frame) ?? item.key_frames[0];
  return { visibility, polygons: polygons ?? [], key: Boolean(key) };
}
