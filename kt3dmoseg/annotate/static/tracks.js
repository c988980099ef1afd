// The trajectories: fetched, labelled by the server, drawn on a layer of their own, so that dragging a region
// does not draw them again.

import { clamp, inside } from "./annotation.js";
import { ask, request } from "./saving.js";
import { PROBLEM, begin, byId, colourOfLength, colourOfTrack, sized } from "./dom.js";
import { now, on, notify, regionOf, set, state } from "./state.js";
import { goTo, showPoint } from "./view.js";

export const NOT_YET = "The trajectories are not there yet";

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
let missed = false; // what the server should have answered
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
  missed = false;
  try {
    // Regions first: they take a fraction of the time, and the next frame waits for them.
    for (const what of ["regions", "labels"]) {
      const { regions, weak, ...labels } = await ask(clip.name, what, doc, { signal });
      if (clip !== state.clip || signal.aborted) return;
      if (regions) set({ regions, weak, carried: doc });
      else if (labels.label) set({ labels });
    }
  } catch ({ status }) {
    missed = !signal.aborted;
    // Offline or refused: saving reports it; the last labels stay. After a restart the server needs a while.
    if (status === 202 && !signal.aborted) timer = setTimeout(label, POLL);
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

/** Rows of the trajectories without a label, by the id of the object in whose region each is most; 0 in none. */
export function problems() {
  const { reason } = state.labels ?? { reason: [] };
  return found ??= Map.groupBy([...reason.keys()].filter((row) => [2, 3].includes(reason[row])), holder);
}

let found = null;
now(["labels"], () => (found = null));

function holder(row) {
  const held = state.doc.objects.map((item) => framesOf(row).filter((frame) =>
    regionOf(item, frame).polygons.some((polygon) => inside(position(row, frame), polygon))).length);
  const most = Math.max(0, ...held);
  return most && state.doc.objects[held.indexOf(most)].id;
}

export function nextProblem(id) {
  const { reason } = state.labels ?? {};
  const places = problems().get(id) ?? [...problems().values()].flat();
  const nothing = state.labels ? "No trajectory is unlabelled or in conflict" : NOT_YET;
  visitNext("problem", places, nothing, (row, which) => {
    showTrack(row);
    const why = reason[row] === 3 ? "in conflict" : "too short to label";
    return `trajectory ${row} is ${why} (${which}); lasso it with Q`;
  });
}

/** Go to the next group that seems to move by itself but is mostly labelled as background. */
export function nextUnexplained() {
  const { moving, labels } = state;
  const found = Map.groupBy(rows().filter((row) => moving?.[row] > 1), (row) => moving[row]);
  const open = (group) => group.filter((row) => labels?.label[row] === 1).length > group.length / 2;
  const nothing = moving && labels ? "No trajectories seem to move by themselves" : "The scene's motion is not known";
  visitNext("motion", [...found.values()].filter(open), nothing, (group, which) => {
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

// What was painted last, with a border around what was in sight: panning shifts it, zooming scales it until it rests.
const BORDER = 200;
const REST = 200;
let painted = null;
let rest = 0;

export function drawTracks() {
  const context = begin(canvas);
  const { tracks, view, colouring, trails, problems, lassoed } = state;
  if (!tracks || !view || colouring === "none") return;
  clearTimeout(rest);
  const { clientWidth, clientHeight } = canvas;
  const frame = state.flickered ?? state.frame;
  const what = [frame, groups, trails, problems, lassoed, clientWidth, clientHeight, devicePixelRatio];
  if (!what.every((value, k) => value === painted?.what[k]) || !near(view)) painted = paint(view, frame, what);
  const zoom = view.scale / painted.view.scale;
  const [left, top] = ["x", "y"].map((axis) => (painted.view[axis] - view[axis]) * view.scale - BORDER * zoom);
  context.drawImage(painted.image, left, top, (clientWidth + 2 * BORDER) * zoom, (clientHeight + 2 * BORDER) * zoom);
  if (zoom !== 1) rest = setTimeout(() => (painted = null, drawTracks()), REST);
}

/** Whether what was painted serves a view: shifted by no more than the border, or about as large. */
function near({ x, y, scale }) {
  const { view } = painted;
  if (scale !== view.scale) return scale / view.scale > 0.5 && scale / view.scale < 2;
  return Math.max(Math.abs(x - view.x), Math.abs(y - view.y)) * scale <= BORDER;
}

function paint(view, frame, what) {
  const { tracks: { xy, frames }, trails, problems, lassoed } = state;
  const { x, y, scale } = view;
  const image = new OffscreenCanvas(1, 1);
  const context = sized(image, canvas.clientWidth + 2 * BORDER, canvas.clientHeight + 2 * BORDER);
  context.translate(BORDER - x * scale, BORDER - y * scale);
  context.scale(scale, scale);
  context.lineWidth = 1 / scale;
  const shown = (chosen) => chosen.map((row) => 2 * (row * frames + frame)).filter((at) => !Number.isNaN(xy[at]));
  const squares = (all, pixels, colour) => {
    const side = pixels / scale;
    context.fillStyle = colour;
    for (const at of all) context.fillRect(xy[at] - side / 2, xy[at + 1] - side / 2, side, side);
  };
  for (const [colour, chosen] of groups) {
    if (problems && colour !== PROBLEM) continue;
    const all = shown(chosen);
    const size = clamp(scale * 1.2, 2, 5) + (colour === PROBLEM ? LARGER : 0);
    if (trails) drawTrails(context, all, 2 * Math.min(frame, TRAIL), colour);
    squares(all, size + 1.4, "#0b0d1090"); // dark around each, to be seen on a bright ground
    squares(all, size, colour);
  }
  if (lassoed?.frame === frame) squares(shown(lassoed.rows), clamp(scale * 1.2, 2, 5) + 2, "#ffffff");
  return { image, view, what };
}

function drawTrails(context, all, length, colour) {
  const { xy } = state.tracks;
  context.globalAlpha = 0.55;
  context.strokeStyle = colour;
  context.beginPath();
  for (const at of all) {
    context.moveTo(xy[at], xy[at + 1]);
    for (let k = at - 2; k >= at - length; k -= 2) context.lineTo(xy[k], xy[k + 1]); // none to NaN: unseen
  }
  context.stroke();
  context.globalAlpha = 1;
}

now(["doc", "dragging", "tracks"], labelSoon);
now(["saving"], () => missed && state.saving.kind === "saved" && labelSoon());
now(["tracks", "labels", "colouring"], group);
on(["tracks", "labels", "colouring", "frame", "view", "trails", "problems", "lassoed", "flickered", "resized"],
  drawTracks);
