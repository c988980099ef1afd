// The list of objects, one row each, in line with the timeline beside it.

import * as actions from "./actions.js";
import { colourOfMotion } from "./colours.js";
import { element, fill } from "./dom.js";

const FIRST_STEPS = [
  "N, then click around something that moves; Enter closes the outline. Or S for proposals.",
  "1 to 9 gives it its motion.",
  "→ on through the frames: it follows the image. Where it left the edge, drag it back.",
  "E where it leaves, O where it is hidden. ? shows all keys.",
];

export class Objects {
  constructor(app, root) {
    this.app = app;
    this.root = root;
    app.state.on(["doc", "selected", "clip"], () => this.draw());
    root.addEventListener("scroll", () => app.state.set({ scrolled: root.scrollTop }));
  }

  draw() {
    const { state } = this.app;
    if (!state.doc) return;
    const rows = state.doc.objects.map((item) => this.#row(item));
    if (!rows.length) rows.push(element("ol", { className: "empty" }, FIRST_STEPS.map((step) => element("li", {}, step))));
    fill(this.root, rows);
    this.root.querySelector(".on")?.scrollIntoView({ block: "nearest" });
  }

  #row(item) {
    const chip = element("span", { className: "chip" }, item.motion === "reject" ? "x" : String(item.motion));
    chip.style.background = colourOfMotion(item.motion);
    const chosen = item.id === this.app.state.selected;
    return element(
      "button",
      { className: chosen ? "object on" : "object", title: item.note ?? "", "aria-pressed": String(chosen),
        onclick: () => actions.select(this.app, item.id), ondblclick: () => actions.fitObject(this.app) },
      chip,
      element("span", { className: "name" }, item.name),
      element("span", { className: "faint" }, item.kind));
  }
}
