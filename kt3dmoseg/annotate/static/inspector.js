// The selected object's properties; without one, how the trajectories are labelled.

import * as actions from "./actions.js";
import { BACKGROUND, PROBLEM, REJECTED, colourOfMotion } from "./colours.js";
import { element, fill } from "./dom.js";
import * as edits from "./edits.js";
import { regionOf } from "./region.js";

const STATES = [["visible", "visible", ""], ["occluded", "occluded", "O"], ["outside", "outside", "E"]];

export class Inspector {
  constructor(app, root) {
    this.app = app;
    this.root = root;
    app.state.on(["doc", "selected", "frame", "labels", "regions", "dragging", "clip"], () => this.draw());
  }

  draw() {
    const { app } = this;
    if (!app.state.doc || app.state.dragging || this.root.contains(document.activeElement)
        && document.activeElement.matches("input, textarea")) return;
    const focused = document.activeElement?.dataset?.focus;
    const item = actions.selectedObject(app);
    fill(this.root, item ? this.#object(item) : this.#counts());
    if (focused) this.root.querySelector(`[data-focus="${focused}"]`)?.focus();
  }

  #object(item) {
    const region = regionOf(this.app.state, item, this.app.state.frame);
    return [
      this.#field("Name", this.#input(item, "name")),
      this.#field("Kind", this.#kinds(item)),
      this.#field("Motion", this.#motions(item)),
      this.#field("Here", this.#states(region)),
      this.#field("Note", this.#input(item, "note")),
      element("div", { className: "row" },
        this.#button("Forget key", "Let it follow the motion here (Backspace)", actions.forgetKey, !region.key),
        this.#button("Delete here", "Not in this frame (Delete)", actions.deleteHere),
        this.#button("Delete object", "From the whole clip (Shift+Delete)", actions.deleteObject, false, "danger")),
    ];
  }

  #field(name, ...content) {
    return element("div", { className: "row" }, element("label", {}, name), ...content);
  }

  #input(item, field) {
    const commit = (event) => {
      const value = event.target.value.trim();
      if (value === (item[field] ?? "") || (field === "name" && !value)) return;
      this.app.history.edit(edits.update(this.app.state.doc, item.id, { [field]: value }));
    };
    return element("input", {
      value: item[field] ?? "", maxLength: 200, "aria-label": field, onchange: commit,
      // Not before the focus has gone to where Tab sends it: what is drawn anew cannot take it.
      onblur: () => setTimeout(() => this.draw()), "data-focus": field, placeholder: field === "note" ? "why, when it is not obvious" : "",
    });
  }

  #kinds(item) {
    const choose = (event) => {
      this.app.history.edit(edits.update(this.app.state.doc, item.id, { kind: event.target.value }));
      event.target.blur();
    };
    const options = this.app.state.clip.kinds.map((kind) => element("option", { value: kind, selected: kind === item.kind }, kind));
    return element("select", { "aria-label": "Kind", "data-focus": "kind", onchange: choose }, options);
  }

  #motions(item) {
    const buttons = [1, 2, 3, 4, 5, 6, 7, 8, 9, 0, "reject"].map((motion) => {
      const made = element("button", {
        className: item.motion === motion ? "on" : "", "data-focus": `m${motion}`,
        "aria-pressed": String(item.motion === motion),
        title: motion === "reject" ? "reject: ambiguous (X)" : motion ? `motion ${motion}` : "static, in front (0)",
        onclick: () => actions.setMotion(this.app, motion),
      }, motion === "reject" ? "x" : String(motion));
      made.style.background = colourOfMotion(motion);
      return made;
    });
    return element("div", { className: "keys" }, buttons);
  }

  #states(region) {
    return element("div", { className: "three" }, STATES.map(([value, text, key]) =>
      element("button", {
        className: region.visibility === value ? "on" : "", "data-focus": `s${value}`,
        title: value === "visible" ? "seen here" : `${text} from here on (${key})`,
        onclick: () => actions.setVisibility(this.app, value),
      }, text)));
  }

  #button(text, title, run, disabled = false, className = "") {
    return element("button", { title, disabled, className, "data-focus": text, onclick: () => run(this.app) }, text);
  }

  #counts() {
    const { labels, doc, tracks } = this.app.state;
    if (!labels) return [element("h2", {}, "Trajectories"), element("p", { className: "faint" }, tracks ? "labelling…" : "not there yet")];
    const { counts } = labels;
    const names = new Map(doc.objects.filter((o) => o.motion !== "reject" && o.motion).map((o) => [o.motion, o.name]));
    const motions = Object.keys(counts.motions).map(Number).filter((label) => label >= 2);
    const rows = [
      ["background", BACKGROUND, counts.motions[1] ?? 0],
      ...motions.map((label) => [names.get(label - 1) ?? `motion ${label - 1}`, colourOfMotion(label - 1), counts.motions[label]]),
      ["rejected", REJECTED, counts.rejected],
      ["too short to tell", PROBLEM, counts.short],
      ["in conflict", PROBLEM, counts.conflict],
    ];
    const grid = element("div", { className: "counts" }, rows.flatMap(([name, colour, count]) => {
      const dot = element("span", { className: "chip" }, " ");
      dot.style.background = colour;
      return [dot, element("span", {}, name), element("span", { className: "n" }, String(count))];
    }));
    return [element("h2", {}, `${labels.label.length} trajectories`), grid];
  }
}
