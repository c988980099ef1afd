// Trajectories and their trails, one path per colour, on a layer of their own: dragging a region does not
// draw them again.

import { PROBLEM, colourOfLength, colourOfTrack } from "./colours.js";

const TRAIL = 6;

export class Tracks {
  #groups = [];
  #lengths = null;

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
    const { tracks, view, colouring, flickered } = this.state;
    if (!tracks || !view || colouring === "none") return;
    const frame = flickered ?? this.state.frame;
    const size = Math.min(5, Math.max(2, view.scale * 1.2));
    for (const { colour, rows } of this.#groups) {
      if (this.state.problems && colour !== PROBLEM) continue;
      if (this.state.trails) this.#drawTrails(context, rows, frame, colour);
      this.#drawPoints(context, rows, frame, colour, size);
    }
    const caught = this.state.lassoed;
    if (caught?.frame === frame) this.#drawPoints(context, caught.rows, frame, "#ffffff", size + 2);
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

  #drawPoints(context, rows, frame, colour, size) {
    const { tracks: { xy, frames }, view } = this.state;
    context.fillStyle = colour;
    context.beginPath();
    for (const row of rows) {
      const at = 2 * (row * frames + frame);
      const x = xy[at];
      if (x === x) {
        context.rect((x - view.x) * view.scale - size / 2, (xy[at + 1] - view.y) * view.scale - size / 2, size, size);
      }
    }
    context.fill();
  }

  #drawTrails(context, rows, frame, colour) {
    const { tracks: { xy, frames }, view } = this.state;
    context.strokeStyle = colour;
    context.globalAlpha = 0.55;
    context.lineWidth = 1;
    context.beginPath();
    for (const row of rows) {
      const start = 2 * row * frames;
      if (xy[start + 2 * frame] !== xy[start + 2 * frame]) continue;
      let drawing = false;
      for (let k = Math.max(0, frame - TRAIL); k <= frame; k++) {
        const x = xy[start + 2 * k];
        if (x !== x) continue;
        const sx = (x - view.x) * view.scale;
        const sy = (xy[start + 2 * k + 1] - view.y) * view.scale;
        if (drawing) context.lineTo(sx, sy);
        else context.moveTo(sx, sy);
        drawing = true;
      }
    }
    context.stroke();
    context.globalAlpha = 1;
  }
}
