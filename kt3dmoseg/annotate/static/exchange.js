// What comes from elsewhere: files of other tools, and the other annotator's annotation.

import * as api from "./api.js";
import { button, byId, close, element, faint, fill, inform, line, open, row, table } from "./dom.js";
import { edit, on, set, state } from "./state.js";
import { showTrack } from "./view.js";

const NAMES = {
  cvat: "CVAT for video 1.1 (XML)", davis: "DAVIS indexed PNG (zip)", mots_txt: "KITTI MOTS (text)",
  mots_png: "KITTI MOTS PNG (zip)", coco: "COCO with RLE masks (JSON)", labelme: "LabelMe (zip)",
};

/** Import and export. */
export function exchange() {
  const rows = Object.entries(state.clip.formats).map(([name, suffix]) => {
    const file = element("input", { type: "file", accept: suffix, hidden: true, onchange: () => read(name, file.files[0]) });
    const choose = element("span", {}, button("Import…", () => file.click()), file);
    return line([NAMES[name] ?? name, button("Export", () => write(name, suffix)), choose]);
  });
  open("Files of other tools", element("p", {}, faint("An import replaces what is drawn, as one edit that Ctrl+Z takes back.")),
    element("table", {}, rows), row(button("Close", close)));
}

async function write(format, suffix) {
  try {
    const content = await api.exportAs(state.clip.name, format, state.doc);
    const link = element("a", { href: URL.createObjectURL(content), download: `${state.clip.name}_${format}${suffix}` });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  } catch (error) {
    inform("Not exported", error.message);
  }
}

async function read(format, file) {
  if (!file) return;
  try {
    const { objects, marks } = await api.importFrom(state.clip.name, format, file);
    edit({ ...state.doc, objects, marks });
    close();
    set({ selected: objects[0]?.id ?? null });
  } catch (error) {
    inform("Not imported", error.message);
  }
}

const percent = (share) => `${(100 * share).toFixed(2)} %`;

/** How far both annotators agree, and each difference in its place. */
export async function compare() {
  if (!state.clip.compare) {
    return inform("Compare", "Start kt3dmoseg label with --compare FOLDER, the folder of the other annotator's files.");
  }
  open("Two annotators", element("p", {}, "Comparing…"));
  try {
    const found = await api.compare(state.clip.name, state.doc);
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
  const help = rows.length
    ? "Choose one to see it with the other annotator's outlines; ↑ ↓ walk the list, Shift+G goes on from one to the next." : "";
  open("Two annotators", element("p", {}, summary),
    ...(rows.length ? [table(["trajectory", "frame", "at", "here", "other"], rows)] : []),
    row(button("Close", leave), faint(help)));
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

function drawStrip() {
  const { at, differences } = state.compared ?? {};
  const here = differences?.[at];
  const root = byId("differences");
  root.hidden = !here;
  if (!here) return;
  const next = button("Next", () => visit(at + 1), "primary");
  fill(root, element("span", {}, `${at + 1} of ${differences.length}: here ${here.mine}, other ${here.theirs}`), next,
    button("Previous", () => visit(at - 1)), button("List", list), button("Compare again", compare), button("Done", leave));
  next.focus();
}

on(["compared"], drawStrip);
