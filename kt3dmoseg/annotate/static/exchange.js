// What comes from elsewhere: proposed regions, files of other tools, the other annotator's annotation.

import { redraw, setTool } from "./actions.js";
import { ORIGIN, addObject, boundsOf, changeObject, nextMotion, objectOf } from "./annotation.js";
import { ask, request } from "./saving.js";
import { button, byId, close, download, element, faint, fill, open, paragraph, row, table } from "./dom.js";
import { edit, editLast, editable, on, regionOf, set, state } from "./state.js";
import { goTo, showBox } from "./view.js";

const NAMES = {
  cvat: "CVAT for video 1.1 (XML)", davis: "DAVIS indexed PNG (zip)", mots_txt: "KITTI MOTS (text)",
  mots_png: "KITTI MOTS PNG (zip)", coco: "COCO with RLE masks (JSON)", labelme: "LabelMe (zip)",
};
const MEANING = { // in the order of the dialogue: the best first
  mseg: "rigid bodies that move by themselves, the surest first; takes some seconds",
  built: "what kt3dmoseg build --propose found",
  tracklets: "KITTI's 3D boxes, projected into the frames",
  masks: "masks from a folder",
};

const inform = (title, text, ...more) => open(title, paragraph(text), ...more, row(button("Close", close)));

/** Post what takes long, show for how long, with a way to cancel; `show` gets the answer. */
async function work(title, text, what, body, show, failed = (message) => inform(title, message)) {
  const controller = new AbortController();
  const { signal } = controller;
  const seconds = element("span");
  const begun = performance.now();
  const timer = setInterval(() => (seconds.textContent = ` ${Math.round((performance.now() - begun) / 1000)} s`), 500);
  open(title, element("p", { role: "status" }, text, seconds), row(button("Cancel", close)));
  byId("dialog").onclose = () => (controller.abort(), byId("stage").focus());
  try {
    const found = await ask(state.clip.name, what, body, { signal });
    if (!signal.aborted) show(found);
  } catch (error) {
    if (!signal.aborted) failed(error.message);
  } finally {
    clearInterval(timer);
  }
}

/** A strip over the frame with buttons, or none. */
function strip(id, text, ...buttons) {
  byId(id).hidden = !text;
  fill(byId(id), element("span", {}, text), ...buttons);
}

// Proposals: a person accepts, corrects or rejects each

export function propose() {
  const { proposers } = state.clip;
  const names = Object.keys({ ...MEANING, ...proposers }).filter((name) => name in proposers);
  const choices = names.map((name) => {
    const lacking = proposers[name];
    const meaning = MEANING[name] ?? "a method of an installed package";
    return [button(name, () => start(name), "", { disabled: Boolean(lacking) }),
      faint(lacking ? `${meaning}: ${lacking}` : meaning)];
  });
  open("Propose regions from", table(choices), row(button("Cancel", close)));
}

const start = (proposer) =>
  work("Propose regions", `Asking ${proposer}…`, `proposals/${proposer}`, state.doc, ({ objects }) => {
    if (!objects.length) return inform("Propose regions", `${proposer} found nothing that moves.`);
    set({ proposals: objects, compared: null });
    return review(0);
  }, (message) => inform("No proposals", message));

/** Show what was proposed while the clip was built, where nobody has drawn anything yet. */
export function proposeBuilt(clip) {
  const untouched = clip === state.clip && !state.doc.revision && !state.doc.objects.length && !state.pending
    && !byId("dialog").open;
  if (untouched && clip.proposers.built === "") start("built");
}

function review(at) {
  close();
  const { proposals } = state;
  if (!proposals?.length) return leave();
  const index = (at + proposals.length) % proposals.length;
  const item = proposals[index];
  const { frame, polygons } = item.key_frames.find((key) => key.polygons.length);
  goTo(frame);
  set({ review: { item, index }, selected: null, vertex: null }); // keys would change one accepted before
  return showBox(boundsOf(polygons));
}

/** Go to the next proposal; whether one is in view. */
export function skip() {
  if (state.review?.item) review(state.review.index + 1);
  return Boolean(state.review?.item);
}

/** Take the proposal in view out of the list; an accepted one becomes an object. */
function settle(accepted) {
  const { doc, proposals, review: { item } } = state;
  set({ proposals: proposals.filter((other) => other !== item) });
  if (accepted) editLast(addObject(doc, { ...item, motion: item.motion === "reject" ? "reject" : nextMotion(doc) }));
}

/** Wait until a person has put the accepted proposal right. */
function correct() {
  const { item, index } = state.review;
  settle(true);
  set({ review: { item: null, name: item.name, index } });
  byId("stage").focus();
}

/** End looking at proposals and at differences. */
function leave() {
  close();
  set({ proposals: null, review: null, compared: null, cross: null });
  byId("stage").focus();
}

