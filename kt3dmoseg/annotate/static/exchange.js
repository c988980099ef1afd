// What comes from elsewhere: proposed regions, files of other tools, the other annotator's annotation.

import { addObject, nextMotion } from "./annotation.js";
import * as api from "./api.js";
import { button, byId, close, download, element, faint, inform, line, open, row, strip, table, working } from "./dom.js";
import { boundsOf } from "./geometry.js";
import { edit, on, set, state } from "./state.js";
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
};

// Proposals: a person accepts, corrects or rejects each

export function propose() {
  const choices = Object.entries(state.clip.proposers).map(([name, lacking]) => {
    const meaning = MEANING[name] ?? "a method of an installed package";
    const choice = element("button", { disabled: Boolean(lacking), onclick: () => request(name) }, name);
    return line([choice, faint(lacking ? `${meaning}: ${lacking}` : meaning)]);
  });
  open("Propose regions from", element("table", {}, choices), row(button("Cancel", close)));
}

async function request(proposer) {
  try {
    const found = await working("Propose regions", `Asking ${proposer}…`,
      (signal) => api.post(state.clip.name, `proposals/${proposer}`, state.doc, signal));
    if (!found) return undefined;
    const { objects } = found;
    if (!objects.length) return inform("Propose regions", `${proposer} found nothing that moves.`);
    set({ proposals: objects, compared: null });
    review(0);
  } catch (error) {
    inform("No proposals", error.message);
  }
  return undefined;
}

/** Show the proposals one by one on the frame. */
function review(at) {
  close();
  const { proposals } = state;
  if (!proposals?.length) {
    end();
    return;
  }
  const index = (at + proposals.length) % proposals.length;
  const item = proposals[index];
  const key = item.key_frames.find((k) => k.polygons.length);
  goTo(key.frame);
  set({ review: { item, index } });
  showBox(boundsOf(key.polygons));
}

/** Take the proposal in view out of the list. */
function settle() {
  const { proposals, review: { item } } = state;
  set({ proposals: proposals.filter((other) => other !== item) });
}

/** The same, and make it an object. */
function accept() {
  const { doc, review: { item } } = state;
  settle();
  edit(addObject(doc, { ...item, motion: item.motion === "reject" ? "reject" : nextMotion(doc) }));
  set({ selected: state.doc.objects.at(-1).id });
}

/** Wait until a person has put the accepted proposal right. */
function correct() {
  const { item, index } = state.review;
  accept();
  set({ review: { item: null, name: item.name, index } });
  byId("stage").focus();
}

function end() {
  set({ proposals: null, review: null });
  byId("stage").focus();
}

function drawReview() {
  const { item, name, index } = state.review ?? {};
  const left = state.proposals?.length;
  if (!state.review) strip("review", "");
  else if (!item) {
    const on = button(left ? `Go on (${left} left)` : "Done", () => review(index), "primary");
    strip("review", `${name} is an object now: correct it, then`, on);
  } else {
    const first = button("Accept", () => (accept(), review(index)), "primary");
    strip("review", `${item.name}: ${index + 1} of ${left} proposed`, first, button("Correct", correct),
      button("Reject", () => (settle(), review(index))), button("Skip", () => review(index + 1)), button("Done", end));
    first.focus();
  }
}

// Files

/** Import and export. */
export function exchange() {
  const rows = Object.entries(state.clip.formats).map(([name, suffix]) => {
    const load = () => read(name, file.files[0]);
    const file = element("input", { type: "file", accept: suffix, hidden: true, onchange: load });
    const choose = element("span", {}, button("Import…", () => file.click()), file);
    return line([NAMES[name] ?? name, button("Export", () => write(name, suffix)), choose]);
  });
  open("Files of other tools",
    element("p", {}, faint("What an import does is shown before anything changes.")),
    element("table", {}, rows), row(button("Close", close)));
}

