// Opening clips, the list of them, and how far this one and all are.

import { allOutlined, weakFrames } from "./actions.js";
import { button, byId, close, element, faint, fill, open, paragraph, row, table } from "./dom.js";
import { proposeBuilt } from "./exchange.js";
import { ask, flush, join, listClips, saver, startFrom, yourName } from "./saving.js";
import { attempt, begin, on, notify, set, state } from "./state.js";
import { loadTracks } from "./tracks.js";
import { fit, stop } from "./view.js";

const POLL = 500;
const HEADS = ["clip", "frames", "objects", "assigned to", "state", "set by", "in doubt", "minutes", "saved"];

/** Save what is there, once what was asked for is there, too. */
const complete = () => allOutlined().then(flush);

/** Open a clip, or report why it cannot be opened. */
export async function openClip(name, remember = "pushState", leaving = false) {
  try {
    await complete();
    const clip = await ask(name);
    await complete(); // what was drawn meanwhile
    const same = name === saver.clip && clip.folder === saver.folder;
    if (same && clip.annotation.revision < saver.revision) return openClip(name, remember, leaving);
    if (state.dragging) return notify("Let go first, then open another clip");
    if (saver.pending && !leaving) return stay(name, remember);
    history[remember](null, "", `?clip=${encodeURIComponent(name)}`);
    stop();
    saver.base = undefined;
    close(); // what a dialogue is about is of the clip before
    begin(clip, { work: clip.work, doc: clip.annotation, view: fit(clip.image_size) });
    byId("stage").focus({ preventScroll: true });
    await startFrom(name, clip.annotation, clip.folder);
    return attempt(() => loadTracks(clip).then(() => proposeBuilt(clip)));
  } catch (error) {
    const again = button("Try again", () => (close(), openClip(name, remember)));
    return open("The clip cannot be opened", paragraph(error.message),
      row(again, button("Other clips", clips), button("Close", close)));
  }
}

/** Ask before a clip is left that cannot be saved. */
function stay(name, remember) {
  if (remember === "replaceState") history.pushState(null, "", `?clip=${encodeURIComponent(saver.clip)}`); // Back was pressed
  const go = button("Leave it", () => (close(), openClip(name, remember, true)));
  const then = saver.kept ? "They stay in this browser, and are saved when the clip is opened here again."
    : "This browser cannot keep them: if you leave it, they are lost.";
  open("Not saved", paragraph(`The edits of ${saver.clip} could not be saved. ${then}`),
    row(button("Stay here", close, "primary"), go));
}

export async function openNext(by) {
  const names = (await listClips()).map((clip) => clip.name);
  const next = names[names.indexOf(state.clip.name) + by];
  if (next) await openClip(next);
  else notify(by > 0 ? "This is the last clip" : "This is the first clip");
}

// Progress: the state that an annotator set, and what the trajectories leave to explain

/** The state of a clip as it counts now: what was changed after it was done is in work again. */
function stateOf({ work, revision }) {
  if (!work?.by) return { now: revision ? "in work" : work?.state ?? "", detail: "" };
  const by = `by ${work.by}, ${new Date(work.time).toLocaleString()}`;
  const changed = isDone(work.state) && revision !== undefined && revision !== work.revision;
  return changed ? { now: "in work", detail: `changed since ${work.state} ${by}` } : { now: work.state, detail: by };
}

const isDone = (name) => ["done", "reviewed"].includes(name);

/** What the labels leave in doubt: trajectories that got none, regions that were carried with doubt. */
function doubtOf({ short, conflict }, weak) {
  const parts = [[short + conflict, "open track"], [weak, "weak frame"]].filter(([count]) => count);
  return parts.map(([count, what]) => `${count} ${what}${count > 1 ? "s" : ""}`).join(" · ") || "nothing in doubt";
}

/** Set the state of this clip: of what is seen here. Where somebody saved meanwhile, that is shown instead. */
async function setState(value) {
  await complete();
  await setWork(state.clip.name, { state: value, revision: saver.revision }).catch((error) => {
    if (error.status !== 412) throw error;
    join(error.body.annotation);
    notify("Somebody else saved meanwhile: look at it, then set the state again");
  });
}

/** Set the state of a clip, or to whom it is assigned: { state, revision } or { assigned }. */
async function setWork(name, wanted) {
  const by = yourName() || await askName();
  if (!by) return;
  const { work } = await ask(name, "state", { ...wanted, by }, { method: "PUT" });
  if (name === state.clip?.name) set({ work });
  await refresh();
}

function askName() {
  return new Promise((done) => {
    const name = element("input", { "aria-label": "your name", maxLength: 100, value: yourName() });
    const keep = () => name.value.trim() && localStorage.setItem("annotator", name.value.trim());
    open("Who are you?", element("form", { method: "dialog", onsubmit: keep },
      paragraph("The state is kept with your name and the time."), name,
      row(element("button", { className: "primary" }, "Keep"), button("Cancel", close))));
    name.focus();
    byId("dialog").addEventListener("close", () => done(localStorage.getItem("annotator")), { once: true });
  });
}

let timer = 0;

async function refresh() {
  clearTimeout(timer);
  const summaries = await listClips().catch(() => null);
  if (!summaries) return; // the server is away: the next save counts again
  set({ summaries });
  if (summaries.some((summary) => summary.counting)) timer = setTimeout(refresh, POLL);
}

