// The frames, moving through them and over the picture; nothing here changes the document. The view is the
// image position { x, y } of the stage's top left corner, and the scale.

import { regionIn } from "./annotation.js";
import { frameAddress } from "./api.js";
import { begin, byId } from "./dom.js";
import { boundsOf, clamp } from "./geometry.js";
import { chosen, on, notify, set, state } from "./state.js";

// Frames after the shown one that are fetched ahead.
const AHEAD = 40;
const FRAME_TIME = 110;
const FLICKER_TIME = 220;
const CLOSEST = 40;
// So many pixels of the screen always show a part of the frame.
const KEPT = 60;

// Frames

export function goTo(frame) {
  set({ frame: clamp(frame, 0, state.clip.n_frames - 1), vertex: null, lassoed: null });
}

/** The number of a frame: that in the name of its file, where each has its own. */
export const numberOf = (frame) => state.clip.numbers[frame];

export function numbersOf(names) {
  const found = names.map((name) => /(\d+)\D*$/.exec(name.replace(/\.[^.]*$/, ""))?.[1]);
  const distinct = found.every(Boolean) && new Set(found.map(Number)).size === names.length;
  return names.map((_, frame) => String(distinct ? Number(found[frame]) : frame));
}

export const step = (by) => goTo(state.frame + by);

let timer = 0;

/** Stop playing and flickering. */
export function stop() {
  clearInterval(timer);
  set({ playing: false, flickered: null });
}

export function play() {
  const { playing } = state;
  stop();
  if (playing) return;
  set({ playing: true });
  timer = setInterval(() => goTo((state.frame + 1) % state.clip.n_frames), FRAME_TIME);
}

export function flicker() {
  const flickering = state.flickered !== null;
  stop();
  if (flickering) return;
  const other = () => {
    const { frame, clip, flickered } = state;
    const next = frame + 1 < clip.n_frames ? frame + 1 : frame - 1;
    set({ flickered: flickered === null || flickered === frame ? next : frame });
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

const stage = () => ({ width: byId("stage").clientWidth, height: byId("stage").clientHeight });

const middle = () => [stage().width / 2, stage().height / 2];

/** The middle of what is in sight, on the image. */
export const inSight = () => toImage(middle());

function centred(x, y, scale) {
  const { width, height } = stage();
  return { x: x - width / scale / 2, y: y - height / scale / 2, scale };
}

/** The view of the whole frame. */
export function fit([width, height]) {
  const scale = Math.min(stage().width / width, stage().height / height);
  return centred((width - 1) / 2, (height - 1) / 2, scale);
}

export const fitAll = () => set({ view: fit(state.clip.image_size) });

/** Show a box with some surroundings. */
export function showBox([left, top, right, bottom]) {
  const { width, height } = stage();
  const scale = Math.min(CLOSEST / 2, (0.6 * width) / (right - left + 8), (0.6 * height) / (bottom - top + 8));
  set({ view: centred((left + right) / 2, (top + bottom) / 2, scale) });
}

/** Zoom in on a point, and put the cross there. */
export const showPoint = (cross) => set({ cross, view: centred(...cross, Math.max(state.view.scale, 4)) });

export function fitObject() {
  const item = chosen();
  if (!item) return;
  const box = boundsOf(regionIn(item, state.frame, state.regions).polygons);
  if (box) showBox(box);
  else notify(`${item.name} is not in this frame`);
}

/** Zoom by a factor; what is under the screen point stays there. */
export function zoom(factor, at = null) {
  const { view, pointer, cross, clip } = state;
  const focus = at ?? (cross || pointer ? toScreen(cross ?? pointer) : middle());
  const scale = clamp(view.scale * factor, fit(clip.image_size).scale * 0.5, CLOSEST);
  const [x, y] = toImage(focus);
  set({ view: { x: x - focus[0] / scale, y: y - focus[1] / scale, scale } });
}

/** Pan, but not until next to nothing of the frame is left in sight. */
export function pan(dx, dy) {
  const { view: { x, y, scale }, clip } = state;
  const [width, height] = clip.image_size;
  const held = (at, size, room) => Math.min(size - KEPT / scale, Math.max(at, (KEPT - room) / scale));
  const [left, top] = [held(x - dx / scale, width, stage().width), held(y - dy / scale, height, stage().height)];
  set({ view: { x: left, y: top, scale } });
}

// What is shown

export const toggle = (name) => set({ [name]: !state[name] });

export const brighten = () => set({ brightness: (state.brightness + 1) % 3 });

/** Regions are filled as usual, strongly, or not at all. */
export const cycleOpacity = () => set({ opacity: { 1: 3, 3: 0, 0: 1 }[state.opacity] });

export function cycleColouring() {
  const order = ["label", "length", "none"];
  const colouring = order[(order.indexOf(state.colouring) + 1) % order.length];
  set({ colouring });
  notify({ label: "Trajectories by label", length: "Trajectories by length", none: "No trajectories" }[colouring]);
}

// The picture: frames are loaded once, the shown one first, then its neighbours

const canvas = byId("picture");
let clip = null;
let images = [];

export function drawPicture() {
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
on(["frame", "view", "loaded", "clip", "flickered"], drawPicture);
on(["brightness"], () => (canvas.className = `bright${state.brightness}`));
