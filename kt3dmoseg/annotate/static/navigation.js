// Moving through frames and over the picture; nothing here changes the document.

import { boundsOf } from "./geometry.js";
import { regionOf } from "./region.js";
import { chosen, say } from "./selection.js";
import * as views from "./view.js";

const FRAME_TIME = 110;
const FLICKER_TIME = 220;

const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

// Frames

export function goTo(app, frame) {
  app.state.set({ frame: clamp(frame, 0, app.state.clip.n_frames - 1), vertex: null, lassoed: null });
}

export const step = (app, by) => goTo(app, app.state.frame + by);

export function play(app) {
  stopTimer(app, "flickerTimer", { flickered: null });
  if (stopTimer(app, "playTimer", { playing: false })) return;
  app.state.set({ playing: true });
  app.playTimer = setInterval(() => goTo(app, (app.state.frame + 1) % app.state.clip.n_frames), FRAME_TIME);
}

export function flicker(app) {
  stopTimer(app, "playTimer", { playing: false });
  if (stopTimer(app, "flickerTimer", { flickered: null })) return;
  const other = () => {
    const { frame, clip, flickered } = app.state;
    const next = frame + 1 < clip.n_frames ? frame + 1 : frame - 1;
    app.state.set({ flickered: flickered === null || flickered === frame ? next : frame });
  };
  other();
  app.flickerTimer = setInterval(other, FLICKER_TIME);
}

function stopTimer(app, name, changes) {
  if (!app[name]) return false;
  clearInterval(app[name]);
  app[name] = null;
  app.state.set(changes);
  return true;
}

export function toKeyFrame(app, direction) {
  const item = chosen(app);
  if (!item) return;
  const frames = item.key_frames.map((key) => key.frame).filter((f) => (f - app.state.frame) * direction > 0);
  if (frames.length) goTo(app, direction > 0 ? Math.min(...frames) : Math.max(...frames));
}

// View

export function zoom(app, factor, at = null) {
  const { view, pointer, cross } = app.state;
  const focus = at ?? (cross || pointer ? views.toScreen(view, cross ?? pointer) : app.screenMiddle());
  app.state.set({ view: views.zoomed(view, factor, focus, app.farthest()) });
}

export function pan(app, dx, dy) {
  const { view, clip } = app.state;
  app.state.set({ view: views.held(views.panned(view, dx, dy), clip.image_size, app.stage()) });
}

export function fitAll(app) {
  app.state.set({ view: views.fit(app.state.clip.image_size, app.stage()) });
}

export function fitObject(app) {
  const item = chosen(app);
  if (!item) return;
  const box = boundsOf(regionOf(app.state, item, app.state.frame).polygons);
  if (box) app.state.set({ view: views.around(box, app.stage()) });
  else say(app, `${item.name} is not in this frame`);
}

export const toggle = (app, name) => app.state.set({ [name]: !app.state[name] });

export function cycleColouring(app) {
  const order = ["label", "length", "none"];
  const colouring = order[(order.indexOf(app.state.colouring) + 1) % order.length];
  app.state.set({ colouring });
  say(app, { label: "Trajectories by label", length: "Trajectories by length", none: "No trajectories" }[colouring]);
}

export function brighten(app) {
  app.brightness = ((app.brightness ?? 0) + 1) % 3;
  app.pictureCanvas.className = `bright${app.brightness}`;
}

/** Go to the next trajectory that is unlabelled or in conflict. */
export function nextProblem(app) {
  const { labels, tracks } = app.state;
  const rows = labels ? [...labels.reason.keys()].filter((row) => labels.reason[row] === 2 || labels.reason[row] === 3) : [];
  if (!rows.length) return say(app, "No trajectory is unlabelled or in conflict");
  app.problem = ((app.problem ?? -1) + 1) % rows.length;
  const row = rows[app.problem];
  const seen = [...Array(tracks.frames).keys()].filter((f) => !Number.isNaN(tracks.xy[2 * (row * tracks.frames + f)]));
  show(app, row, seen[Math.floor(seen.length / 2)]);
  const reason = labels.reason[row] === 3 ? "in conflict" : "too short to tell";
  say(app, `trajectory ${row} is ${reason} (${app.problem + 1} of ${rows.length}); lasso it with Q`);
}

/** Show one trajectory in one frame. */
export function show(app, row, frame) {
  const { tracks } = app.state;
  const at = 2 * (row * tracks.frames + frame);
  const point = [tracks.xy[at], tracks.xy[at + 1]];
  goTo(app, frame);
  const scale = Math.max(app.state.view.scale, 4);
  app.state.set({ cross: point, view: views.centred(...point, scale, app.stage()) });
}
