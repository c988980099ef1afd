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
      const answer = await api.labels(clip.name, doc, controller.signal);
      if (clip === this.state.clip && controller === this.#controller && answer.label) {
        this.state.set({ labels: answer, regions: answer.regions });
      }
    } catch {
      // Offline or refused: the saver tells; the last labels stay.
    }
  }
}
