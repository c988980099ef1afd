// Trajectories and their trails, on a layer of their own: dragging a region does not draw them again, and
// panning only moves a sheet that is larger than the stage.

import { PROBLEM, colourOfLength, colourOfTrack } from "./colours.js";

const TRAIL = 6;
const MARGIN = 200;
// What needs a person's eye is drawn larger.
const LARGER = 3;

export class Tracks {
  #groups = [];
  #lengths = null;
  #sheet = null;

  constructor(state, layer) {
    this.state = state;
    this.layer = layer;
    state.on(["tracks", "labels", "colouring"], () => this.#group());
    state.on(
      ["tracks", "labels", "colouring", "frame", "view", "trails", "problems", "lassoed", "flickered", "resized"],
      () => this.draw());
  }

  draw() {
    const context = this.layer.begin();
    const { tracks, view, colouring, flickered, lassoed } = this.state;
    if (!tracks || !view || colouring === "none") return;
    const frame = flickered ?? this.state.frame;
    const sheet = this.#sheetFor(frame, view);
    const ratio = devicePixelRatio || 1;
    // To whole pixels of the screen, so that points stay sharp.
    const [x, y] = this.#offset(sheet, view).map((v) => Math.round((v - MARGIN) * ratio) / ratio);
    context.drawImage(sheet.canvas, x, y, sheet.canvas.width / ratio, sheet.canvas.height / ratio);
    if (lassoed?.frame === frame) {
      context.fillStyle = "#ffffff";
      context.fill(this.#points(lassoed.rows, frame, view, this.#size(view) + 2));
    }
  }

  #size(view) {
    return Math.min(5, Math.max(2, view.scale * 1.2));
  }

  #offset(sheet, view) {
    return [(sheet.view.x - view.x) * view.scale, (sheet.view.y - view.y) * view.scale];
  }

  /** The sheet in use, or a new one where that shows something else or was panned away. */
  #sheetFor(frame, view) {
    const { trails, problems } = this.state;
    const { width, height } = this.layer.canvas;
    const key = [frame, view.scale, trails, problems, width, height].join();
    if (this.#sheet?.key !== key || this.#offset(this.#sheet, view).some((v) => Math.abs(v) > MARGIN)) {
      this.#sheet = { key, view, canvas: this.#render(frame, view, width, height) };
    }
    return this.#sheet;
  }

  #render(frame, view, width, height) {
    const ratio = devicePixelRatio || 1;
    const canvas = new OffscreenCanvas(width + 2 * MARGIN * ratio, height + 2 * MARGIN * ratio);
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, MARGIN * ratio, MARGIN * ratio);
    context.lineWidth = 1;
    for (const { colour, rows } of this.#groups) {
      if (this.state.problems && colour !== PROBLEM) continue;
      const size = this.#size(view) + (colour === PROBLEM ? LARGER : 0);
      if (this.state.trails) {
        context.globalAlpha = 0.55;
        context.strokeStyle = colour;
        context.stroke(this.#trails(rows, frame, view));
        context.globalAlpha = 1;
      }
      // Dark around each, to be seen on a bright ground.
      context.fillStyle = "#0b0d1090";
      context.fill(this.#points(rows, frame, view, size + 1.4));
      context.fillStyle = colour;
      context.fill(this.#points(rows, frame, view, size));
    }
    return canvas;
  }

  /** Rows of the trajectories that are visible in a frame and satisfy a test of their position. */
  rowsWhere(frame, test) {
    const { tracks } = this.state;
    const rows = [];
    for (let row = 0; tracks && row < tracks.count; row++) {
      const at = 2 * (row * tracks.frames + frame);
      const x = tracks.xy[at];
      if (x === x && test([x, tracks.xy[at + 1]], row)) rows.push(row);
    }
    return rows;
  }

  #group() {
    const { tracks, labels, colouring } = this.state;
    const byColour = new Map();
    if (colouring === "length" && tracks) this.#measure(tracks);
    for (let row = 0; tracks && row < tracks.count; row++) {
      const colour = colouring === "length"
        ? colourOfLength(this.#lengths[row], tracks.frames)
        : colourOfTrack(labels?.label[row] ?? 1, labels?.reason[row] ?? 0);
      if (!byColour.has(colour)) byColour.set(colour, []);
      byColour.get(colour).push(row);
    }
    this.#sheet = null;
    this.#groups = [...byColour].map(([colour, rows]) => ({ colour, rows }));
  }

  #measure(tracks) {
    this.#lengths = new Int32Array(tracks.count);
    for (let row = 0; row < tracks.count; row++) {
      for (let frame = 0; frame < tracks.frames; frame++) {
        const x = tracks.xy[2 * (row * tracks.frames + frame)];
        if (x === x) this.#lengths[row]++;
      }
    }
  }

  #points(rows, frame, view, size) {
    const { xy, frames } = this.state.tracks;
    const path = new Path2D();
    for (const row of rows) {
      const at = 2 * (row * frames + frame);
      const x = xy[at];
      if (x === x) {
        path.rect((x - view.x) * view.scale - size / 2, (xy[at + 1] - view.y) * view.scale - size / 2, size, size);
      }
    }
    return path;
  }

  #trails(rows, frame, view) {
    const { xy, frames } = this.state.tracks;
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
}
