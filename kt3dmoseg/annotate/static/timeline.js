// Key frames over time: one row per object, one column per frame.

import * as actions from "./actions.js";
import { colourOfMotion } from "./colours.js";
import { Layer } from "./layer.js";
import { regionOf } from "./region.js";

const HEAD = 26;
const ROW = 26;

export class Timeline {
  constructor(app, canvas) {
    this.app = app;
    this.canvas = canvas;
    this.layer = new Layer(canvas);
    app.state.on(["doc", "frame", "selected", "clip", "regions", "scrolled", "resized"], () => this.draw());
    canvas.addEventListener("pointerdown", (event) => this.#click(event));
    canvas.addEventListener("pointermove", (event) => event.buttons & 1 && this.#click(event));
  }

  draw() {
    const { state } = this.app;
    if (!state.doc) return;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    this.layer.resize(width, height);
    const context = this.layer.begin();
    const column = width / state.clip.n_frames;
    context.fillStyle = "#2f6f9660";
    context.fillRect(state.frame * column, 0, Math.max(2, column), height);
    state.doc.objects.forEach((item, k) => this.#drawRow(context, item, HEAD + k * ROW - (state.scrolled ?? 0), column, width));
    this.#drawHead(context, column, width);
  }

  #drawHead(context, column, width) {
    const { state } = this.app;
    context.fillStyle = "#1f2228";
    context.fillRect(0, 0, width, HEAD);
    context.fillStyle = "#2f6f96";
    context.fillRect(state.frame * column, 0, Math.max(2, column), HEAD);
    context.font = "11px ui-monospace, monospace";
    context.textAlign = "center";
    const every = Math.max(1, Math.ceil(28 / column));
    for (let frame = 0; frame < state.clip.n_frames; frame++) {
      if (frame % every && frame !== state.frame) continue;
      context.fillStyle = frame === state.frame ? "#ffffff" : "#a9b1bf";
      context.fillText(String(frame), (frame + 0.5) * column, 17);
    }
    context.textAlign = "left";
  }

  #drawRow(context, item, top, column, width) {
    if (top < 0 || top > this.canvas.clientHeight) return;
    const { state } = this.app;
    if (item.id === state.selected) {
      context.fillStyle = "#56b4e926";
      context.fillRect(0, top, width, ROW);
    }
    const colour = colourOfMotion(item.motion);
    for (let frame = 0; frame < state.clip.n_frames; frame++) {
      const region = regionOf(state, item, frame);
      const [left, middle] = [frame * column, top + ROW / 2];
      if (region.visibility !== "outside") {
        context.fillStyle = colour;
        context.globalAlpha = region.visibility === "occluded" ? 0.25 : 0.6;
        context.fillRect(left, middle - 3, column + 0.5, 6);
        context.globalAlpha = 1;
      }
      if (region.key) this.#drawKey(context, left + column / 2, middle, region.visibility, colour);
    }
  }

  #drawKey(context, x, y, visibility, colour) {
    context.beginPath();
    context.moveTo(x, y - 7);
    context.lineTo(x + 7, y);
    context.lineTo(x, y + 7);
    context.lineTo(x - 7, y);
    context.closePath();
    context.fillStyle = visibility === "visible" ? colour : "#1f2228";
    context.fill();
    context.strokeStyle = visibility === "visible" ? "#101216" : colour;
    context.lineWidth = 1.5;
    context.stroke();
  }

  #click(event) {
    const { state } = this.app;
    if (!state.doc) return;
    const box = this.canvas.getBoundingClientRect();
    const frame = Math.floor(((event.clientX - box.left) / box.width) * state.clip.n_frames);
    const row = Math.floor((event.clientY - box.top - HEAD + (state.scrolled ?? 0)) / ROW);
    actions.goTo(this.app, frame);
    const item = state.doc.objects[row];
    if (event.type === "pointerdown" && item && event.clientY - box.top > HEAD) actions.select(this.app, item.id);
  }
}
