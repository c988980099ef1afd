// Autosave: every edit is kept in this browser at once and sent soon; the server's answer is the truth.

import * as api from "./api.js";
import { merge } from "./annotation.js";
import { ask, button, byId, close, download, element, faint, fill, line, row } from "./dom.js";
import { edit, now, on, notify, set, state } from "./state.js";

const SOON = 350;
// The server is asked this often whether it is there and can save, and given this long to answer.
const PULSE = 2000;
const PATIENCE = 3000;
const OFFLINE = "The server does not answer";
const RETRY = [1000, 2000, 4000, 8000];
const TEXT = {
  saved: ({ revision }) => (revision ? `✓ saved · rev ${revision}` : "no edits yet · rev 0"),
  unsaved: () => "• edited",
  busy: () => "saving…",
  offline: ({ message }) => `⚠ ${message || "server away"}: edits kept in this browser`,
  conflict: () => "⚠ saved elsewhere: choose",
  failed: ({ message }) => `⚠ not saved: ${message}`,
};

/** What the server has of the clip at hand. */
export const saver = {
  clip: null,
  base: undefined,
  revision: 0,
  get pending() {
    return this.base !== undefined && state.doc !== this.base;
  },
};

let timer = 0;
let sending = null;
let failures = 0;
let draftKept = true;

/** Start from what the server has, and restore edits that did not reach it before the page was closed. */
export async function startFrom(clip, doc) {
  clearTimeout(timer);
  Object.assign(saver, { clip, base: doc, revision: doc.revision });
  show("saved");
  for (const draft of await recover(clip)) {
    edit(draft.base.revision === doc.revision ? draft.doc : merge(draft.base, draft.doc, state.doc));
    notify("Edits that had not reached the server are restored");
  }
}

/** Save now. */
export async function flush() {
  clearTimeout(timer);
  if (!saver.pending || state.saving.kind === "conflict") return sending;
  sending ??= send().finally(() => (sending = null));
  return sending;
}

function schedule(delay) {
  clearTimeout(timer);
  timer = setTimeout(flush, delay);
}

const show = (kind, message = "") => set({ saving: { kind, revision: saver.revision, message } });

function documentChanged() {
  if (saver.base === undefined || state.dragging) return;
  const { kind } = state.saving;
  if (!saver.pending) {
    dropDraft(saver.clip);
    if (kind !== "conflict") show("saved");
    return;
  }
  keepDraft(saver.clip, saver.base, state.doc);
  if (kind === "conflict") return;
  if (kind !== "offline") show("unsaved");
  schedule(SOON);
}

async function send() {
  const { clip, revision } = saver;
  const { doc } = state;
  if (state.saving.kind !== "offline") show("busy");
  try {
    const answer = await api.putAnnotation(clip, doc, revision);
    if (clip !== saver.clip) return;
    failures = 0;
    Object.assign(saver, { base: doc, revision: answer.revision });
    if (saver.pending) schedule(SOON);
    else dropDraft(clip);
    show(saver.pending ? "unsaved" : "saved");
  } catch (error) {
    if (clip === saver.clip) failed(error);
  }
}

function failed(error) {
  if (error.status === 412) {
    show("conflict");
    set({ conflict: error.body.annotation });
  } else if (error.offline || error.status >= 500) {
    show("offline", error.offline ? "" : error.message);
    schedule(RETRY[Math.min(failures++, RETRY.length - 1)]);
  } else {
    show("failed", error.message);
  }
}

/** Somebody else saved in between: nothing is overwritten before a person chose. */
function settleConflict() {
  const theirs = state.conflict;
  if (!theirs) return;
  const settle = (doc) => {
    close();
    set({ conflict: null });
    Object.assign(saver, { base: theirs, revision: theirs.revision });
    show("unsaved");
    edit(doc);
    flush();
  };
  const mine = state.doc;
  const first = button("Merge both", () => settle(merge(saver.base, mine, theirs)), "primary");
  ask("Saved elsewhere in the meantime",
    element("p", {}, `Another tab or person saved revision ${theirs.revision} of ${theirs.clip} after this page read `
      + `revision ${saver.revision}. Your edits are still here. Choose what revision ${theirs.revision + 1} holds.`),
    element("table", {},
      line([first, "objects changed on one side come from there; changed on both, you get both"]),
      line([button("Keep mine", () => settle({ ...mine })), "what you see now replaces the other revision"]),
      line([button("Take theirs", () => settle(theirs)), "the other revision; Ctrl+Z restores yours"])),
    row(faint("Each is one edit: Ctrl+Z undoes it.")));
  first.focus();
}

