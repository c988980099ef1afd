// Requests to the server, and autosave: every edit is kept in this browser at once and sent soon; the server's
// answer is the truth.

import { merge, objectOf } from "./annotation.js";
import { button, byId, download, element, fill } from "./dom.js";
import { edit, now, on, notify, set, state } from "./state.js";

const SOON = 350;
const TRIES = 5;
// The server is asked this often whether it is there and can save, and given this long to answer, and to save.
const PULSE = 2000;
const PATIENCE = 3000;
const SAVING = 30000;
const AWAY = "The server does not answer";
const TEXT = {
  saved: ({ revision }) => (revision ? `✓ saved · rev ${revision}` : "no edits yet · rev 0"),
  unsaved: () => "• edited",
  busy: () => "saving…",
  offline: ({ message }) => `⚠ ${message || "server away"}: edits kept in this browser`,
  failed: ({ message }) => `⚠ not saved: ${message}`,
};

const failure = (message, status, body) => Object.assign(new Error(message), { status, body, offline: status === 0 });
const address = (clip, what) => ["/api/clips", encodeURIComponent(clip), what].filter(Boolean).join("/");
export const frameAddress = (clip, frame) => address(clip, `frames/${frame}`);

/** Ask for something of a clip; a body, an annotation or a file, is posted. A failure is an Error with the server's
 *  own sentence, its status and answer, and `offline` where the server cannot be reached at all. */
export async function request(clip, what, body, options = {}) {
  if (body) {
    options = { method: "POST", headers: { "content-type": "application/json" }, ...options };
    options.body = body instanceof Blob ? body : JSON.stringify(body);
  }
  const response = await fetch(address(clip, what), options).catch((error) => {
    throw error.name === "AbortError" ? error : failure(AWAY, 0, null);
  });
  if (response.status === 202 && what !== "tracks") throw failure("The trajectories are not there yet", 202, null);
  if (response.ok) return response;
  const answer = await response.json().catch(() => ({}));
  throw failure(answer.error ?? response.statusText, response.status, answer);
}

export const ask = (...parts) => request(...parts).then((response) => response.json());
export const listClips = () => ask("").then(({ clips }) => clips);

/** What the server has of the clip at hand. */
export const saver = {
  clip: null,
  folder: "",
  base: undefined,
  revision: 0,
  /** Whether this browser keeps them. */
  get kept() {
    return draftKept;
  },
  /** Whether there are edits since then. */
  get edited() {
    return this.base !== undefined && state.doc !== this.base;
  },
  /** Whether it may have something else than is seen here: while edits are on their way, too. */
  get pending() {
    return this.edited || (this.base !== undefined && sending !== null);
  },
};

let timer = 0;
let sending = null;
let draftKept = true;

/** Start from what the server has, and restore edits that did not reach it before the page was closed. */
export async function startFrom(clip, doc, folder) {
  clearTimeout(timer);
  Object.assign(saver, { clip, folder, base: doc, revision: doc.revision });
  show("saved");
  for (const draft of await recover(clip)) {
    edit(merge(draft.base, draft.doc, state.doc).doc);
    notify("Edits that had not reached the server are restored");
  }
}

/** Whose work this is: who has the token or was named on the command line, else whom this browser keeps. */
export const yourName = () => state.clip?.annotator || localStorage.getItem("annotator") || "";

/** Save now. What is on its way was taken before the last edits: it is awaited, then these are sent. */
export async function flush() {
  clearTimeout(timer);
  await sending;
  for (let tries = 0; saver.pending && !state.dragging && tries < TRIES; tries++) { // others may save in between
    sending ??= send().finally(() => (sending = null));
    await sending;
    if (["offline", "failed"].includes(state.saving.kind)) return;
  }
}

function schedule(delay) {
  clearTimeout(timer);
  timer = setTimeout(flush, delay);
}

const show = (kind, message = "") => set({ saving: { kind, revision: saver.revision, message } });

function documentChanged() {
  if (saver.base === undefined || state.dragging) return;
  const { kind } = state.saving;
  if (saver.pending) keepDraft();
  else dropDraft();
  if (saver.pending) schedule(SOON);
  if (kind !== "offline" || !saver.pending) show(saver.pending ? "unsaved" : "saved");
}

async function send() {
  const { clip, revision } = saver;
  const { doc } = state;
  if (state.saving.kind !== "offline") show("busy");
  try {
    const mine = { ...doc, revision, annotator: yourName() || doc.annotator };
    const headers = { "content-type": "application/json", "x-folder": saver.folder };
    const options = { method: "PUT", headers, signal: AbortSignal.timeout(SAVING) };
    const answer = await ask(clip, "annotation", mine, options);
    if (clip !== saver.clip) return;
    Object.assign(saver, { base: doc, revision: answer.revision });
    if (saver.edited) schedule(SOON);
    else dropDraft();
    show(saver.edited ? "unsaved" : "saved");
  } catch ({ status, body, offline, message }) {
    if (clip !== saver.clip) return;
    if (!saver.edited) saver.base = { ...saver.base }; // undone meanwhile: what the server has is not known
    // Without a status there was no answer, or half of one.
    if (status !== 412) show(!status || status >= 500 ? "offline" : "failed", offline || !status ? "" : message);
    else if (state.dragging) schedule(SOON);
    else join(body.annotation);
  }
}