function drawReview() {
  if (!state.review) return strip("review", "");
  const { item, name, index } = state.review;
  const left = state.proposals?.length;
  if (!item) {
    const text = left ? `Go on (${left} left)` : "Done";
    return strip("review", `${name} is an object now: correct it, then`, button(text, () => review(index), "primary"));
  }
  // Enter that is held down, or comes before the next one is drawn, would accept what nobody has seen.
  const accept = () => state.review?.item === item && (settle(true), review(index));
  const unseen = (event) => !event.repeat; // false: the key does nothing
  const first = button("Accept", accept, "primary", { onkeydown: unseen });
  strip("review", `${item.name}: ${index + 1} of ${left} proposed`, first, button("Skip ( ] )", skip),
    button("Correct", correct), button("Reject", () => (settle(false), review(index))), button("Done", leave));
  return first.focus();
}

// Files

export function exchange() {
  const rows = Object.entries(state.clip.formats).map(([name, suffix]) => {
    const load = () => file.files.length && read(name, file.files[0]);
    const file = element("input", { type: "file", accept: suffix, hidden: true, onchange: load });
    const choose = element("span", {}, button("Import…", () => file.click()), file);
    return [NAMES[name] ?? name, button("Export", () => write(name, suffix)), choose];
  });
  open("Files of other tools", paragraph(faint("What an import does is shown before anything changes.")), table(rows),
    row(button("Close", close)));
}

async function write(format, suffix) {
  const { clip, doc } = state;
  try {
    const answer = await request(clip.name, `export/${format}`, doc);
    download(await answer.blob(), `${clip.name}_${format}${suffix}`);
  } catch (error) {
    inform("Not exported", error.message);
  }
}

/** Ask the server what an import does; a person then decides. */
function read(format, file, choices = {}) {
  const what = `import/${format}?${new URLSearchParams(choices)}`;
  const [shift, scale] = [["frames later", "1"], ["scale", "any"]].map(([name, step]) =>
    element("input", { type: "number", step, "aria-label": name, size: 6 }));
  const reread = button("Read again", () => read(format, file, { shift: shift.value, scale: scale.value }));
  const again = row("Frames later by", shift, "coordinates times", scale, reread);
  return work("Import", `Reading ${file.name}…`, what, file, (found) => decide(found, again),
    (message) => inform("Not imported", message, again));
}

/** Ask what becomes of an import; what was drawn or saved since is asked about again. */
function decide(found, again, more = []) {
  const { doc } = state;
  const { objects, plan } = found;
  const afresh = () => decide(found, again, ["what is drawn has changed meanwhile: choose again"]);
  const settled = (text, change, className) =>
    button(text, () => (doc === state.doc ? (close(), editLast(change())) : afresh()), className);
  const used = nextMotion(doc) - 1;
  const ownMotion = (item) => ({ ...item, motion: item.motion >= 1 ? item.motion + used : item.motion });
  const add = () => objects.map(ownMotion).reduce(addObject, doc);
  const replace = () => {
    set({ unseen: new Set(), locked: new Set(), carried: { objects: [] } }); // by their numbers, which others have now
    return { ...doc, objects, marks: [] };
  };
  const drawn = doc.objects.length + (doc.marks?.length ?? 0);
  const choose = drawn
    ? [settled("Add to what is drawn", add, "primary"), settled(`Replace what is drawn (${drawn})`, replace)]
    : [settled("Import", replace, "primary")];
  open(plan.doubts.length ? "Import: please check" : "Import",
    element("ul", { className: "scroll" }, [...more, ...plan.lines].map((text) => element("li", {}, text))), again,
    row(...choose, button("Cancel", close), faint("One edit: Ctrl+Z undoes it.")));
}

// Two annotators

const HEADS = ["object", "IoU", "trajectories", ""];
const percent = (share) => `${(100 * share).toFixed(2)} %`;

/** How far both annotators agree, and each object on which they do not, in its place. */
export function compare() {
  if (!state.clip.compare) {
    return inform("Compare", "Start kt3dmoseg label with --compare FOLDER, the folder of the other annotator's files.");
  }
  return work("Two annotators", "Comparing…", "compare", state.doc, (found) => {
    const origins = found.objects.map(({ first_id: mine }) => objectOf(state.doc, mine)?.[ORIGIN]);
    set({ compared: { ...found, origins, at: null, settled: [] }, proposals: null, review: null });
    list();
  });
}

