// Autosave: every edit is kept in this browser at once and sent soon; the server's answer is the truth.

import * as api from "./api.js";
import * as drafts from "./drafts.js";

const SOON = 350;
const RETRY = [1000, 2000, 4000, 8000];

export class Saver {
  #timer = 0;
  #sending = null;
  #failures = 0;

  constructor(state) {
    this.state = state;
    state.now(["doc", "dragging"], () => this.#changed());
    addEventListener("online", () => this.flush());
    addEventListener("beforeunload", (event) => {
      if (this.pending) event.preventDefault();
    });
  }

  /** Start from what the server has. */
  open(clip, doc) {
    clearTimeout(this.#timer);
    this.clip = clip;
    this.base = doc;
    this.revision = doc.revision;
    this.#show("saved");
  }

  get pending() {
    return this.base !== undefined && this.state.doc !== this.base;
  }

  /** Continue on top of another revision, after a conflict was settled. */
  rebase(doc) {
    this.base = doc;
    this.revision = doc.revision;
    this.#show("unsaved");
    this.#schedule(0);
  }

  /** Save now. */
  async flush() {
    clearTimeout(this.#timer);
    if (!this.pending || this.state.saving.kind === "conflict") return this.#sending;
    this.#sending ??= this.#send().finally(() => (this.#sending = null));
    return this.#sending;
  }

  #changed() {
    if (this.base === undefined || this.state.dragging) return;
    if (!this.pending) {
      drafts.drop(this.clip);
      if (this.state.saving.kind !== "conflict") this.#show("saved");
      return;
    }
    drafts.keep(this.clip, this.base, this.state.doc);
    if (this.state.saving.kind === "conflict") return;
    if (this.state.saving.kind !== "offline") this.#show("unsaved");
    this.#schedule(SOON);
  }

  #schedule(delay) {
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => this.flush(), delay);
  }

  async #send() {
    const { clip, revision } = this;
    const doc = this.state.doc;
    if (this.state.saving.kind !== "offline") this.#show("busy");
    try {
      const answer = await api.putAnnotation(clip, doc, revision);
      if (clip !== this.clip) return;
      this.#failures = 0;
      this.base = doc;
      this.revision = answer.revision;
      if (this.pending) this.#schedule(SOON);
      else drafts.drop(clip);
      this.#show(this.pending ? "unsaved" : "saved");
    } catch (error) {
      if (clip === this.clip) this.#failed(error);
    }
  }

  #failed(error) {
    if (error.status === 412) {
      this.#show("conflict");
      this.state.set({ conflict: error.body.annotation });
    } else if (error.offline || error.status >= 500) {
      this.#show("offline", error.offline ? "" : error.message);
      this.#schedule(RETRY[Math.min(this.#failures++, RETRY.length - 1)]);
    } else {
      this.#show("failed", error.message);
    }
  }

  #show(kind, message = "") {
    this.state.set({ saving: { kind, revision: this.revision, message } });
  }
}
