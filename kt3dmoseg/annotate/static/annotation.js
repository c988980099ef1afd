// The annotation as a document: each edit returns a new one that shares all that it did not touch. Then the plane
// geometry of its outlines, in pixels.

export const objectOf = (doc, id) => doc.objects.find((item) => item.id === id) ?? null;
export const keyAt = (item, frame) => item.key_frames.find((key) => key.frame === frame) ?? null;
export const nextMotion = ({ objects, marks }) =>
  Math.max(0, ...[...objects, ...(marks ?? [])].map((item) => item.motion).filter(Number.isInteger)) + 1;

// Of one object, however it is changed: an id that is free again is taken by another. No part of the text.
export const ORIGIN = Symbol("origin");

/** Add an object under the next free id; what is not given is of the last one's kind with the next free motion. */
export function addObject(doc, values) {
  const id = Math.max(0, ...doc.objects.map((item) => item.id)) + 1;
  // In the server's order of fields: documents are compared as text.
  const item = { id, name: `object ${id}`, kind: doc.objects.at(-1)?.kind ?? "car", motion: nextMotion(doc), [ORIGIN]: {} };
  return { ...doc, objects: [...doc.objects, { ...item, ...values, id }] };
}

export const changeObject = (doc, id, fields) =>
  ({ ...doc, objects: doc.objects.map((item) => (item.id === id ? { ...item, ...fields } : item)) });

/** Draw an object in one frame, or make it occluded or outside from there on; no key says again that it is outside. */
export function setKey(doc, id, frame, polygons, visibility = "visible") {
  const others = objectOf(doc, id).key_frames.filter((key) => key.frame !== frame);
  const sorted = [...others, { frame, visibility, polygons }].sort((a, b) => a.frame - b.frame);
  const seen = sorted.findIndex((key) => key.visibility !== "outside");
  const away = (k) => sorted[k]?.visibility === "outside";
  const key_frames = sorted.filter((_, k) => !away(k) || (k < seen ? k === seen - 1 : !away(k - 1)));
  return changeObject(doc, id, { key_frames });
}

/** Merge two documents made from the same saved one: nothing that either side drew is lost.
 *  Objects changed on one side only are taken from there; changed on both, both are kept, mine under new ids:
 *  `moved` has these by the old ones. With `only`, no others than these are kept twice. */
export function merge(base, mine, theirs, only = null) {
  const [objects, doubles] = mergeLists([base, mine, theirs].map((doc) => doc.objects), (item) => item.id);
  const [marks] = mergeLists([base, mine, theirs].map((doc) => doc.marks ?? []), JSON.stringify);
  let doc = { ...mine, revision: theirs.revision, objects, marks };
  const moved = new Map();
  for (const item of doubles.filter(({ id }) => only?.has(id) ?? true)) {
    const { name, ...values } = item;
    const named = name === `object ${item.id}` ? {} : { name };
    // If it is not in the base, two new objects got one id.
    doc = addObject(doc, { ...values, ...(objectOf(base, item.id) ? { name: `${name} (other)` } : named) });
    moved.set(item.id, doc.objects.at(-1).id);
  }
  return { doc, moved };
}

/** An object as text, in which it does not matter whether an empty note is there, and where. */
const textOf = (item) =>
  item && JSON.stringify(Object.entries({ note: "", ...item }).sort(([a], [b]) => (a < b ? -1 : 1)));

/** The merged items, and my versions of those that both sides changed. */
function mergeLists(lists, keyOf) {
  const same = (a, b) => textOf(a) === textOf(b);
  const [base, mine, theirs] = lists.map((items) => new Map(items.map((item) => [keyOf(item), item])));
  const [merged, doubles] = [[], []];
  for (const key of new Set([...theirs.keys(), ...mine.keys()])) {
    const [old, my, their] = [base, mine, theirs].map((items) => items.get(key));
    let kept = [their, my];
    if (same(my, their)) kept = [my]; // with what is known here of its outlines
    else if (same(my, old)) kept = [their && my ? { ...their, [ORIGIN]: my[ORIGIN] } : their];
    else if (same(their, old)) kept = [my];
    const [first, double] = kept.filter(Boolean);
    if (first) merged.push(first);
    if (double) doubles.push(double);
  }
  return [merged, doubles];
}

