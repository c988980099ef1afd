// The annotation as a document: each edit returns a new one that shares all that it did not touch.

export const objectOf = (doc, id) => doc.objects.find((item) => item.id === id) ?? null;

export const keyAt = (item, frame) => item.key_frames.find((key) => key.frame === frame) ?? null;

const nextId = (doc) => Math.max(0, ...doc.objects.map((item) => item.id)) + 1;

export const nextMotion = (doc) => Math.max(0, ...doc.objects.map((item) => item.motion).filter(Number.isInteger)) + 1;

/** Add an object under the next free id; what is not given is a car with the next free motion. */
export function addObject(doc, values) {
  const id = nextId(doc);
  // In the server's order of fields: documents are compared as text.
  const item = { id, name: `object ${id}`, kind: "car", motion: nextMotion(doc) };
  return { ...doc, objects: [...doc.objects, { ...item, ...values, id }] };
}

export const update = (doc, id, fields) =>
  ({ ...doc, objects: doc.objects.map((item) => (item.id === id ? { ...item, ...fields } : item)) });

/** Draw an object in one frame, or make it occluded or outside from there on. */
export function setKey(doc, id, frame, polygons, visibility = "visible") {
  const others = objectOf(doc, id).key_frames.filter((key) => key.frame !== frame);
  const key_frames = [...others, { frame, visibility, polygons }].sort((a, b) => a.frame - b.frame);
  return update(doc, id, { key_frames });
}

const changePart = (polygons, part, change) => polygons.map((polygon, k) => (k === part ? change(polygon) : polygon));

export const replacePoint = (polygons, part, index, point) =>
  changePart(polygons, part, (polygon) => polygon.with(index, point));

export const insertPoint = (polygons, part, index, point) =>
  changePart(polygons, part, (polygon) => polygon.toSpliced(index, 0, point));

/** Remove a point; a polygon of three vanishes. */
export const removePoint = (polygons, part, index) =>
  changePart(polygons, part, (polygon) => polygon.toSpliced(index, 1)).filter((polygon) => polygon.length >= 3);

export const shift = (polygons, dx, dy) => polygons.map((polygon) => polygon.map(([x, y]) => [x + dx, y + dy]));

/** The region of an object in a frame: the document's where a person drew it, else the server's. */
export function regionIn(item, frame, regions) {
  const key = keyAt(item, frame);
  if (key) return { visibility: key.visibility, polygons: key.polygons ?? [], key: true };
  const found = regions?.[item.id]?.[frame];
  if (found && !found.key) return found;
  const before = item.key_frames.filter((other) => other.frame < frame).at(-1) ?? item.key_frames[0];
  return { visibility: before.visibility, polygons: before.polygons ?? [], key: false };
}

const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);

/** Merge two documents made from the same saved one: nothing that either side drew is lost.
 *  Objects changed on one side only are taken from there; changed on both, both are kept. */
export function merge(base, mine, theirs) {
  let merged = { ...mine, revision: theirs.revision, objects: [], marks: mergeMarks(base, mine, theirs) };
  const doubles = [];
  for (const id of new Set([...theirs.objects, ...mine.objects].map((item) => item.id))) {
    const [old, my, their] = [base, mine, theirs].map((doc) => objectOf(doc, id));
    let kept = [my, their];
    if (same(my, old) || same(my, their)) kept = [their];
    else if (same(their, old)) kept = [my];
    const [first, double] = kept.filter(Boolean);
    if (first) merged.objects.push(first);
    if (double) doubles.push(double);
  }
  for (const item of doubles) merged = addObject(merged, { ...item, name: `${item.name} (other)` });
  return merged;
}

function mergeMarks(base, mine, theirs) {
  const text = (doc) => new Set((doc.marks ?? []).map((mark) => JSON.stringify(mark)));
  const [old, my, their] = [text(base), text(mine), text(theirs)];
  const all = new Set([...their, ...my]);
  return [...all].filter((mark) => !old.has(mark) || (my.has(mark) && their.has(mark))).map((mark) => JSON.parse(mark));
}