async function write(format, suffix) {
  try {
    const content = await api.exportAs(state.clip.name, format, state.doc);
    download(content, `${state.clip.name}_${format}${suffix}`);
  } catch (error) {
    inform("Not exported", error.message);
  }
}

/** Ask the server what an import does; a person then decides. */
async function read(format, file, choices = {}) {
  if (!file) return;
  try {
    const found = await working("Import", `Reading ${file.name}…`, (signal) =>
      api.post(state.clip.name, `import/${format}?${new URLSearchParams(choices)}`, file, signal));
    if (found) decide(format, file, found);
  } catch (error) {
    open("Not imported", element("p", {}, error.message), ...again(format, file), row(button("Close", close)));
  }
}

/** Frames and size as a person corrects them. */
function again(format, file) {
  const field = (name, step) => element("input", { type: "number", step, "aria-label": name, size: 6 });
  const [shift, scale] = [field("frames later", "1"), field("scale", "any")];
  const reread = () => read(format, file, { shift: shift.value, scale: scale.value });
  return [row("Frames later by", shift, "coordinates times", scale, button("Read again", reread))];
}

function decide(format, file, { objects, plan }) {
  const { doc } = state;
  const settle = (edited) => {
    close();
    edit(edited);
    set({ selected: edited.objects.at(-1)?.id ?? null });
  };
  const used = nextMotion(doc) - 1;
  const ownMotion = (item) => ({ ...item, motion: item.motion >= 1 ? item.motion + used : item.motion });
  const add = () => settle(objects.map(ownMotion).reduce(addObject, doc));
  const replace = () => settle({ ...doc, objects, marks: [] });
  const drawn = doc.objects.length + (doc.marks?.length ?? 0);
  const choose = drawn
    ? [button("Add to what is drawn", add, "primary"), button(`Replace what is drawn (${drawn})`, replace)]
    : [button("Import", replace, "primary")];
  open(plan.doubts.length ? "Import: please check" : "Import",
    element("ul", { className: "scroll" }, plan.lines.map((text) => element("li", {}, text))),
    ...again(format, file), row(...choose, button("Cancel", close), faint("One edit: Ctrl+Z undoes it.")));
}

// Two annotators

const percent = (share) => `${(100 * share).toFixed(2)} %`;

/** How far both annotators agree, and each difference in its place. */
export async function compare() {
  if (!state.clip.compare) {
    return inform("Compare", "Start kt3dmoseg label with --compare FOLDER, the folder of the other annotator's files.");
  }
  try {
    const found = await working("Two annotators", "Comparing…",
      (signal) => api.post(state.clip.name, "compare", state.doc, signal));
    if (!found) return undefined;
    set({ compared: { ...found, at: null }, proposals: null, review: null });
    list();
  } catch (error) {
    inform("Compare", error.message);
  }
  return undefined;
}

function list() {
  const { agreement, trajectories, both, kappa, different, differences } = state.compared;
  const summary = `Same label for ${percent(agreement)} of ${trajectories} trajectories, `
    + `${percent(both)} of those that both labelled. Cohen's kappa ${kappa.toFixed(3)}. `
    + (different ? `${different} differ:` : "None differs.");
  const rows = differences.map((d, k) =>
    [button(`${d.row}`, () => visit(k)), d.frame, d.xy.map((v) => v.toFixed(0)).join(", "), d.mine, d.theirs]);
  const help = "Choose one to see it with the other annotator's outlines; ↑ ↓ walk the list, "
    + "Shift+G goes on from one to the next.";
  open("Two annotators", element("p", {}, summary),
    ...(rows.length ? [table(["trajectory", "frame", "at", "here", "other"], rows)] : []),
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

export function nextDifference() {
  const { compared } = state;
  if (!compared?.differences.length) return compare();
  return visit((compared.at ?? -1) + 1);
}

function leave() {
  close();
  set({ compared: null, cross: null });
}

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
