// The region of an object in a frame: the document's where a person drew it, else the server's.

import { keyAt } from "./edits.js";

export function regionOf(state, item, frame) {
  const key = keyAt(item, frame);
  if (key) return { visibility: key.visibility, polygons: key.polygons ?? [], key: true };
  const told = state.regions?.[item.id]?.[frame];
  if (told && !told.key) return told;
  const before = item.key_frames.filter((other) => other.frame < frame).at(-1) ?? item.key_frames[0];
  return { visibility: before.visibility, polygons: before.polygons ?? [], key: false };
}
