// Asks the server what the document means: labels of the trajectories, regions between key frames.

import * as api from "./api.js";

const SOON = 40;
const POLL = 400;

export class Labeller {
  #timer = 0;
  #controller = null;

  constructor(state) {
    this.state = state;
    state.now(["doc", "dragging", "tracks"], () => this.#later());
  }

  /** Fetch the trajectories of the clip, waiting while the server computes them. */
  async load(clip) {
    for (;;) {
      try {
        const answer = await api.getTracks(clip.name);
        if (clip !== this.state.clip) return;
        if (answer.xy) {
          this.state.set({ tracks: answer, computing: null });
          return;
        }
        this.state.set({ computing: `trajectories: frame ${answer.done} of ${answer.total}` });
      } catch (error) {
        if (clip !== this.state.clip) return;
        this.state.set({ computing: error.offline ? "waiting for the server" : `no trajectories: ${error.message}` });
        if (!error.offline) return;
      }
      await new Promise((resolve) => setTimeout(resolve, POLL));
      if (clip !== this.state.clip) return;
    }
  }

  #later() {
    if (this.state.dragging || !this.state.tracks || !this.state.doc) return;
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => this.#ask(), SOON);
  }

  async #ask() {
    this.#controller?.abort();
    const controller = (this.#controller = new AbortController());
    const { clip, doc } = this.state;
    try {
      // Regions first: they take a fraction of the time, and the next frame waits for them.
      const { regions } = await api.regions(clip.name, doc, controller.signal);
      if (this.#isCurrent(clip, controller) && regions) this.state.set({ regions });
      const labels = await api.labels(clip.name, doc, controller.signal);
      if (this.#isCurrent(clip, controller) && labels.label) this.state.set({ labels });
    } catch {
      // Offline or refused: the saver tells; the last labels stay.
    }
  }

  #isCurrent(clip, controller) {
    return clip === this.state.clip && controller === this.#controller;
  }
}
