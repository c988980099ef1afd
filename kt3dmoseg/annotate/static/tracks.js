// The trajectories: fetched, labelled by the server, drawn on a layer of their own, so that dragging a region
// does not draw them again.

import * as api from "./api.js";
import { PROBLEM, begin, byId, colourOfLength, colourOfTrack } from "./dom.js";
import { clamp } from "./geometry.js";
import { attempt, now, on, notify, set, state } from "./state.js";
import { goTo, showPoint, toScreen } from "./view.js";

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
    if (answer.xy) {
      set({ tracks: answer, computing: null });
      attempt(async () => {
        const moving = await api.getMoving(clip.name);
        if (clip === state.clip) set({ moving });
      });
    }
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
    const { regions, weak } = await api.post(clip.name, "regions", doc, own.signal);
    if (current() && regions) set({ regions, weak });
    const labels = await api.post(clip.name, "labels", doc, own.signal);
    if (current() && labels.label) set({ labels });
  } catch {
    // Offline or refused: saving reports it; the last labels stay.
  }
}

/** Where a trajectory is in a frame; undefined where it is not seen. */
function position(row, frame) {
  const { xy, frames } = state.tracks;
  const at = 2 * (row * frames + frame);
  return Number.isNaN(xy[at]) ? undefined : [xy[at], xy[at + 1]];
}

const rowsOf = (tracks) => [...Array(tracks?.count ?? 0).keys()];

const framesOf = (row) => [...Array(state.tracks.frames).keys()].filter((frame) => position(row, frame));

/** Rows of the trajectories whose position in a frame satisfies a test. */
export const rowsWhere = (frame, test) => rowsOf(state.tracks).filter((row) => {
  const point = position(row, frame);
  return point && test(point);
});

/** Show one trajectory in one frame. */
export function showTrack(row, frame) {
  goTo(frame);
  showPoint(position(row, frame));
}

let problem = -1;

/** Go to the next trajectory that is unlabelled or in conflict. */
export function nextProblem() {
  const { labels } = state;
  const rows = labels ? [...labels.reason.keys()].filter((row) => [2, 3].includes(labels.reason[row])) : [];
  if (!rows.length) return notify("No trajectory is unlabelled or in conflict");
  problem = (problem + 1) % rows.length;
  const row = rows[problem];
  const frames = framesOf(row);
  showTrack(row, frames[Math.floor(frames.length / 2)]);
  const reason = labels.reason[row] === 3 ? "in conflict" : "too short to label";
  notify(`trajectory ${row} is ${reason} (${problem + 1} of ${rows.length}); lasso it with Q`);
}

/** Groups that move by themselves but are mostly labelled as background: their rows; null while not known. */
export function unexplained() {
  const { moving, labels } = state;
  if (!moving || !labels) return null;
  const groups = Map.groupBy(rowsOf(state.tracks).filter((row) => moving[row] > 1), (row) => moving[row]);
  const open = (rows) => rows.filter((row) => labels.label[row] === 1).length > rows.length / 2;
  return [...groups.values()].filter(open);
}

let place = -1;

/** Go to the next motion that no object explains. */
export function nextUnexplained() {
  const found = unexplained();
  if (!found?.length) return notify(found ? "No motion is left to check" : "The scene's motion is not known");
  place = (place + 1) % found.length;
  const rows = found[place];
  const row = rows[Math.floor(rows.length / 2)];
  const frames = framesOf(row);
  showTrack(row, frames[Math.floor(frames.length / 2)]);
  return notify(`${rows.length} trajectories seem to move by themselves here (${place + 1} of ${found.length})`);
}

const canvas = byId("tracks");
let groups = new Map();

/** Group the rows by colour: one path each. */
function group() {
  const { tracks, labels, colouring } = state;
  groups = Map.groupBy(rowsOf(tracks), (row) => (colouring === "length"
    ? colourOfLength(framesOf(row).length, tracks.frames)
    : colourOfTrack(labels?.label[row] ?? 1, labels?.reason[row] ?? 0)));
}

export function drawTracks() {
  const context = begin(canvas);
  const { tracks, view, colouring, flickered, lassoed } = state;
  if (!tracks || !view || colouring === "none") return;
  const frame = flickered ?? state.frame;
  const size = clamp(view.scale * 1.2, 2, 5);
  const fill = (rows, width, colour) => {
    context.fillStyle = colour;
    context.fill(squares(rows, frame, width));
  };
  for (const [colour, rows] of groups) {
    if (state.problems && colour !== PROBLEM) continue;
    const width = size + (colour === PROBLEM ? LARGER : 0);
    if (state.trails) {
      context.globalAlpha = 0.55;
      context.strokeStyle = colour;
      context.stroke(trails(rows, frame));
      context.globalAlpha = 1;
    }
    // Dark around each, to be seen on a bright ground.
    fill(rows, width + 1.4, "#0b0d1090");
    fill(rows, width, colour);
  }
  if (lassoed?.frame === frame) fill(lassoed.rows, size + 2, "#ffffff");
}

function squares(rows, frame, width) {
  const path = new Path2D();
  for (const row of rows) {
    const point = position(row, frame);
    if (!point) continue;
    const [x, y] = toScreen(point);
    path.rect(x - width / 2, y - width / 2, width, width);
  }
  return path;
}

function trails(rows, frame) {
  const path = new Path2D();
  for (const row of rows) {
    if (!position(row, frame)) continue;
    let step = "moveTo";
    for (let k = Math.max(0, frame - TRAIL); k <= frame; k++) {
      const point = position(row, k);
      if (!point) continue;
      path[step](...toScreen(point));
      step = "lineTo";
    }
  }
  return path;
}

now(["doc", "dragging", "tracks"], labelSoon);
on(["tracks", "labels", "colouring"], group);
on(["tracks", "labels", "colouring", "frame", "view", "trails", "problems", "lassoed", "flickered", "resized"],
  drawTracks);
