// The trajectories: fetched, labelled by the server, drawn on a layer of their own, so that dragging a region
// does not draw them again.

import { clamp } from "./annotation.js";
import { ask, request } from "./saving.js";
import { PROBLEM, begin, byId, colourOfLength, colourOfTrack } from "./dom.js";
import { now, on, notify, set, state } from "./state.js";
import { goTo, showPoint, toScreen } from "./view.js";

const SOON = 40;
const POLL = 400;
const TRAIL = 6;
// What needs a person's eye is drawn larger.
const LARGER = 3;

/** Trajectories as { xy: Float32Array, count, frames }, or { done, total } while they are computed. */
async function getTracks(clip) {
  const response = await request(clip, "tracks");
  if (response.status === 202) return response.json();
  const [count, frames] = response.headers.get("x-shape").split(",").map(Number);
  return { xy: new Float32Array(await response.arrayBuffer()), count, frames };
}

/** Fetch the trajectories of the clip, waiting while the server computes them. */
export async function loadTracks(clip) {
  let answer = {};
  while (!answer.xy) {
    answer = await getTracks(clip.name).catch((error) => ({ error }));
    if (clip !== state.clip) return;
    set(answer.xy ? { tracks: answer, computing: null } : { computing: progressText(answer) });
    if (answer.error && !answer.error.offline) return;
    if (!answer.xy) await new Promise((resolve) => setTimeout(resolve, POLL));
  }
  const { groups } = await ask(clip.name, "moving");
  if (clip === state.clip) set({ moving: groups });
}

function progressText({ error, done, total }) {
  if (!error) return `trajectories: frame ${done} of ${total}`;
  return error.offline ? "waiting for the server" : `no trajectories: ${error.message}`;
}

let timer = 0;
let controller = new AbortController();

function labelSoon() {
  if (state.dragging || !state.tracks || !state.doc) return;
  clearTimeout(timer);
  timer = setTimeout(label, SOON);
}

/** Ask the server what the document means. */
async function label() {
  controller.abort();
  controller = new AbortController();
  const { signal } = controller;
  const { clip, doc } = state;
  try {
    // Regions first: they take a fraction of the time, and the next frame waits for them.
    for (const what of ["regions", "labels"]) {
      const { regions, weak, ...labels } = await ask(clip.name, what, doc, { signal });
      if (clip !== state.clip || signal.aborted) return;
      if (regions) set({ regions, weak });
      else if (labels.label) set({ labels });
    }
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

const range = (count) => [...Array(count).keys()];
const rows = () => range(state.tracks?.count ?? 0);
const framesOf = (row) => range(state.tracks.frames).filter((frame) => position(row, frame));

/** Rows of the trajectories whose position in a frame satisfies a test. */
export const rowsWhere = (frame, test) => rows().filter((row) => {
  const point = position(row, frame);
  return point && test(point);
});

/** Show one trajectory in one frame, without a frame in the middle of those in which it is seen. */
export function showTrack(row, frame = framesOf(row)[Math.floor(framesOf(row).length / 2)]) {
  goTo(frame);
  showPoint(position(row, frame));
}

const last = {};

/** Go to the next of what is to be looked at, and say which of how many it is. */
export function visitNext(kind, places, nothing, visit, at = ((last[kind] ?? -1) + 1) % places.length) {
  if (!places.length) return notify(nothing);
  last[kind] = at;
  return notify(visit(places[at], `${at + 1} of ${places.length}`));
}

/** Rows of the trajectories without a label, of those that a motion claims as well, or of all. */
export function problems(motion) {
  const { reason, claimed } = state.labels ?? { reason: [] };
  const open = [...reason.keys()].filter((row) => [2, 3].includes(reason[row]));
  return motion === undefined ? open : open.filter((row) => claimed[row] === motion);
}

export function nextProblem(motion) {
  const { reason } = state.labels ?? {};
  const own = problems(motion);
  visitNext("problem", own.length ? own : problems(), "No trajectory is unlabelled or in conflict", (row, which) => {
    showTrack(row);
    const why = reason[row] === 3 ? "in conflict" : "too short to label";
    return `trajectory ${row} is ${why} (${which}); lasso it with Q`;
  });
}

/** Groups that seem to move by themselves but are mostly labelled as background: their rows; null while not known. */
function unexplained() {
  const { moving, labels } = state;
  if (!moving || !labels) return null;
  const found = Map.groupBy(rows().filter((row) => moving[row] > 1), (row) => moving[row]);
  const open = (group) => group.filter((row) => labels.label[row] === 1).length > group.length / 2;
  return [...found.values()].filter(open);
}

export function nextUnexplained() {
  const found = unexplained();
  const nothing = found ? "No trajectories seem to move by themselves" : "The scene's motion is not known";
  visitNext("motion", found ?? [], nothing, (group, which) => {
    showTrack(group[Math.floor(group.length / 2)]);
    return `${group.length} trajectories leave the motion of the scene (${which}): a mover, or an error of tracking`;
  });
}

const canvas = byId("tracks");
let groups = new Map();

function group() {
  const { tracks, labels, colouring } = state;
  groups = Map.groupBy(rows(), (row) => (colouring === "length"
    ? colourOfLength(framesOf(row).length / tracks.frames)
    : colourOfTrack(labels?.label[row] ?? 1, labels?.reason[row] ?? 0)));
}

export function drawTracks() {
  const context = begin(canvas);
  const { tracks, view, colouring, flickered, lassoed } = state;
  if (!tracks || !view || colouring === "none") return;
  const frame = flickered ?? state.frame;
  const size = clamp(view.scale * 1.2, 2, 5);
  const squares = (chosen, width, colour) => {
    const path = new Path2D();
    for (const row of chosen) {
      const point = position(row, frame);
      if (!point) continue;
      const [x, y] = toScreen(point);
      path.rect(x - width / 2, y - width / 2, width, width);
    }
    context.fillStyle = colour;
    context.fill(path);
  };
  for (const [colour, chosen] of groups) {
    if (state.problems && colour !== PROBLEM) continue;
    const width = size + (colour === PROBLEM ? LARGER : 0);
    if (state.trails) {
      context.globalAlpha = 0.55;
      context.strokeStyle = colour;
      context.stroke(trails(chosen, frame));
      context.globalAlpha = 1;
    }
    // Dark around each, to be seen on a bright ground.
    squares(chosen, width + 1.4, "#0b0d1090");
    squares(chosen, width, colour);
  }
  if (lassoed?.frame === frame) squares(lassoed.rows, size + 2, "#ffffff");
}

function trails(chosen, frame) {
  const path = new Path2D();
  for (const row of chosen) {
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
now(["tracks", "labels", "colouring"], group);
on(["tracks", "labels", "colouring", "frame", "view", "trails", "problems", "lassoed", "flickered", "resized"],
  drawTracks);
