// All clips and how far each is.

import * as api from "./api.js";
import { close, open, table } from "./dialog.js";
import { element } from "./dom.js";

export async function clips(app) {
  const found = await api.listClips();
  const rows = found.map((clip) => {
    const here = clip.name === app.state.clip?.name;
    const go = element("button", { className: here ? "on" : "", autofocus: here, onclick: () => {
      close();
      app.open(clip.name);
    } }, clip.name);
    return [go, `${clip.n_frames}`, `${clip.objects ?? ""}`, `${clip.motions ?? ""}`, ...progress(clip),
      clip.revision ? `rev ${clip.revision}` : "", clip.annotator ?? ""];
  });
  const done = found.filter((clip) => clip.objects !== undefined).length;
  open(`Clips: ${done} of ${found.length} annotated`,
    table(["clip", "frames", "objects", "motions", "labelled", "", "saved", "by"], rows));
}

function progress(clip) {
  if (clip.error) return [element("span", { className: "bad" }, clip.error), ""];
  if (!clip.counts) return [element("span", { className: "faint" }, clip.objects === undefined ? "to do" : "not opened yet"), ""];
  const total = Object.values(clip.counts).reduce((sum, n) => sum + n, 0);
  const share = total ? (clip.counts.labelled + clip.counts.rejected) / total : 0;
  const fill = element("i");
  fill.style.width = `${100 * share}%`;
  const open = clip.counts.conflict + clip.counts.short;
  return [element("span", { className: "meter" }, fill), `${(100 * share).toFixed(1)} %, ${open} open`];
}
