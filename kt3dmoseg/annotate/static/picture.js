// The frames: loaded once, the shown one first, then its neighbours.

import { frameAddress } from "./api.js";
import { begin, byId } from "./dom.js";
import { on, set, state } from "./state.js";
import { toScreen } from "./view.js";

// Frames after the shown one that are fetched ahead.
const AHEAD = 40;

const canvas = byId("picture");
let clip = null;
let images = [];

export function draw() {
  const context = begin(canvas);
  const image = images[state.flickered ?? state.frame];
  if (!image?.complete || !image.naturalWidth || !state.view) return;
  const { scale } = state.view;
  const [x, y] = toScreen([-0.5, -0.5]);
  context.imageSmoothingEnabled = scale < 3;
  byId("first")?.remove();
  context.drawImage(image, x, y, image.naturalWidth * scale, image.naturalHeight * scale);
}

function load() {
  if (clip !== state.clip) images = [];
  clip = state.clip;
  const { frame } = state;
  const shown = image(frame);
  shown.decode().catch(() => {}).then(() => {
    for (let k = 1; clip === state.clip && k < Math.min(AHEAD, clip.n_frames); k++) image((frame + k) % clip.n_frames);
  });
}

const image = (frame) => (images[frame] ??= fetchImage(frame));

function fetchImage(frame) {
  const made = new Image();
  made.src = frameAddress(clip.name, frame);
  made.decode().then(() => set({ loaded: performance.now() }), () => {});
  return made;
}

on(["frame", "clip"], load);
on(["frame", "view", "loaded", "clip", "flickered"], draw);
on(["brightness"], () => (canvas.className = `bright${state.brightness}`));