function list() {
  const { agreement, trajectories, both, kappa, different, objects } = state.compared;
  const mean = objects.reduce((sum, { iou }) => sum + iou, 0) / (objects.length || 1);
  const summary = `Same label for ${percent(agreement)} of ${trajectories} trajectories, `
    + `${percent(both)} of those that both labelled; ${different} differ. Cohen's kappa ${kappa.toFixed(3)}, `
    + `mean IoU of the objects ${mean.toFixed(3)}.`;
  const rows = objects.map(({ verdict, iou, different: count }, k) =>
    [button(verdict, () => visit(k)), iou.toFixed(2), count, settledAs(k)]);
  open("Two annotators", paragraph(summary),
    element("div", { className: "scroll" }, rows.length ? table(rows, HEADS) : []), row(button("Close", leave),
      faint("Choose an object to see both outlines and decide; ↑ ↓ walk the list, Shift+G goes to the next.")));
}

/** My object of a difference, in a document; none when another one has taken its id. */
function ownOf(index, doc) {
  const { objects, origins } = state.compared;
  const own = objectOf(doc, objects[index].first_id);
  return own && own[ORIGIN] === origins[index] ? own : null;
}

/** Show an object in the frame in which both differ most, with the other annotator's outline. */
function visit(index) {
  close();
  const { compared, doc } = state;
  const at = (index + compared.objects.length) % compared.objects.length;
  const { second_id: theirs, frame } = compared.objects[at];
  const own = ownOf(at, doc);
  set({ compared: { ...compared, at }, selected: own?.id ?? null });
  goTo(frame);
  const both = [own && regionOf(own, frame), compared.regions[theirs]?.[frame]].filter(Boolean);
  const box = boundsOf(both.flatMap((region) => region.polygons));
  if (box) showBox(box);
}

export const nextDifference = () =>
  (state.compared?.objects.length ? visit((state.compared.at ?? -1) + 1) : compare());

/** The document with their object in the place of mine, under my motions; without mine where they have none. */
function withTheirs(own, { second_id: theirs, motion }) {
  const { doc, compared } = state;
  if (theirs === null) return { ...doc, objects: doc.objects.filter((item) => item !== own) };
  const { kind, key_frames, motion: number, ...other } = compared.theirs.find((item) => item.id === theirs);
  // Two objects of one motion stay of one.
  const keys = compared.theirs.filter((item) => item.motion === number).flatMap((item) => item.key_frames);
  const same = doc.objects.find((item) => item.key_frames.some((key) => keys.includes(key)));
  const taken = { kind, key_frames: [...key_frames], motion: motion ?? same?.motion ?? nextMotion(doc) };
  return own ? changeObject(doc, own.id, taken) : addObject(doc, { ...other, ...taken });
}

// What was taken from the other annotator, kept in the document: undo takes it back, a merge carries it.
const TAKEN = Symbol("taken");

/** What was decided about an object. */
function settledAs(k) {
  const { objects, settled } = state.compared;
  return settled[k] ?? (state.doc[TAKEN]?.has(objects[k]) ? "theirs" : "");
}

/** Keep what was decided about the object in view, and go on to the next that is open. */
function conclude(how, change) {
  const { compared, doc } = state;
  const taken = new Set([...doc[TAKEN] ?? [], compared.objects[compared.at]]);
  if (change) edit({ ...change(), [TAKEN]: taken });
  const settled = Object.assign([...compared.settled], { [compared.at]: change ? undefined : how });
  set({ compared: { ...compared, settled } });
  const open = compared.objects.findIndex((_, k) => k > compared.at && !settledAs(k));
  if (how === "redraw") byId("stage").focus();
  else if (open < 0) list();
  else visit(open);
}

/** Take theirs; what is locked stays. */
function takeTheirs(here) {
  const own = ownOf(state.compared.at, state.doc);
  if (own && !editable(own)) return;
  conclude("theirs", () => withTheirs(own, here));
}

function redrawThis() {
  const own = ownOf(state.compared.at, state.doc);
  conclude("redraw");
  if (own) redraw("region");
  else setTool("draw");
}

let shownAs = "";

function drawDifference(focus = true) {
  const { at, objects } = state.compared ?? {};
  const here = objects?.[at];
  if (!here) return strip("differences", "");
  const next = button("Next", () => visit(at + 1));
  const theirs = here.second_id === null ? "Delete, as theirs" : "Take theirs";
  strip("differences", `${at + 1} of ${objects.length}: ${here.verdict}, IoU ${here.iou.toFixed(2)}`
    + (settledAs(at) && ` (${settledAs(at)})`),
  settledAs(at) === "theirs" ? faint("Ctrl+Z takes it back") : button(theirs, () => takeTheirs(here)),
  button(here.first_id === null ? "Leave out" : "Keep mine", () => conclude("mine")),
  button("Redraw", redrawThis), next, button("List", list), button("Compare again", compare),
  button("Done", leave));
  shownAs = settledAs(at);
  return !focus || shownAs === "redraw" || next.focus();
}

on(["review", "proposals"], drawReview);
on(["compared"], () => drawDifference());
on(["doc"], () => state.compared?.objects[state.compared.at] && settledAs(state.compared.at) !== shownAs && drawDifference(false));
