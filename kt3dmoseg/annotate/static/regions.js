// Regions, handles, the outline being drawn, the lasso and the keyboard's cross.

import { colourOfMotion } from "./colours.js";
import { boundsOf } from "./geometry.js";
import { editableRegion, regionOf } from "./region.js";
import { toScreen } from "./view.js";

export class Regions {
  constructor(state, layer) {
    this.state = state;
    this.layer = layer;
    state.on(
      ["frame", "view", "doc", "regions", "selected", "vertex", "pending", "pointer", "cross", "lassoed",
        "hidden", "flickered", "hovered", "tool", "proposals", "review", "compared"],
      () => this.draw());
  }

  draw() {
    const context = this.layer.begin();
    const { state } = this;
    if (!state.doc || !state.view) return;
    const frame = state.flickered ?? state.frame;
    if (!state.hidden) {
      for (const item of state.doc.objects) this.#drawObject(context, item, frame);
      (state.doc.marks ?? []).forEach((mark) => {
        if (mark.frame === frame) this.#outline(context, mark.polygon, colourOfMotion(mark.motion), [2, 3]);
      });
      for (const item of state.proposals ?? []) this.#drawProposal(context, item, frame);
      if (state.compared?.at !== null) this.#drawOther(context, state.compared, frame);
    }
    if (state.pending) this.#drawPending(context, state.pending);
    if (state.lassoed?.frame === frame) this.#outline(context, state.lassoed.polygon, "#ffffff", [4, 3]);
    if (state.cross) this.#drawCross(context, state.cross);
  }

  #drawObject(context, item, frame) {
    const region = regionOf(this.state, item, frame);
    if (region.visibility === "outside") return;
    const chosen = item.id === this.state.selected;
    const colour = colourOfMotion(item.motion);
    const dash = region.visibility === "occluded" ? [6, 5] : region.key ? [] : [10, 3];
    for (const polygon of region.polygons) {
      this.#outline(context, polygon, colour, dash, chosen ? 2.5 : 1.5);
      context.globalAlpha = chosen ? 0.16 : item.id === this.state.hovered ? 0.14 : 0.07;
      context.fillStyle = colour;
      context.fill();
      context.globalAlpha = 1;
    }
    if (chosen && !this.state.pending) this.#drawHandles(context, editableRegion(this.state, item, frame), colour);
    this.#drawName(context, item, region, colour, chosen);
  }

  #drawProposal(context, item, frame) {
    const region = regionOf({ regions: null }, item, frame);
    const asked = this.state.review?.item === item;
    context.globalAlpha = asked ? 1 : 0.4;
    for (const polygon of region.polygons) this.#outline(context, polygon, "#ffffff", asked ? [8, 3] : [2, 4], asked ? 2.5 : 1);
    if (asked) this.#drawName(context, { ...item, motion: "?" }, region, "#ffffff", true);
    context.globalAlpha = 1;
  }

  /** The other annotator's regions, while differences are looked at. */
  #drawOther(context, compared, frame) {
    for (const item of compared?.theirs ?? []) {
      const region = compared.regions[item.id][frame];
      for (const polygon of region.polygons) this.#outline(context, polygon, "#ffffff", [3, 4], 1.5);
      this.#drawName(context, { ...item, name: `${item.name} (other)` }, region, "#ffffff", false, 1);
    }
  }

  #drawHandles(context, region, colour) {
    const { vertex, view } = this.state;
    region.polygons.forEach((polygon, part) => polygon.forEach((point, index) => {
      const chosen = vertex?.part === part && vertex.index === index;
      const [x, y] = toScreen(view, point);
      const half = chosen ? 5 : 3;
      context.fillStyle = chosen ? "#ffffff" : colour;
      context.strokeStyle = "#101216";
      context.lineWidth = 1;
      context.fillRect(x - half, y - half, 2 * half, 2 * half);
      context.strokeRect(x - half, y - half, 2 * half, 2 * half);
    }));
  }

  #drawName(context, item, region, colour, chosen, line = 0) {
    const box = boundsOf(region.polygons);
    if (!box) return;
    const [x, y] = toScreen(this.state.view, box);
    const [right, bottom] = toScreen(this.state.view, box.slice(2));
    const { clientWidth, clientHeight } = this.layer.canvas;
    if (right < 0 || bottom < 0 || x > clientWidth || y > clientHeight) return;
    const motion = item.motion === "reject" ? "x" : item.motion;
    this.#label(context, `${motion} ${item.name}`, Math.max(2, x), Math.max(15, y - 5 - 16 * line), colour, chosen);
  }

  #label(context, text, x, y, colour, chosen) {
    context.font = `${chosen ? "600" : "400"} 12px system-ui, sans-serif`;
    const width = context.measureText(text).width;
    x = Math.min(x, this.layer.canvas.clientWidth - width - 4);
    context.fillStyle = "#101216c8";
    context.fillRect(x - 2, y - 11, width + 5, 15);
    context.fillStyle = colour;
    context.fillText(text, x, y);
  }

  #outline(context, polygon, colour, dash = [], width = 1.5) {
    context.beginPath();
    polygon.forEach((point, i) => {
      const [x, y] = toScreen(this.state.view, point);
      if (i) context.lineTo(x, y);
      else context.moveTo(x, y);
    });
    context.closePath();
    context.setLineDash(dash);
    context.lineJoin = "round";
    context.strokeStyle = "#000a";
    context.lineWidth = width + 1.5;
    context.stroke();
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.stroke();
    context.setLineDash([]);
  }

  #drawPending(context, pending) {
    const points = [...pending.points];
    const end = this.state.cross ?? this.state.pointer;
    if (end && !pending.freehand) points.push(end);
    context.beginPath();
    points.forEach((point, i) => context[i ? "lineTo" : "moveTo"](...toScreen(this.state.view, point)));
    context.strokeStyle = "#ffffff";
    context.lineWidth = 1.5;
    context.stroke();
    context.fillStyle = "#ffffff";
    pending.points.forEach((point, i) => {
      const [x, y] = toScreen(this.state.view, point);
      const half = i ? 2.5 : 4.5;
      if (!pending.freehand || !i) context.fillRect(x - half, y - half, 2 * half, 2 * half);
    });
  }

  #drawCross(context, cross) {
    const [x, y] = toScreen(this.state.view, cross);
    context.strokeStyle = "#ffffff";
    context.lineWidth = 1;
    context.beginPath();
    for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
      context.moveTo(x + 4 * dx, y + 4 * dy);
      context.lineTo(x + 16 * dx, y + 16 * dy);
    }
    context.stroke();
  }
}
