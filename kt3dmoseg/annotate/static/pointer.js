// Mouse, pen and touch on the stage.

import * as actions from "./actions.js";
import * as edits from "./edits.js";
import { distance, nearestEdge, nearestVertex } from "./geometry.js";
import { toImage, toScreen } from "./view.js";

const REACH = 8;
const FREEHAND = 4;

export class Pointer {
  #drag = null;

  constructor(app, stage) {
    this.app = app;
    this.stage = stage;
    stage.addEventListener("pointerdown", (event) => this.#down(event));
    stage.addEventListener("pointermove", (event) => this.#move(event));
    stage.addEventListener("pointerup", (event) => this.#up(event));
    stage.addEventListener("pointercancel", () => this.#cancel());
    stage.addEventListener("dblclick", (event) => this.#double(event));
    stage.addEventListener("contextmenu", (event) => event.preventDefault());
    stage.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
  }

  #at(event) {
    const box = this.stage.getBoundingClientRect();
    const screen = [event.clientX - box.left, event.clientY - box.top];
    return { screen, point: toImage(this.app.state.view, screen) };
  }

  #down(event) {
    const { app } = this;
    if (!app.state.view || event.target.closest(".strip")) return;
    app.keyboard = false;
    app.state.set({ cross: null });
    this.stage.focus({ preventScroll: true });
    this.stage.setPointerCapture(event.pointerId);
    const { screen, point } = this.#at(event);
    if (event.button === 1) this.#drag = { kind: "pan", from: screen };
    else if (event.button === 2) this.#removeVertex(point);
    else if (app.state.pending) this.#drag = { kind: "draw", from: screen, point };
    else this.#drag = this.#grab(point, screen);
    if (this.#drag?.kind === "pan") this.stage.classList.add("panning");
  }

  /** What lies under the pointer: a point, an edge or the inside of a region, or nothing. */
  #grab(point, screen) {
    const { app } = this;
    const { state } = app;
    const reach = REACH / state.view.scale;
    const item = actions.selectedObject(app);
    if (item && !state.hidden) {
      const { polygons, visibility } = actions.regionHere(app);
      const vertex = nearestVertex(point, polygons, reach);
      if (vertex) {
        state.set({ vertex: { part: vertex.part, index: vertex.index } });
        return { kind: "vertex", id: item.id, visibility, polygons, ...vertex };
      }
      const edge = nearestEdge(point, polygons, reach * 0.7);
      if (edge) {
        const grown = edits.insertPoint(polygons, edge.part, edge.index, edge.point);
        return { kind: "vertex", id: item.id, visibility, polygons: grown, part: edge.part, index: edge.index, edge: true };
      }
    }
    const under = state.hidden ? null : actions.objectUnder(app, point);
    if (under && under.id === state.selected) {
      const { polygons, visibility } = actions.regionHere(app);
      return { kind: "region", id: under.id, visibility, polygons, from: point };
    }
    return { kind: "pan", from: screen, under };
  }

  #move(event) {
    const { app } = this;
    if (!app.state.view) return;
    const { screen, point } = this.#at(event);
    const drag = this.#drag;
    if (!drag) return this.#hover(point);
    if (drag.kind === "pan") this.#pan(drag, screen);
    else if (drag.kind === "draw") this.#freehand(drag, screen, point);
    else this.#reshape(drag, point);
  }

  #hover(point) {
    const { state } = this.app;
    if (state.pending) state.set({ pointer: point });
    else state.set({ pointer: point, hovered: state.doc ? actions.objectUnder(this.app, point)?.id ?? null : null });
  }

  #pan(drag, screen) {
    const [dx, dy] = [screen[0] - drag.from[0], screen[1] - drag.from[1]];
    if (!drag.moved && Math.hypot(dx, dy) < FREEHAND) return;
    drag.moved = true;
    drag.from = screen;
    actions.pan(this.app, dx, dy);
  }

  #freehand(drag, screen, point) {
    if (distance(screen, drag.from) < FREEHAND) return;
    const { state } = this.app;
    if (!drag.moved) {
      drag.moved = true;
      state.set({ pending: { ...state.pending, freehand: true } });
      actions.addPoint(this.app, drag.point);
    }
    drag.from = screen;
    actions.addPoint(this.app, point);
  }

  #reshape(drag, point) {
    const { app } = this;
    const { doc, frame } = app.state;
    drag.moved = true;
    const polygons = drag.kind === "vertex"
      ? edits.replacePoint(drag.polygons, drag.part, drag.index, point)
      : edits.shift(drag.polygons, point[0] - drag.from[0], point[1] - drag.from[1]);
    const visibility = drag.visibility === "occluded" ? "occluded" : "visible";
    app.history.preview(edits.setKey(doc, drag.id, { frame, visibility, polygons }));
    if (drag.kind === "vertex") app.state.set({ vertex: { part: drag.part, index: drag.index } });
  }

  #up(event) {
    const { app } = this;
    const drag = this.#drag;
    this.#drag = null;
    this.stage.classList.remove("panning");
    if (!drag) return;
    const { point } = this.#at(event);
    if (drag.kind === "draw") this.#endDraw(drag, point);
    else if (drag.kind === "pan") {
      if (!drag.moved) actions.select(app, drag.under?.id ?? null);
    } else if (drag.moved) app.history.edit(app.state.doc);
    else if (drag.kind === "region") app.state.set({ vertex: null });
  }

  #endDraw(drag, point) {
    const { app } = this;
    if (drag.moved) {
      if (app.state.pending.points.length > 8) actions.finish(app);
      return;
    }
    const first = app.state.pending.points[0];
    const closing = first && app.state.pending.points.length >= 3
      && distance(toScreen(app.state.view, first), toScreen(app.state.view, point)) < REACH;
    if (closing) actions.finish(app);
    else actions.addPoint(app, point);
  }

  #double(event) {
    const { app } = this;
    if (app.state.pending) {
      if (app.state.pending.points.length >= 3) actions.finish(app);
      return;
    }
    const item = actions.selectedObject(app);
    const { point } = this.#at(event);
    if (!item) return;
    const { polygons } = actions.regionHere(app);
    const edge = nearestEdge(point, polygons, REACH / app.state.view.scale);
    if (edge && !nearestVertex(point, polygons, 2 / app.state.view.scale)) {
      const grown = edits.insertPoint(polygons, edge.part, edge.index, edge.point);
      app.history.edit(edits.setKey(app.state.doc, item.id, edits.visible(app.state.frame, grown)));
    }
  }

  #removeVertex(point) {
    const { app } = this;
    if (app.state.pending) return actions.takeBackPoint(app);
    if (!actions.selectedObject(app)) return undefined;
    const found = nearestVertex(point, actions.regionHere(app).polygons, REACH / app.state.view.scale);
    return found && actions.deleteVertex(app, found);
  }

  #wheel(event) {
    event.preventDefault();
    if (!this.app.state.view) return;
    const { screen } = this.#at(event);
    if (event.shiftKey) actions.pan(this.app, -event.deltaY, 0);
    else actions.zoom(this.app, Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)), screen);
  }

  #cancel() {
    this.#drag = null;
    this.stage.classList.remove("panning");
    this.app.history.cancel();
  }
}