function drawProgress() {
  const { clip, work, labels } = state;
  const summaries = state.summaries ?? [];
  const weak = state.doc.objects.flatMap(weakFrames).length;
  byId("progress").textContent = labels ? doubtOf(labels.counts, weak) : "…";
  const done = summaries.filter((summary) => isDone(stateOf(summary).now)).length;
  byId("clips").title = `${done} of ${summaries.length} clips are done. Open: trajectories too short or in conflict `
    + "(G visits them). Weak: regions carried with doubt (Shift+W). F2 lists the clips";
  const { now, detail } = stateOf({ work, revision: saver.revision });
  fill(byId("state"), clip.states.map((name) => element("option", { selected: name === now }, name)));
  byId("state").title = detail || "Set how far this clip is";
}

// The list

const body = element("div", { className: "scroll" });
const filter = element("input", {
  "aria-label": "Show clips with", placeholder: "part of a clip's name, a name or a state", oninput: drawClips,
});

export function clips() {
  const rename = button(`You: ${yourName() || "?"}`, askName, "", {
    title: "Whose name is kept with the states that you set", disabled: Boolean(state.clip?.annotator),
  });
  const names = state.clip?.team ?? []; // without a clip the first one cannot be opened
  const team = element("datalist", { id: "team" }, names.map((value) => element("option", { value })));
  if (!state.summaries) refresh();
  open("Clips", filter, body, team, row(button("Close", close), rename));
  drawClips();
  body.querySelector("[aria-current=true]")?.focus();
}

addEventListener("pointerup", () => requestAnimationFrame(drawClips));

function drawClips() {
  const { summaries } = state;
  if (!body.isConnected || body.querySelector(":active")) return; // a click on what is drawn again would be lost
  const focused = document.activeElement?.dataset.clip;
  if (body.contains(document.activeElement) && document.activeElement.matches("input")) return;
  const matches = (summary) => [summary.name, summary.work?.assigned, stateOf(summary).now]
    .some((text) => text?.toLowerCase().includes(filter.value.trim().toLowerCase()));
  fill(body, summaries ? [total(summaries), throughput(summaries), table(summaries.filter(matches).map(cells), HEADS)]
    : paragraph("Counting…"));
  if (focused) body.querySelector(`[data-clip="${CSS.escape(focused)}"]`)?.focus({ preventScroll: true });
}

function total(summaries) {
  const counting = summaries.filter((summary) => summary.counting).length;
  const states = Map.groupBy(summaries, (summary) => stateOf(summary).now);
  const counts = (state.clip?.states ?? [...states.keys()]).map((name) => `${states.get(name)?.length ?? 0} ${name}`).join(", ");
  return element("p", { role: "status" }, `${summaries.length} clips: ${counts}.`
    + (counting ? ` Counting ${counting} more…` : ""));
}

const minutesOf = ({ minutes = {} }) => Object.values(minutes).reduce((sum, time) => sum + time, 0);

/** How long each person worked on the clips that are done, and on how many. */
function throughput(summaries) {
  const done = summaries.filter((summary) => isDone(stateOf(summary).now));
  const names = [...new Set(done.flatMap(({ minutes = {} }) => Object.keys(minutes)))].filter(Boolean);
  const of = (name) => done.map(({ minutes = {} }) => minutes[name]).filter((time) => time !== undefined);
  const mean = (times) => (times.reduce((sum, time) => sum + time, 0) / times.length).toFixed(1);
  const lines = names.map((name) => `${name}: ${of(name).length} done, ${mean(of(name))} minutes each`);
  return paragraph(faint(lines.join("; ")));
}

/** Who a clip is for, to be typed or chosen. */
function assignment({ name, work }) {
  const field = element("input", {
    value: work?.assigned ?? "", maxLength: 100, size: 8, "aria-label": `${name} is assigned to`,
    onchange: () => attempt(() => setWork(name, { assigned: field.value.trim() })),
  });
  field.setAttribute("list", "team");
  return field;
}

function cells(summary) {
  const { name, n_frames, objects = "", revision, counts, weak, error } = summary;
  const go = button(name, () => (close(), openClip(name)), "",
    { "data-clip": name, ariaCurrent: name === state.clip?.name });
  const { now, detail } = stateOf(summary);
  let hint = counts ? doubtOf(counts, weak) : "";
  if (error) hint = element("span", { className: "bad" }, error);
  if (summary.counting) hint = faint("counting…");
  const time = minutesOf(summary);
  return [go, n_frames, objects, assignment(summary), now, faint(detail), hint, time ? time.toFixed(1) : "",
    objects === "" ? "" : `rev ${revision}`];
}

// The clip at hand comes first: the others are counted when its labels are there.
on(["saving", "labels", "clip"], () => state.labels && state.saving.kind === "saved" && refresh());
on(["labels", "weak", "summaries", "clip", "work", "saving"], () => state.clip && drawProgress());
on(["summaries"], drawClips);
let byPointer = false;
byId("state").onpointerdown = byId("state").onkeydown = ({ type }) => {
  byPointer = type === "pointerdown";
};
byId("state").onchange = ({ target }) => {
  const { value } = target;
  if (byPointer) target.blur(); // keys are the page's again
  attempt(() => setState(value)).then(drawProgress);
};
