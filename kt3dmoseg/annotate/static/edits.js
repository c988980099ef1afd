// Edits of an annotation: each returns a new document that shares all that it did not touch.

export const objectOf = (doc, id) => doc.objects.find((item) => item.id === id) ?? null;

export const keyAt = (item, frame) => item.key_frames.find((key) => key.frame === frame) ?? null;

export function withObject(doc, changed) {
  return { ...doc, objects: doc.objects.map((item) => (item.id === changed.id ? changed : item)) };
}

export function nextId(doc) {
  return Math.max(0, ...doc.objects.map((item) => item.id)) + 1;
}

export function nextMotion(doc) {
  const used = doc.objects.map((item) => item.motion).filter(Number.isInteger);
  return Math.max(0, ...used) + 1;
}

export function addObject(doc, frame, polygon) {
  const id = nextId(doc);
  const key_frames = [{ frame, visibility: "visible", polygons: [polygon] }];
  const item = { id, name: `object ${id}`, kind: "car", motion: nextMotion(doc), key_frames };
  return { ...doc, objects: [...doc.objects, item] };
}

export function removeObject(doc, id) {
  return { ...doc, objects: doc.objects.filter((item) => item.id !== id) };
}

export function update(doc, id, fields) {
  return withObject(doc, { ...objectOf(doc, id), ...fields });
}

/** Draw an object in one frame, or say that it is occluded or outside from there on. */
export function setKey(doc, id, key) {
  const item = objectOf(doc, id);
  const key_frames = [...item.key_frames.filter((other) => other.frame !== key.frame), key];
  key_frames.sort((a, b) => a.frame - b.frame);
  return withObject(doc, { ...item, key_frames });
}

/** Forget what was said in one frame; the only key frame stays. */
export function removeKey(doc, id, frame) {
  const item = objectOf(doc, id);
  const key_frames = item.key_frames.filter((key) => key.frame !== frame);
  return key_frames.length ? withObject(doc, { ...item, key_frames }) : doc;
}

export function visible(frame, polygons) {
  return { frame, visibility: "visible", polygons };
}

/** Take an object out of one frame only: outside here, back in the next. */
export function deleteHere(doc, id, frame, after) {
  const item = objectOf(doc, id);
  let changed = doc;
  const next = frame + 1;
  if (after && after.visibility !== "outside" && !keyAt(item, next)) {
    changed = setKey(changed, id, { frame: next, visibility: after.visibility, polygons: after.polygons });
  }
  return setKey(changed, id, { frame, visibility: "outside", polygons: [] });
}

/** The object enters in this frame: drawn here, outside in the frame before. */
export function enterHere(doc, id, frame, polygons) {
  const drawn = setKey(doc, id, visible(frame, polygons));
  return frame ? setKey(drawn, id, { frame: frame - 1, visibility: "outside", polygons: [] }) : drawn;
}

export function addMark(doc, frame, motion, polygon) {
  return { ...doc, marks: [...(doc.marks ?? []), { frame, motion, polygon }] };
}

export function removeMark(doc, index) {
  return { ...doc, marks: doc.marks.filter((_, k) => k !== index) };
}

export function replacePoint(polygons, part, index, point) {
  return polygons.map((polygon, k) =>
    k === part ? polygon.map((old, i) => (i === index ? point : old)) : polygon);
}

export function insertPoint(polygons, part, index, point) {
  return polygons.map((polygon, k) => (k === part ? polygon.toSpliced(index, 0, point) : polygon));
}

/** Remove a point; a polygon of three loses itself. */
export function removePoint(polygons, part, index) {
  return polygons
    .map((polygon, k) => (k === part ? polygon.toSpliced(index, 1) : polygon))
    .filter((polygon) => polygon.length >= 3);
}

export function shift(polygons, dx, dy) {
  return polygons.map((polygon) => polygon.map(([x, y]) => [x + dx, y + dy]));
}
