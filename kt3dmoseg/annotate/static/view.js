// The frames, moving through them and over the picture; nothing here changes the document. The view is the
// image position { x, y } of the stage's top left corner, and the scale.

import { boundsOf, clamp } from "./annotation.js";
import { frameAddress } from "./saving.js";
import { begin, byId } from "./dom.js";
import { chosen, on, notify, regionOf, set, state } from "./state.js";

// Frames after the shown one that are fetched ahead.
const AHEAD = 40;
const FRAME_TIME = 110;
const FLICKER_TIME = 220;
const CLOSEST = 40;
// So many pixels of the screen always show a part of the frame.
const KEPT = 60;

const stage = byId("stage");
const canvas = byId("picture");

// Frames

export function goTo(frame) {
  const drawing = ["draw", "lasso"].includes(state.tool) && state.pending?.points.length;
  if (drawing) notify("An outline is of one frame: Enter ends it, Esc drops it");
  else set({ frame: clamp(frame, 0, state.clip.n_frames - 1), vertex: null, lassoed: null });
  return !drawing;
}

/** Go to the frame of a number, as the files have it. */
export function goToNumber(wanted) {
  const { numbers } = state.clip;
  const frame = numbers.indexOf(String(Number(wanted)));
  if (frame >= 0) goTo(frame);
  else notify(`There is no frame ${wanted}: they are ${numbers[0]} to ${numbers.at(-1)}`);
}

let timer = 0;

export function stop() {
  clearInterval(timer);
  set({ playing: false, flickered: null });
}

export function play() {
  const { playing } = state;
  stop();
  if (playing || !goTo(state.frame)) return;
  set({ playing: true });
  timer = setInterval(() => goTo((state.frame + 1) % state.clip.n_frames), FRAME_TIME);
}

export function flicker() {
  const { flickered } = state;
  stop();
  if (flickered !== null) return;
  const other = () => {
    const { frame, clip } = state;
    const next = frame + 1 < clip.n_frames ? frame + 1 : frame - 1;
    set({ flickered: (state.flickered ?? frame) === frame ? next : frame });
  };
  other();
  timer = setInterval(other, FLICKER_TIME);
}

export function toKeyFrame(direction) {
  const frames = chosen()?.key_frames.map((key) => key.frame).filter((f) => (f - state.frame) * direction > 0) ?? [];
  if (frames.length) goTo(direction > 0 ? Math.min(...frames) : Math.max(...frames));
}

// View

export const toScreen = ([x, y]) => [(x - state.view.x) * state.view.scale, (y - state.view.y) * state.view.scale];
export const toImage = ([x, y]) => [x / state.view.scale + state.view.x, y / state.view.scale + state.view.y];
const middle = () => [stage.clientWidth / 2, stage.clientHeight / 2];

/** The middle of what is in sight, on the image. */
export const inSight = () => toImage(middle());

/** The view in which an image position is at a screen position. */
const viewOf = ([x, y], scale, [left, top] = middle()) => ({ x: x - left / scale, y: y - top / scale, scale });

/** The largest scale at which a size fits on the stage. */
const scaleFor = (width, height) => Math.min(stage.clientWidth / width, stage.clientHeight / height);
let whole = null;
export const fit = ([width, height]) => (whole = viewOf([(width - 1) / 2, (height - 1) / 2], scaleFor(width, height)));
export const fitAll = () => set({ view: fit(state.clip.image_size) });
export const refit = () => state.view === whole && fitAll(); // what somebody zoomed to stays

export function showBox([left, top, right, bottom]) {
  const scale = Math.min(CLOSEST / 2, 0.6 * scaleFor(right - left + 8, bottom - top + 8));
  set({ view: viewOf([(left + right) / 2, (top + bottom) / 2], scale) });
}

export const showPoint = (cross) => set({ cross, view: viewOf(cross, Math.max(state.view.scale, 4)) });

export function fitObject() {
  const item = chosen();
  if (!item) return;
  const box = boundsOf(regionOf(item, state.frame).polygons);
  if (box) showBox(box);
  else notify(`${item.name} is not in this frame`);
}

/** Zoom by a factor; what is under the screen point stays there. */
export function zoom(factor, at = null) {
  const { view, pointer, cross, clip } = state;
  const focus = at ?? (cross || pointer ? toScreen(cross ?? pointer) : middle());
  const scale = clamp(view.scale * factor, scaleFor(...clip.image_size) * 0.5, CLOSEST);
  set({ view: viewOf(toImage(focus), scale, focus) });
}

/** Zoom about the middle, so that a pixel of the frame is as large as so many percent of one of the screen. */
export function zoomTo(percent) {
  if (percent > 0) zoom(percent / (100 * state.view.scale), middle());
}

/** Pan, but not until next to nothing of the frame is left in sight. */
export function pan(dx, dy) {
  const { view: { x, y, scale }, clip: { image_size: [width, height] } } = state;
  const held = (at, size, room) => Math.min(size - KEPT / scale, Math.max(at, (KEPT - room) / scale));
  set({ view: {
    x: held(x - dx / scale, width, stage.clientWidth), y: held(y - dy / scale, height, stage.clientHeight), scale,
  } });
}

/** Set what is shown to the next one of its values. */
export function cycle(name, values, hint) {
  const next = values[(values.indexOf(state[name]) + 1) % values.length];
  set({ [name]: next });
  if (hint) notify(`${hint}${next}`);
}

// The picture: frames are loaded once, the shown one first, then its neighbours

export function drawPicture() {
  const context = begin(canvas);
  const image = state.clip?.images?.[state.flickered ?? state.frame];
  if (!image?.complete || !image.naturalWidth || !state.view) return;
  const { scale } = state.view;
  context.imageSmoothingEnabled = state.pixels === "smooth";
  byId("first")?.remove();
  context.drawImage(image, ...toScreen([-0.5, -0.5]), image.naturalWidth * scale, image.naturalHeight * scale);
}

async function load() {
  const { clip, frame } = state;
  await image(clip, frame).decode().catch(() => {});
  const last = Math.min(AHEAD, clip.n_frames);
  for (let k = 1; clip === state.clip && k < last; k++) image(clip, (frame + k) % clip.n_frames);
}

function image(clip, frame) {
  clip.images ??= [];
  if (!clip.images[frame]) {
    const made = clip.images[frame] = new Image();
    made.src = frameAddress(clip.name, frame);
    made.decode().then(() => set({ loaded: performance.now() }), () => {});
  }
  return clip.images[frame];
}

on(["frame", "clip"], load);
on(["frame", "view", "loaded", "clip", "flickered", "pixels", "resized"], drawPicture);
on(["brightness", "contrast"], () => {
  const { brightness, contrast } = state;
  canvas.style.filter = brightness === 1 && contrast === 1 ? "" : `brightness(${brightness}) contrast(${contrast})`;
});
