// How far this clip and all clips are: beside the clip's name, and for the list of clips.

import * as api from "./api.js";
import { element, fill } from "./dom.js";

const POLL = 500;

/** Trajectories of a clip that have their label or were rejected, of how many; null where none are known. */
export function shareOf({ counts, trajectories }) {
  if (counts) {
    const open = counts.short + counts.conflict;
    const decided = counts.labelled + counts.rejected;
    return { decided, open, total: decided + open };
  }
  return trajectories === undefined ? null : { decided: 0, open: trajectories, total: trajectories };
}

/** The same over all clips, with the number of clips that are annotated and of those that cannot be counted. */
export function overall(summaries) {
  const out = { decided: 0, open: 0, total: 0, annotated: 0, clips: summaries.length, unknown: 0, counting: 0 };
  for (const summary of summaries) {
    const share = shareOf(summary);
    for (const key of ["decided", "open", "total"]) out[key] += share?.[key] ?? 0;
    out.annotated += summary.objects !== undefined;
    out.unknown += !share && !summary.counting;
    out.counting += summary.counting;
  }
  return out;
}

// Rounded down: 100 % means all.
export const percent = ({ decided, total }) => `${(Math.floor((1000 * decided) / (total || 1)) / 10).toFixed(1)} %`;

export function meter({ decided, total }) {
  const full = element("i");
  full.style.width = `${(100 * decided) / (total || 1)}%`;
  return element("span", { className: "meter" }, full);
}

export function watchProgress(app, root) {
  const { state } = app;
  let timer = 0;
  const refresh = async () => {
    clearTimeout(timer);
    try {
      state.set({ summaries: await api.listClips() });
      if (state.summaries.some((summary) => summary.counting)) timer = setTimeout(refresh, POLL);
    } catch {
      // The server is away: the next save asks again.
    }
  };
  // The clip at hand comes first: the others are counted when its labels are there.
  state.on(["saving", "labels", "clip"], () => state.labels && state.saving.kind === "saved" && refresh());
  state.on(["labels", "summaries", "clip"], () => state.clip && draw(state, root));
}

function draw({ labels, summaries, clip, doc }, root) {
  const parts = [];
  const started = doc?.objects.length || doc?.revision;
  const here = labels && started ? shareOf(labels) : null;
  parts.push(element("span", {}, here ? percent(here) : started ? "…" : "to do"));
  const all = overall(summaries ?? []);
  if (all.clips > 1) {
    parts.push(element("span", { className: "faint" }, `all ${all.clips}:`),
      all.counting ? element("span", { className: "faint" }, "counting…") : percent(all));
  }
  fill(root, parts);
  root.parentElement.title = `${here ? `${clip.name}: ${here.decided} of ${here.total} trajectories labelled. ` : ""}`
    + `${all.annotated} of ${all.clips} clips annotated, ${all.decided} of ${all.total} trajectories labelled (F2)`;
}
