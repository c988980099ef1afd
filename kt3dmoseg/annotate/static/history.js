// Undo and redo without limit: documents are never changed in place, so remembering one is free.

export class History {
  #done = [];
  #undone = [];
  #start = null;

  constructor(state) {
    this.state = state;
  }

  /** Make `doc` the present document, as one edit. */
  edit(doc) {
    const before = this.#start ?? this.state.doc;
    this.#start = null;
    if (doc !== before) {
      this.#done.push(before);
      this.#undone = [];
    }
    this.state.set({ doc, dragging: false });
  }

  /** Show a document while something is being dragged; `edit` or `cancel` ends it. */
  preview(doc) {
    this.#start ??= this.state.doc;
    this.state.set({ doc, dragging: true });
  }

  cancel() {
    if (this.#start) this.state.set({ doc: this.#start, dragging: false });
    this.#start = null;
  }

  undo() {
    return this.#step(this.#done, this.#undone);
  }

  redo() {
    return this.#step(this.#undone, this.#done);
  }

  clear() {
    this.#done = [];
    this.#undone = [];
    this.#start = null;
  }

  #step(source, target) {
    if (!source.length || this.state.dragging) return false;
    target.push(this.state.doc);
    this.state.set({ doc: source.pop() });
    return true;
  }
}