// Outlines

/** Take out points of one of the polygons and put others there; a polygon of fewer than three vanishes. */
export const splice = (polygons, { part, index }, taken, ...points) =>
  polygons.with(part, polygons[part].toSpliced(index, taken, ...points)).filter((polygon) => polygon.length >= 3);

export const shift = (polygons, dx, dy) => polygons.map((polygon) => polygon.map(([x, y]) => [x + dx, y + dy]));
export const rounded = (polygon) => polygon.map(([x, y]) => [Math.round(x * 100) / 100, Math.round(y * 100) / 100]);
export const clamp = (value, low, high) => Math.min(high, Math.max(low, value));
export const distance = ([ax, ay], [bx, by]) => Math.hypot(ax - bx, ay - by);
export const middle = ([ax, ay], [bx, by]) => [(ax + bx) / 2, (ay + by) / 2];

/** Even-odd rule. */
export function inside([x, y], polygon) {
  let odd = false;
  polygon.forEach(([ax, ay], i) => {
    const [bx, by] = polygon.at(i - 1);
    if (ay > y !== by > y && x < ax + ((y - ay) * (bx - ax)) / (by - ay)) odd = !odd;
  });
  return odd;
}

/** The point of segment ab nearest to p. */
function nearestOnSegment(p, a, b) {
  const [dx, dy] = [b[0] - a[0], b[1] - a[1]];
  const t = clamp(((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / (dx * dx + dy * dy || 1), 0, 1);
  return [a[0] + t * dx, a[1] + t * dy];
}

export const nearestVertex = (p, polygons, reach) => nearest(p, polygons, reach, (vertex) => vertex);

/** The edge near p, as the index at which a new vertex would go. */
export function nearestEdge(p, polygons, reach) {
  const edge = nearest(p, polygons, reach, (a, b) => nearestOnSegment(p, a, b));
  return edge && { ...edge, index: edge.index + 1 };
}

function nearest(p, polygons, reach, pointOf) {
  const all = polygons.flatMap((polygon, part) => polygon.map((vertex, index) => {
    const point = pointOf(vertex, polygon[(index + 1) % polygon.length]);
    return { part, index, point, gap: distance(p, point) };
  }));
  return all.filter(({ gap }) => gap <= reach).sort((a, b) => a.gap - b.gap)[0];
}

const ROWS = 200;

/** Area by the even-odd rule, summed over rows. */
export function areaOf(polygon) {
  const [, top, , bottom] = boundsOf([polygon]);
  const rows = Array.from({ length: ROWS }, (_, k) => {
    const y = top + ((k + 0.5) / ROWS) * (bottom - top);
    const crossed = polygon.flatMap(([ax, ay], i) => {
      const [bx, by] = polygon.at(i - 1);
      return ay > y !== by > y ? [ax + ((y - ay) * (bx - ax)) / (by - ay)] : [];
    });
    return crossed.sort((a, b) => a - b).reduce((sum, x, i) => sum + (i % 2 ? x : -x), 0);
  });
  return rows.reduce((sum, wide) => sum + wide, 0) * ((bottom - top) / ROWS);
}

/** Left, top, right and bottom; null without a point. */
export function boundsOf(polygons) {
  const [xs, ys] = [0, 1].map((axis) => polygons.flat().map((point) => point[axis]));
  return xs.length ? [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)] : null;
}

/** Leave out points closer than `tolerance` to the outline without them (Douglas and Peucker 1973). */
export function simplify(polygon, tolerance) {
  if (polygon.length < 8) return polygon;
  const simple = thinned([...polygon, polygon[0]], tolerance);
  return simple.length >= 3 ? simple : polygon;
}

/** The points of a line that matter, without its last. */
function thinned(line, tolerance) {
  const gaps = line.map((point) => distance(point, nearestOnSegment(point, line[0], line.at(-1))));
  const largest = Math.max(...gaps);
  if (largest <= tolerance) return [line[0]];
  const index = gaps.indexOf(largest);
  return [...thinned(line.slice(0, index + 1), tolerance), ...thinned(line.slice(index), tolerance)];
}
