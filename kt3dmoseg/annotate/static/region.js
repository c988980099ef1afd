// The region of an object in a frame: the document's where a person drew it, else the server's.

import { keyAt } from "./edits.js";
import { rounded, simplify } from "./geometry.js";

// Blended outlines have more points than a person wants to drag.
const TOLERANCE = 0.4;

export function regionOf(state, item, frame) {
  const key = keyAt(item, frame);
  if (key) return { visibility: key.visibility, polygons: key.polygons ?? [], key: true };
  const told = state.regions?.[item.id]?.[frame];
  if (told && !told.key) return told;
  const before = item.key_frames.filter((other) => other.frame < frame).at(-1) ?? item.key_frames[0];
  return { visibility: before.visibility, polygons: before.polygons ?? [], key: false };
}

/** The same, thinned out where the first edit will make it a key frame. */
export function editableRegion(state, item, frame) {
  const region = regionOf(state, item, frame);
  if (region.key) return region;
  return { ...region, polygons: region.polygons.map((polygon) => rounded(simplify(polygon, TOLERANCE))) };
}
