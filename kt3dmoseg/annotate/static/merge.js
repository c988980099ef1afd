// Merging two documents that were made from the same saved one. Nothing that either side drew is lost.

import { nextId } from "./edits.js";

const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);

/** Objects changed on one side only are taken from there; changed on both, both are kept. */
export function merge(base, mine, theirs) {
  const byId = (doc) => new Map(doc.objects.map((item) => [item.id, item]));
  const [old, my, their] = [byId(base), byId(mine), byId(theirs)];
  const merged = { ...mine, revision: theirs.revision, objects: [], marks: mergeMarks(base, mine, theirs) };
  const doubles = [];
  for (const id of new Set([...their.keys(), ...my.keys()])) {
    const [o, m, t] = [old.get(id), my.get(id), their.get(id)];
    if (same(m, o) || same(m, t)) {
      if (t) merged.objects.push(t);
    } else if (same(t, o)) {
      if (m) merged.objects.push(m);
    } else {
      if (m) merged.objects.push(m);
      if (t) (m ? doubles : merged.objects).push(t);
    }
  }
  for (const item of doubles) {
    merged.objects.push({ ...item, id: nextId(merged), name: `${item.name} (other)` });
  }
  return merged;
}

function mergeMarks(base, mine, theirs) {
  const text = (doc) => new Set((doc.marks ?? []).map((mark) => JSON.stringify(mark)));
  const [old, my, their] = [text(base), text(mine), text(theirs)];
  const all = new Set([...their, ...my]);
  return [...all].filter((mark) => !old.has(mark) || (my.has(mark) && their.has(mark))).map((mark) => JSON.parse(mark));
}
