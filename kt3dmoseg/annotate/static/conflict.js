// Somebody else saved in between: nothing is overwritten before a person chose.

import { ask, button, close, row } from "./dialog.js";
import { element } from "./dom.js";
import { merge } from "./merge.js";

export function watchConflicts(app) {
  app.state.on(["conflict"], ({ conflict }) => {
    if (conflict) choose(app, conflict);
  });
}

function choose(app, theirs) {
  const settle = (doc) => {
    close();
    app.state.set({ conflict: null });
    app.saver.rebase(theirs);
    app.history.edit(doc);
    app.saver.flush();
  };
  const mine = app.state.doc;
  const merged = merge(app.saver.base, mine, theirs);
  const first = button("Merge both", () => settle(merged), "primary");
  ask("Saved elsewhere in the meantime",
    element("p", {}, `Another tab or person saved revision ${theirs.revision} of ${theirs.clip} after this page read `
      + `revision ${app.saver.revision}. Your edits are still here. What shall revision ${theirs.revision + 1} be?`),
    element("table", {},
      choice(first, "objects changed on one side come from there; changed on both, you get both"),
      choice(button("Keep mine", () => settle({ ...mine })), "what you see now replaces the other revision"),
      choice(button("Take theirs", () => settle(theirs)), "the other revision; Ctrl+Z brings yours back")),
    row(element("span", { className: "faint" }, "Each is one edit: Ctrl+Z undoes it.")));
  first.focus();
}

const choice = (chooser, text) => element("tr", {}, element("td", {}, chooser), element("td", {}, text));
