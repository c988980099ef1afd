// Opening clips, the list of them, and how far this one and all are.

import * as api from "./api.js";
import { button, byId, close, element, faint, fill, open, row, table } from "./dom.js";
import { flush, saver, startFrom } from "./saving.js";
import { begin, on, notify, set, state } from "./state.js";
import { loadTracks } from "./tracks.js";
import { fit, numbersOf, stop } from "./view.js";

const POLL = 500;
const HEADS = ["clip", "frames", "objects", "motions", "labelled", "", "saved", "by"];

/** Open a clip, or report why it cannot be opened. */
export async function openClip(name, pushHistory = true) {
  try {
    await show(name, pushHistory);
  } catch (error) {
    const again = button("Try again", () => (close(), openClip(name, pushHistory)));
    open("The clip cannot be opened", element("p", {}, error.message), row(again, button("Close", close)));
  }
}

/** What is not saved of the present clip is saved first, or stays in this browser. */
async function show(name, pushHistory) {
  await flush();
  const clip = await api.getClip(name);
  if (pushHistory) history.pushState(null, "", `?clip=${encodeURIComponent(name)}`);
  stop();
  saver.base = undefined;
  clip.numbers = numbersOf(clip.frame_names);
  begin(clip, { doc: clip.annotation, view: fit(clip.image_size) });
  byId("stage").focus({ preventScroll: true });
  await startFrom(name, clip.annotation);
  await loadTracks(clip);
}

export async function openNext(by) {
  const names = (await api.listClips()).map((clip) => clip.name);
  const next = names[names.indexOf(state.clip.name) + by];
  if (next) await openClip(next);
  else notify(by > 0 ? "This is the last clip" : "This is the first clip");
}

// Progress

/** Trajectories of a clip that have their label or were rejected, of how many; null where none are known. */
function shareOf({ counts, trajectories }) {
  if (counts) {
    const left = counts.short + counts.conflict;
    const decided = counts.labelled + counts.rejected;
    return { decided, left, total: decided + left };
  }
  return trajectories === undefined ? null : { decided: 0, left: trajectories, total: trajectories };
}

/** The same over all clips, with the number of clips that are annotated and of those that cannot be counted. */
function overall(summaries) {
  const out = { decided: 0, left: 0, total: 0, annotated: 0, clips: summaries.length, unknown: 0, counting: 0 };
  for (const summary of summaries) {
    const share = shareOf(summary);
    for (const key of ["decided", "left", "total"]) out[key] += share?.[key] ?? 0;
    out.annotated += summary.objects !== undefined;
    out.unknown += !share && !summary.counting;
    out.counting += summary.counting;
  }
  return out;
}

// Rounded down: 100 % means all.
const percent = ({ decided, total }) => `${(Math.floor((1000 * decided) / (total || 1)) / 10).toFixed(1)} %`;

function meter({ decided, total }) {
  const full = element("i");
  full.style.width = `${(100 * decided) / (total || 1)}%`;
  return element("span", { className: "meter" }, full);
}

let timer = 0;

async function refresh() {
  clearTimeout(timer);
  try {
    set({ summaries: await api.listClips() });
    if (state.summaries.some((summary) => summary.counting)) timer = setTimeout(refresh, POLL);
  } catch {
    // The server is away: the next save retries.
  }
}

function drawProgress() {
  const { labels, summaries, clip, doc } = state;
  const started = doc.objects.length || doc.revision;
  const here = labels && started ? shareOf(labels) : null;
  const all = overall(summaries ?? []);
  const parts = [element("span", {}, here ? percent(here) : started ? "…" : "to do")];
  if (all.clips > 1) parts.push(faint(`all ${all.clips}:`), all.counting ? faint("counting…") : percent(all));
  fill(byId("progress"), parts);
  byId("clips").title = `${here ? `${clip.name}: ${here.decided} of ${here.total} trajectories labelled. ` : ""}`
    + `${all.annotated} of ${all.clips} clips annotated, ${all.decided} of ${all.total} trajectories labelled (F2)`;
}

// The list

const body = element("div");

export function clips() {
  open("Clips", body, row(button("Close", close)));
  drawClips();
  body.querySelector("button.on")?.focus();
}

function drawClips() {
  const { summaries } = state;
  if (!body.isConnected) return;
  if (!summaries) {
    fill(body, element("p", {}, "Counting…"));
    return;
  }
  const focused = document.activeElement?.dataset?.clip;
  const top = body.querySelector(".scroll")?.scrollTop ?? 0;
  fill(body, total(overall(summaries)), table(HEADS, summaries.map(cells)));
  body.querySelector(".scroll").scrollTop = top;
  if (focused) body.querySelector(`[data-clip="${CSS.escape(focused)}"]`)?.focus({ preventScroll: true });
}

function total(all) {
  const text = [`${all.annotated} of ${all.clips} clips annotated.`];
  if (all.total) text.push(`${percent(all)} of ${all.total} trajectories labelled, ${all.left} open.`);
  if (all.counting) text.push(`Counting ${all.counting} more…`);
  if (all.unknown) text.push(`Without trajectories yet: ${all.unknown}; open them, or start with --tracks.`);
  return element("p", { role: "status" }, meter(all), ` ${text.join(" ")}`);
}

function cells(summary) {
  const { name, n_frames, objects, motions, revision, annotator } = summary;
  const go = button(name, () => (close(), openClip(name)), name === state.clip?.name ? "on" : "");
  go.dataset.clip = name;
  const saved = objects === undefined ? "" : `rev ${revision}`;
  return [go, n_frames, objects ?? "", motions ?? "", ...progressCells(summary), saved, annotator ?? ""];
}

function progressCells(summary) {
  if (summary.error) return [element("span", { className: "bad" }, summary.error), ""];
  const share = shareOf(summary);
  const untouched = summary.objects === undefined;
  if (!share) return [faint(summary.counting ? "counting…" : untouched ? "to do" : "no trajectories yet"), ""];
  return [meter(share), untouched ? "to do" : `${percent(share)}, ${share.left} open`];
}

// The clip at hand comes first: the others are counted when its labels are there.
on(["saving", "labels", "clip"], () => state.labels && state.saving.kind === "saved" && refresh());
on(["labels", "summaries", "clip"], () => state.clip && drawProgress());
on(["summaries"], drawClips);
