// The trajectories: fetched, labelled by the server, drawn on a layer of their own, so that dragging a region
// does not draw them again.

import * as api from "./api.js";
import { PROBLEM, begin, byId, colourOfLength, colourOfTrack } from "./dom.js";
import { clamp } from "./geometry.js";
import { now, on, set, state } from "./state.js";

const SOON = 40;
const POLL = 400;
const TRAIL = 6;
// What needs a person's eye is drawn larger.
const LARGER = 3;

/** Fetch the trajectories of the clip, waiting while the server computes them. */
export async function loadTracks(clip) {
  let wait = true;
  while (wait && clip === state.clip) {
    const answer = await api.getTracks(clip.name).catch((error) => ({ error }));
    if (clip !== state.clip) return;
    if (answer.xy) set({ tracks: answer, computing: null });
    else set({ computing: progressText(answer) });
    wait = !answer.xy && (!answer.error || answer.error.offline);
    if (wait) await new Promise((resolve) => setTimeout(resolve, POLL));
  }
}

function progressText({ error, done, total }) {
  if (!error) return `trajectories: frame ${done} of ${total}`;
  return error.offline ? "waiting for the server" : `no trajectories: ${error.message}`;
}

let timer = 0;
let controller = null;

function labelSoon() {
  if (state.dragging || !state.tracks || !state.doc) return;
  clearTimeout(timer);
  timer = setTimeout(label, SOON);
}

/** Ask the server what the document means. */
async function label() {
  controller?.abort();
  const own = (controller = new AbortController());
  const { clip, doc } = state;
  const current = () => clip === state.clip && own === controller;
  try {
    // Regions first: they take a fraction of the time, and the next frame waits for them.
    const { regions } = await api.regions(clip.name, doc, own.signal);
    if (current() && regions) set({ regions });
    const labels = await api.labels(clip.name, doc, own.signal);
    if (current() && labels.label) set({ labels });
  } catch {
    // Offline or refused: saving reports it; the last labels stay.
  }
}

/** Rows of the trajectories that are visible in a frame and satisfy a test of their position. */
export function rowsWhere(frame, test) {
  const { tracks } = state;
  const rows = [];
  for (let row = 0; tracks && row < tracks.count; row++) {
    const at = 2 * (row * tracks.frames + frame);
    const x = tracks.xy[at];
    if (x === x && test([x, tracks.xy[at + 1]])) rows.push(row);
  }
  return rows;
}

const canvas = byId("tracks");
let groups = [];

/** Group the rows by colour: one path each. */
function group() {
  const { tracks, labels, colouring } = state;
  const byColour = new Map();
  for (let row = 0; tracks && row < tracks.count; row++) {
    const colour = colouring === "length"
      ? colourOfLength(lengthOf(row), tracks.frames)
      : colourOfTrack(labels?.label[row] ?? 1, labels?.reason[row] ?? 0);
    if (!byColour.has(colour)) byColour.set(colour, []);
    byColour.get(colour).push(row);
  }
  groups = [...byColour].map(([colour, rows]) => ({ colour, rows }));
}

function lengthOf(row) {
  const { xy, frames } = state.tracks;
  let length = 0;
  for (let frame = 0; frame < frames; frame++) length += !Number.isNaN(xy[2 * (row * frames + frame)]);
  return length;
}

export function drawTracks() {
  const context = begin(canvas);
  const { tracks, view, colouring, flickered, lassoed } = state;
  if (!tracks || !view || colouring === "none") return;
  const frame = flickered ?? state.frame;
  const size = clamp(view.scale * 1.2, 2, 5);
  for (const { colour, rows } of groups) {
    if (state.problems && colour !== PROBLEM) continue;
    const wide = size + (colour === PROBLEM ? LARGER : 0);
    if (state.trails) {
      context.globalAlpha = 0.55;
      context.lineWidth = 1;
      context.strokeStyle = colour;
      context.stroke(trails(rows, frame, view));
      context.globalAlpha = 1;
    }
    // Dark around each, to be seen on a bright ground.
    context.fillStyle = "#0b0d1090";
    context.fill(points(rows, frame, view, wide + 1.4));
    context.fillStyle = colour;
    context.fill(points(rows, frame, view, wide));
  }
  if (lassoed?.frame === frame) {
    context.fillStyle = "#ffffff";
    context.fill(points(lassoed.rows, frame, view, size + 2));
  }
}

function points(rows, frame, view, wide) {
  const { xy, frames } = state.tracks;
  const path = new Path2D();
  for (const row of rows) {
    const at = 2 * (row * frames + frame);
    const x = xy[at];
    if (x === x) {
      path.rect((x - view.x) * view.scale - wide / 2, (xy[at + 1] - view.y) * view.scale - wide / 2, wide, wide);
    }
  }
  return path;
}

function trails(rows, frame, view) {
  const { xy, frames } = state.tracks;
  const path = new Path2D();
  for (const row of rows) {
    const start = 2 * row * frames;
    if (xy[start + 2 * frame] !== xy[start + 2 * frame]) continue;
    let drawing = false;
    for (let k = Math.max(0, frame - TRAIL); k <= frame; k++) {
      const x = xy[start + 2 * k];
      if (x !== x) continue;
      const sx = (x - view.x) * view.scale;
      const sy = (xy[start + 2 * k + 1] - view.y) * view.scale;
      if (drawing) path.lineTo(sx, sy);
      else path.moveTo(sx, sy);
      drawing = true;
    }
  }
  return path;
}

now(["doc", "dragging", "tracks"], labelSoon);
on(["tracks", "labels", "colouring"], group);
on(["tracks", "labels", "colouring", "frame", "view", "trails", "problems", "lassoed", "flickered", "resized"],
  drawTracks);