/** Somebody else saved in between: what both drew is kept, and undo still takes back one's own edits only. */
export function join(theirs) {
  const { base } = saver;
  const { doc, moved } = saver.edited ? merge(base, state.doc, theirs) : { doc: theirs, moved: new Map() };
  const twice = [...moved.values()].map((id) => objectOf(doc, id).name);
  const rebased = (before) => merge(base, before, theirs, moved).doc;
  Object.assign(saver, { base: theirs, revision: theirs.revision });
  const { making, selected, pending, done, undone } = state;
  const renumbered = (id) => moved.get(id) ?? id;
  set({
    doc, making: renumbered(making), selected: renumbered(selected),
    pending: pending && { ...pending, id: renumbered(pending.id) },
    done: done.map(rebased), undone: undone.map(rebased),
  });
  notify(`${theirs.annotator || "Somebody else"} saved meanwhile: both are merged`
    + (twice.length ? `; kept under new numbers: ${twice.join(", ")}` : ""));
}

// The banner: what is wrong with the server or its folder, noticed also while nothing is edited

async function check() {
  if (!saver.clip) return;
  const signal = AbortSignal.timeout(PATIENCE);
  const answer = await ask(saver.clip, "trouble", null, { signal })
    .catch(({ status, message }) => ({ trouble: status ? message : AWAY })); // it may also fall silent in mid-answer
  set({ trouble: answer.trouble });
  if (!answer.trouble && state.saving.kind === "offline") flush();
}

const watch = () => check().finally(() => setTimeout(watch, PULSE));

function drawBanner() {
  const { clip, saving, trouble, doc } = state;
  const away = ["offline", "failed"].includes(saving.kind);
  const problem = (away && saving.message) || trouble || (away && AWAY);
  byId("banner").hidden = !(problem || clip?.doubt);
  if (!problem) {
    fill(byId("banner"), element("span", {}, clip?.doubt ?? ""));
    return;
  }
  let kept = "Everything before is saved; what you edit now is kept in this browser.";
  if (saver.edited) {
    const [mine, saved] = [new Set(doc.objects), new Set(saver.base.objects)];
    const names = [...new Set([...mine.symmetricDifference(saved)].map((item) => item.name))];
    kept = `Not saved, kept in this ${draftKept ? "browser" : "page only, do not close it"}: `
      + `${names.slice(0, 6).join(", ") || "lassos"}${names.length > 6 ? ` and ${names.length - 6} more` : ""}.`;
  }
  const file = () => download(new Blob([JSON.stringify(doc)], { type: "application/json" }), `${saver.clip}.json`);
  fill(byId("banner"), element("span", {}, `${problem}. ${kept}`), button("Try now", () => (flush(), check())),
    button("Download the annotation", file));
}

// Drafts: edits that the server does not have yet, so that closing the browser loses nothing. Each tab has
// its own draft, and holds a lock while it lives, so that others leave its draft alone.

try {
  void localStorage;
} catch (error) {
  fill(document.body, element("p", {}, "Let this page store data in the browser (cookies and site data), and load it "
    + "again: edits are kept there until the server has them."));
  throw error;
}

const keyOf = (clip, owner) => `draft:${clip}:${saver.folder}:${owner}`;

let tab = "";

function claim(name) {
  sessionStorage.tab = tab = name ?? crypto.getRandomValues(new Uint32Array(4)).join("-");
  // A tab that was duplicated has the name of the other.
  navigator.locks?.request(`tab:${tab}`, { ifAvailable: true }, (lock) => (lock ? new Promise(() => {}) : claim()));
}

claim(sessionStorage.tab);

function keepDraft() {
  const { clip, base } = saver;
  try {
    localStorage.setItem(keyOf(clip, tab), JSON.stringify({ base, doc: state.doc }));
    draftKept = true;
  } catch {
    draftKept = false; // The browser's storage is full or forbidden: the edits stay in the page.
  }
}

const dropDraft = () => localStorage.removeItem(keyOf(saver.clip, tab));

/** Drafts of this clip by this tab, and by tabs that are gone; each is handed out once. */
async function recover(clip) {
  const held = (await navigator.locks?.query())?.held?.map((lock) => lock.name) ?? [];
  const start = keyOf(clip, "");
  const free = (key) => key === keyOf(clip, tab) || !held.includes(`tab:${key.slice(start.length)}`);
  return Object.keys(localStorage).filter((key) => key.startsWith(start) && free(key)).flatMap((key) => {
    const draft = draftOf(localStorage.getItem(key));
    if (draft) localStorage.removeItem(key);
    else notify("Edits that are damaged, or of other frames than these, were found in this browser and left there");
    return draft ?? [];
  });
}

/** A draft as it was kept; null for one that is damaged, or of other frames than this clip has now. */
function draftOf(text) {
  const { n_frames, image_size } = state.doc;
  try {
    const { base, doc } = JSON.parse(text);
    const fits = [base, doc].every((each) => Array.isArray(each.objects) && each.n_frames === n_frames
      && `${each.image_size}` === `${image_size}`);
    return fits ? { base, doc } : null;
  } catch {
    return null;
  }
}

now(["doc", "dragging"], documentChanged);
on(["clip", "saving", "trouble", "doc"], drawBanner);
on(["saving"], () => {
  const { kind, message } = state.saving;
  Object.assign(byId("saved"), { textContent: TEXT[kind](state.saving), className: kind, title: message ?? "" });
});
watch();
addEventListener("beforeunload", (event) => {
  if (saver.pending) event.preventDefault();
});
