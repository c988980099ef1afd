// This annotation against the other annotator's: how far both agree, and each difference in its place.

import * as actions from "./actions.js";
import * as api from "./api.js";
import { button, close, open, row, table } from "./dialog.js";
import { element, fill } from "./dom.js";

const percent = (share) => `${(100 * share).toFixed(2)} %`;

export async function compare(app) {
  if (!app.state.clip.compare) {
    return open("Compare", element("p", {}, "Start kt3dmoseg label with --compare FOLDER, the folder of the other annotator's files."),
      row(button("Close", close)));
  }
  open("Two annotators", element("p", {}, "Comparing…"));
  try {
    const found = await api.compare(app.state.clip.name, app.state.doc);
    app.state.set({ compared: { ...found, at: null }, proposals: null, review: null });
    list(app);
  } catch (error) {
    open("Compare", element("p", {}, error.message), row(button("Close", close)));
  }
  return undefined;
}

function list(app) {
  const found = app.state.compared;
  const summary = `Same label for ${percent(found.agreement)} of ${found.trajectories} trajectories, `
    + `${percent(found.both)} of those that both labelled. Cohen's kappa ${found.kappa.toFixed(3)}. `
    + (found.different ? `${found.different} differ:` : "None differs.");
  const rows = found.differences.map((d, k) => [
    button(`${d.row}`, () => visit(app, k)), `${d.frame}`, d.xy.map((v) => v.toFixed(0)).join(", "), d.mine, d.theirs,
  ]);
  const differences = rows.length ? [table(["trajectory", "frame", "at", "here", "other"], rows)] : [];
  open("Two annotators", element("p", {}, summary), ...differences,
    row(button("Close", () => leave(app)), element("span", { className: "faint" }, rows.length
      ? "Choose one to see it with the other annotator's outlines; ↑ ↓ walk the list, Shift+G goes on from one to the next." : "")));
}

/** Show one difference in its place, and the other annotator's regions around it. */
function visit(app, at) {
  close();
  const { compared } = app.state;
  const index = (at + compared.differences.length) % compared.differences.length;
  app.state.set({ compared: { ...compared, at: index } });
  const { row: track, frame } = compared.differences[index];
  actions.show(app, track, frame);
}

export function nextDifference(app) {
  const { compared } = app.state;
  if (!compared?.differences.length) return compare(app);
  return visit(app, (compared.at ?? -1) + 1);
}

function leave(app) {
  close();
  app.state.set({ compared: null, cross: null });
}

export function watchCompare(app, root) {
  app.state.on(["compared"], ({ compared }) => {
    const here = compared?.differences[compared.at];
    root.hidden = !here;
    if (!here) return;
    const on = button("Next", () => visit(app, compared.at + 1), "primary");
    fill(root, element("span", {}, `${compared.at + 1} of ${compared.differences.length}: here ${here.mine}, other ${here.theirs}`),
      on, button("Previous", () => visit(app, compared.at - 1)), button("List", () => list(app)),
      button("Compare again", () => compare(app)), button("Done", () => leave(app)));
    on.focus();
  });
}
