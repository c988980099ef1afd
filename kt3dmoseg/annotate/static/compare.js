// This annotation against the other annotator's.

import * as actions from "./actions.js";
import * as api from "./api.js";
import { button, close, open, row, table } from "./dialog.js";
import { element } from "./dom.js";

const percent = (share) => `${(100 * share).toFixed(2)} %`;

export async function compare(app) {
  if (!app.state.clip.compare) {
    return open("Compare", element("p", {}, "Start kt3dmoseg label with --compare FOLDER, the folder of the other annotator's files."),
      row(button("Close", close)));
  }
  try {
    show(app, await api.compare(app.state.clip.name, app.state.doc));
  } catch (error) {
    open("Compare", element("p", {}, error.message), row(button("Close", close)));
  }
  return undefined;
}

function show(app, found) {
  const summary = `Same label for ${percent(found.agreement)} of ${found.trajectories} trajectories, `
    + `${percent(found.both)} of those that both labelled; Cohen's kappa ${found.kappa.toFixed(3)}. ${found.different || "None"} differ${found.different ? ":" : "."}`;
  const rows = found.differences.map((d) => [
    button(`${d.row}`, () => {
      close();
      actions.show(app, d.row, d.frame);
    }), `${d.frame}`, d.xy.map((v) => v.toFixed(0)).join(", "), d.mine, d.theirs,
  ]);
  const differences = rows.length ? [table(["trajectory", "frame", "at", "here", "other"], rows)] : [];
  open("Two annotators", element("p", {}, summary), ...differences, row(button("Close", close)));
}
