// The keys, shown.

import { button, close, open, row } from "./dialog.js";
import { element } from "./dom.js";
import { KEYS } from "./keys.js";

export function help() {
  const sections = Object.entries(KEYS).map(([title, entries]) =>
    element("section", {},
      element("h3", {}, title),
      element("dl", {}, entries.filter((entry) => entry.shown).flatMap((entry) => [
        element("dt", {}, element("kbd", {}, entry.shown)),
        element("dd", {}, entry.text),
      ]))));
  const mouse = "Mouse: click a region to select it, drag its points, edges or inside; double click an edge to add a point, "
    + "right click a point to delete it; while drawing, click points or draw freehand, and click the first point to close.";
  open("Keys", element("div", { className: "help" }, sections), element("p", { className: "faint" }, mouse),
    row(button("Close", close)));
}
