// Trajectories and their trails, one path per colour, on a layer of their own: dragging a region does not
// draw them again.

import { PROBLEM, colourOfLength, colourOfTrack } from "./colours.js";

const TRAIL = 6;
// What needs a person's eye is drawn larger.
const LARGER = 3;

export class Tracks {
  #groups = [];
  #lengths = null;
  #built = null;

  constructor(state, layer) {
    this.state = state;
    this.layer = layer;
    state.on(["tracks", "labels", "colouring"], () => this.#group());
    state.on(
      ["tracks", "labels", "colouring", "frame", "view", "trails", "problems", "lassoed", "flickered"],
      () => this.draw());
  }

  draw() {
    const context = this.layer.begin();
    const { tracks, view, colouring, flickered, lassoed } = this.state;
    if (!tracks || !view || colouring === "none") return;
    const frame = flickered ?? this.state.frame;
    const size = Math.min(5, Math.max(2, view.scale * 1.2));
    if (this.#built?.frame !== frame || this.#built.scale !== view.scale) this.#build(frame, view, size);
    // Panning only moves the paths.
    context.translate((this.#built.x - view.x) * view.scale, (this.#built.y - view.y) * view.scale);
    context.lineWidth = 1;
    for (const { colour, points, trails, ground } of this.#built.paths) {
      if (this.state.problems && colour !== PROBLEM) continue;
      if (this.state.trails) {
        context.globalAlpha = 0.55;
        context.strokeStyle = colour;
        context.stroke(trails);
      }
      context.globalAlpha = 1;
      context.fillStyle = "#0b0d1090";
      context.fill(ground);
      context.fillStyle = colour;
      context.fill(points);
    }
    if (lassoed?.frame === frame) {
      context.fillStyle = "#ffffff";
      context.fill(this.#points(lassoed.rows, frame, this.#built, size + 2));
    }
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
    this.#built = null;
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

  #build(frame, view, size) {
    const paths = this.#groups.map(({ colour, rows }) => {
      const side = colour === PROBLEM ? size + LARGER : size;
      return {
        colour, points: this.#points(rows, frame, view, side), trails: this.#trails(rows, frame, view),
        ground: this.#points(rows, frame, view, side + 1.4),
      };
    });
    this.#built = { frame, x: view.x, y: view.y, scale: view.scale, paths };
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
