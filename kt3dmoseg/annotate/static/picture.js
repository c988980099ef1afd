// The frames: loaded once, the shown one first, then its neighbours.

import { frameAddress } from "./api.js";
import { toScreen } from "./view.js";

export class Picture {
  #images = [];

  constructor(state, layer) {
    this.state = state;
    this.layer = layer;
    state.on(["frame", "view", "loaded", "clip", "flickered"], () => this.draw());
    state.on(["frame", "clip"], () => this.#load());
  }

  open() {
    this.#images = [];
    this.#load();
  }

  draw() {
    const { state } = this;
    const context = this.layer.begin();
    const image = this.#images[state.flickered ?? state.frame];
    if (!image?.complete || !image.naturalWidth || !state.view) return;
    const [x, y] = toScreen(state.view, [-0.5, -0.5]);
    context.imageSmoothingEnabled = state.view.scale < 3;
    document.getElementById("first")?.remove();
    context.drawImage(image, x, y, image.naturalWidth * state.view.scale, image.naturalHeight * state.view.scale);
  }

  #load() {
    const { clip, frame } = this.state;
    if (!clip) return;
    const shown = this.#fetch(frame);
    shown.decode().catch(() => {}).then(() => {
      for (let k = 1; k < clip.n_frames && clip === this.state.clip; k++) {
        if (k < 40) this.#fetch((frame + k) % clip.n_frames);
      }
    });
  }

  #fetch(frame) {
    return (this.#images[frame] ??= this.#start(frame));
  }

  #start(frame) {
    const image = new Image();
    image.src = frameAddress(this.state.clip.name, frame);
    image.decode().then(() => this.state.set({ loaded: performance.now() }), () => {});
    return image;
  }
}
