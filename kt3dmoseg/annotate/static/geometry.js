// Plane geometry in pixels.

/** Even-odd rule. */
export function inside([x, y], polygon) {
  let odd = false;
  for (let i = 0, j = polygon.length - 1; i < polygon.length; j = i++) {
    const [ax, ay] = polygon[i];
    const [bx, by] = polygon[j];
    if (ay > y !== by > y && x < ax + ((y - ay) * (bx - ax)) / (by - ay)) odd = !odd;
  }
  return odd;
}

export const distance = ([ax, ay], [bx, by]) => Math.hypot(ax - bx, ay - by);

export const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

/** The point of segment ab nearest to p. */
function nearestOnSegment(p, a, b) {
  const [dx, dy] = [b[0] - a[0], b[1] - a[1]];
  const share = ((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / (dx * dx + dy * dy || 1);
  const t = clamp(share, 0, 1);
  return [a[0] + t * dx, a[1] + t * dy];
}

export const nearestVertex = (p, polygons, reach) =>
  nearest(p, polygons, reach, (vertex, _, index) => ({ point: vertex, index }));

/** The edge near p, as the index at which a new vertex would go. */
export const nearestEdge = (p, polygons, reach) =>
  nearest(p, polygons, reach, (a, b, index) => ({ point: nearestOnSegment(p, a, b), index: index + 1 }));

function nearest(p, polygons, reach, candidate) {
  let best = null;
  polygons.forEach((polygon, part) => polygon.forEach((vertex, i) => {
    const { point, index } = candidate(vertex, polygon[(i + 1) % polygon.length], i);
    const gap = distance(p, point);
    if (gap <= (best?.gap ?? reach)) best = { part, index, gap, point };
  }));
  return best;
}

export function boundsOf(polygons) {
  const points = polygons.flat();
  if (!points.length) return null;
  const xs = points.map((p) => p[0]);
  const ys = points.map((p) => p[1]);
  return [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
}

/** Leave out points closer than `tolerance` to the outline without them (Douglas and Peucker 1973). */
export function simplify(polygon, tolerance) {
  if (polygon.length < 8) return polygon;
  const closed = [...polygon, polygon[0]];
  const middle = farthest(closed, () => polygon[0]).index;
  const halves = [closed.slice(0, middle + 1), closed.slice(middle)];
  const simple = halves.flatMap((half) => thinned(half, tolerance));
  return simple.length >= 3 ? simple : polygon;
}

/** The points of a line that matter, without its last. */
function thinned(line, tolerance) {
  const [first, last] = [line[0], line.at(-1)];
  const { index, gap } = farthest(line, (p) => nearestOnSegment(p, first, last));
  if (gap <= tolerance) return [first];
  return [...thinned(line.slice(0, index + 1), tolerance), ...thinned(line.slice(index), tolerance)];
}

/** The inner point of a line that is farthest from its reference. */
function farthest(line, reference) {
  let worst = { index: 0, gap: -1 };
  for (let index = 1; index < line.length - 1; index++) {
    const gap = distance(line[index], reference(line[index]));
    if (gap > worst.gap) worst = { index, gap };
  }
  return worst;
}

export const rounded = (polygon) => polygon.map(([x, y]) => [Math.round(x * 100) / 100, Math.round(y * 100) / 100]);