// The banner: what is wrong with the server or its folder, noticed also while nothing is edited

let pulse = 0;

async function watch() {
  clearTimeout(pulse);
  if (saver.clip) {
    const trouble = await api.getTrouble(saver.clip, AbortSignal.timeout(PATIENCE)).catch((error) => error.message);
    if (state.trouble && !trouble) flush();
    set({ trouble });
  }
  clearTimeout(pulse); // of another call that ended meanwhile
  pulse = setTimeout(watch, PULSE);
}

/** Names of the objects whose edits the server does not have. */
function unsaved() {
  if (!saver.pending) return [];
  const names = (from, to) => from.objects.filter((item) => !to.objects.includes(item)).map((item) => item.name);
  return [...new Set([...names(state.doc, saver.base), ...names(saver.base, state.doc)])];
}

const downloadDocument = () =>
  download(new Blob([JSON.stringify(state.doc)], { type: "application/json" }), `${saver.clip}.json`);

function drawBanner() {
  const { saving, trouble } = state;
  const problem = ["offline", "failed"].includes(saving.kind) ? saving.message || trouble || OFFLINE : trouble;
  const names = unsaved();
  byId("banner").hidden = !problem;
  if (!problem) return;
  const kept = saver.pending ? `Not saved, kept in this ${draftKept ? "browser" : "page only, do not close it"}: `
    + `${names.slice(0, 6).join(", ") || "lassos"}${names.length > 6 ? ` and ${names.length - 6} more` : ""}.`
    : "Everything before is saved; what you edit now is kept in this browser.";
  fill(byId("banner"), element("span", {}, `${problem}. ${kept}`), button("Try now", () => (flush(), watch())),
    button("Download the annotation", downloadDocument));
}

// Drafts: edits that the server does not have yet, so that closing the browser loses nothing. Each tab has
// its own draft, and holds a lock while it lives, so that others leave its draft alone.

const tab = (sessionStorage.tab ??= crypto.randomUUID());
const keyOf = (clip, owner) => `draft:${clip}:${owner}`;

navigator.locks?.request(`tab:${tab}`, { ifAvailable: true }, () => new Promise(() => {}));

function keepDraft(clip, base, doc) {
  try {
    localStorage.setItem(keyOf(clip, tab), JSON.stringify({ base, doc }));
    draftKept = true;
  } catch {
    draftKept = false; // The browser's storage is full or forbidden: the edits stay in the page.
  }
}

const dropDraft = (clip) => localStorage.removeItem(keyOf(clip, tab));

/** Drafts of this clip by this tab, and by tabs that are gone; each is handed out once. */
async function recover(clip) {
  const locks = (await navigator.locks?.query())?.held?.map((lock) => lock.name) ?? [];
  const start = keyOf(clip, "");
  const found = [];
  for (const key of Object.keys(localStorage)) {
    const owner = key.startsWith(start) ? key.slice(start.length) : null;
    if (owner && (owner === tab || !locks.includes(`tab:${owner}`))) {
      found.push(JSON.parse(localStorage.getItem(key)));
      localStorage.removeItem(key);
    }
  }
  return found;
}

now(["doc", "dragging"], documentChanged);
on(["conflict"], settleConflict);
on(["saving", "trouble", "doc"], drawBanner);
on(["saving"], () => {
  const { kind, message } = state.saving;
  Object.assign(byId("saved"), { textContent: TEXT[kind](state.saving), className: kind, title: message ?? "" });
});
watch();
addEventListener("online", flush);
addEventListener("beforeunload", (event) => {
  if (saver.pending) event.preventDefault();
});
