// What comes from elsewhere: proposed regions, files of other tools, the other annotator's annotation.

import { addObject, boundsOf, nextMotion } from "./annotation.js";
import { ask, request } from "./api.js";
import { button, byId, close, download, element, faint, fill, open, paragraph, row, table } from "./dom.js";
import { editLast, on, set, state } from "./state.js";
import { showTrack } from "./tracks.js";
import { goTo, showBox } from "./view.js";

const NAMES = {
  cvat: "CVAT for video 1.1 (XML)", davis: "DAVIS indexed PNG (zip)", mots_txt: "KITTI MOTS (text)",
  mots_png: "KITTI MOTS PNG (zip)", coco: "COCO with RLE masks (JSON)", labelme: "LabelMe (zip)",
};
const MEANING = {
  residual: "what does not move with the static scene, from the trajectories",
  tracklets: "KITTI's 3D boxes, projected into the frames",
  masks: "masks from a folder",
  mseg: "the clusters of a motion segmentation; takes some 20 seconds",
  built: "what kt3dmoseg build --propose found",
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
  const choices = Object.entries(state.clip.proposers).map(([name, lacking]) => {
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
  const untouched = clip === state.clip && !state.doc.revision && !state.doc.objects.length && !byId("dialog").open;
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
  set({ review: { item, index } });
  return showBox(boundsOf(polygons));
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
  const first = button("Accept", () => (settle(true), review(index)), "primary");
  strip("review", `${item.name}: ${index + 1} of ${left} proposed`, first, button("Correct", correct),
    button("Reject", () => (settle(false), review(index))), button("Skip", () => review(index + 1)),
    button("Done", leave));
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

function decide({ objects, plan }, again) {
  const { doc } = state;
  const settled = (text, change, className) => button(text, () => (close(), editLast(change())), className);
  const used = nextMotion(doc) - 1;
  const ownMotion = (item) => ({ ...item, motion: item.motion >= 1 ? item.motion + used : item.motion });
  const add = () => objects.map(ownMotion).reduce(addObject, doc);
  const replace = () => ({ ...doc, objects, marks: [] });
  const drawn = doc.objects.length + (doc.marks?.length ?? 0);
  const choose = drawn
    ? [settled("Add to what is drawn", add, "primary"), settled(`Replace what is drawn (${drawn})`, replace)]
    : [settled("Import", replace, "primary")];
  open(plan.doubts.length ? "Import: please check" : "Import",
    element("ul", { className: "scroll" }, plan.lines.map((text) => element("li", {}, text))), again,
    row(...choose, button("Cancel", close), faint("One edit: Ctrl+Z undoes it.")));
}

// Two annotators

const DIFFERENCE = ["trajectory", "frame", "at", "here", "other"];
const percent = (share) => `${(100 * share).toFixed(2)} %`;

/** How far both annotators agree, and each difference in its place. */
export function compare() {
  if (!state.clip.compare) {
    return inform("Compare", "Start kt3dmoseg label with --compare FOLDER, the folder of the other annotator's files.");
  }
  return work("Two annotators", "Comparing…", "compare", state.doc, (found) => {
    set({ compared: { ...found, at: null }, proposals: null, review: null });
    list();
  });
}

function list() {
  const { agreement, trajectories, both, kappa, different, differences } = state.compared;
  const summary = `Same label for ${percent(agreement)} of ${trajectories} trajectories, `
    + `${percent(both)} of those that both labelled. Cohen's kappa ${kappa.toFixed(3)}. `
    + (different ? `${different} differ:` : "None differs.");
  const rows = differences.map(({ row: track, frame, xy, mine, theirs }, k) =>
    [button(`${track}`, () => visit(k)), frame, xy.map((v) => v.toFixed(0)).join(", "), mine, theirs]);
  const help = "Choose one to see it with the other annotator's outlines; ↑ ↓ walk the list, "
    + "Shift+G goes on from one to the next.";
  open("Two annotators", paragraph(summary),
    element("div", { className: "scroll" }, rows.length ? table(rows, DIFFERENCE) : []),
    row(button("Close", leave), faint(rows.length ? help : "")));
}

/** Show one difference in its place, and the other annotator's regions around it. */
function visit(index) {
  close();
  const { compared } = state;
  const at = (index + compared.differences.length) % compared.differences.length;
  set({ compared: { ...compared, at } });
  showTrack(compared.differences[at].row, compared.differences[at].frame);
}

export const nextDifference = () =>
  (state.compared?.differences.length ? visit((state.compared.at ?? -1) + 1) : compare());

function drawDifference() {
  const { at, differences } = state.compared ?? {};
  const here = differences?.[at];
  if (!here) return strip("differences", "");
  const next = button("Next", () => visit(at + 1), "primary");
  strip("differences", `${at + 1} of ${differences.length}: here ${here.mine}, other ${here.theirs}`, next,
    button("Previous", () => visit(at - 1)), button("List", list), button("Compare again", compare),
    button("Done", leave));
  return next.focus();
}

on(["review", "proposals"], drawReview);
on(["compared"], drawDifference);
