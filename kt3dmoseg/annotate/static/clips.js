// Opening clips, the list of them, and how far this one and all are.

import * as api from "./api.js";
import { button, byId, close, element, faint, fill, open, row, table } from "./dom.js";
import { flush, saver, startFrom } from "./saving.js";
import { attempt, begin, on, notify, set, state } from "./state.js";
import { loadTracks, unexplained } from "./tracks.js";
import { fit, numbersOf, stop } from "./view.js";

const POLL = 500;
const HEADS = ["clip", "frames", "objects", "motions", "state", "", "left", "saved"];

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
  begin(clip, { work: clip.work, doc: clip.annotation, view: fit(clip.image_size) });
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

// Progress: the state that an annotator set, and what the trajectories leave to explain

/** The state of a clip as it counts now: what was changed after it was done is in work again. */
function stateOf({ work, revision }) {
  if (!work?.by) return { state: revision ? "in work" : "not started", detail: "" };
  const detail = `${work.by}, ${new Date(work.time).toLocaleString()}`;
  const changed = ["done", "reviewed"].includes(work.state) && revision !== undefined && revision !== work.revision;
  return changed ? { state: "in work", detail: `changed since ${work.state} by ${detail}` }
    : { state: work.state, detail: `by ${detail}` };
}

const left = (count) => (count ? `${count} motion${count > 1 ? "s" : ""} to check` : "no motion to check");

async function setState(wanted) {
  await flush();
  const { clip } = state;
  const by = yourName() || await askName();
  if (!by) return drawProgress();
  const work = await api.setWorkState(clip.name, wanted, by);
  if (clip === state.clip) set({ work });
  return refresh();
}

/** Who sets the state: not who drew last, for a reviewer is somebody else. This browser keeps the answer. */
const yourName = () => state.clip.annotator || localStorage.getItem("annotator");

function askName() {
  return new Promise((done) => {
    const name = element("input", { "aria-label": "your name", maxLength: 100, value: yourName() ?? "" });
    const keep = () => {
      const given = name.value.trim();
      if (given) localStorage.setItem("annotator", given);
      close();
    };
    name.addEventListener("keydown", (event) => event.key === "Enter" && keep());
    open("Who are you?", element("p", {}, "The state is kept with your name and the time."), name,
      row(button("Keep", keep, "primary"), button("Cancel", close)));
    name.focus();
    byId("dialog").addEventListener("close", () => done(localStorage.getItem("annotator")), { once: true });
  });
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
  const { summaries, clip, work } = state;
  const open = unexplained();
  byId("progress").textContent = open ? left(open.length) : "…";
  byId("clips").title = `${done(summaries ?? []).length} of ${summaries?.length ?? 0} clips are done. To check: groups of `
    + "trajectories that seem to move by themselves and lie in no outline (Shift+U). F2 lists the clips";
  const { state: now, detail } = stateOf({ work, revision: saver.revision });
  fill(byId("state"), clip.states.map((name) => element("option", { selected: name === now }, name)));
  byId("state").title = detail || "Set how far this clip is";
}

const done = (summaries) => summaries.filter((s) => ["done", "reviewed"].includes(stateOf(s).state));

// The list

const body = element("div");

export function clips() {
  const rename = button(`You: ${yourName() ?? "?"}`, askName);
  rename.title = "Whose name is kept with the states that you set";
  rename.disabled = Boolean(state.clip.annotator);
  open("Clips", body, row(button("Close", close), rename));
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
  fill(body, total(summaries), table(HEADS, summaries.map(cells)));
  body.querySelector(".scroll").scrollTop = top;
  if (focused) body.querySelector(`[data-clip="${CSS.escape(focused)}"]`)?.focus({ preventScroll: true });
}

function total(summaries) {
  const number = (wanted) => summaries.filter((summary) => stateOf(summary).state === wanted).length;
  const counting = summaries.filter((summary) => summary.counting).length;
  const states = state.clip.states.map((name) => `${number(name)} ${name}`).join(", ");
  return element("p", { role: "status" }, `${summaries.length} clips: ${states}.`
    + (counting ? ` Counting ${counting} more…` : ""));
}

function cells(summary) {
  const { name, n_frames, objects, motions, revision, counts, unexplained: open, error } = summary;
  const go = button(name, () => (close(), openClip(name)), name === state.clip?.name ? "on" : "");
  go.dataset.clip = name;
  const { state: now, detail } = stateOf(summary);
  const doubt = counts ? `${counts.conflict + counts.short} open` : "";
  const hint = error ? element("span", { className: "bad" }, error) : [Number.isInteger(open) ? left(open) : "", doubt]
    .filter(Boolean).join(", ");
  return [go, n_frames, objects ?? "", motions ?? "", now, faint(detail), summary.counting ? faint("counting…") : hint,
    objects === undefined ? "" : `rev ${revision}`];
}

// The clip at hand comes first: the others are counted when its labels are there.
on(["saving", "labels", "clip"], () => state.labels && state.saving.kind === "saved" && refresh());
on(["labels", "summaries", "clip", "moving", "work", "saving"], () => state.clip && drawProgress());
on(["summaries"], drawClips);
byId("state").addEventListener("change", (event) => attempt(() => setState(event.target.value)).then(drawProgress));
