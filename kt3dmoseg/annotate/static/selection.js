// What is selected, and saying something about it.

import * as edits from "./edits.js";

export const selectedObject = ({ state }) => state.doc && edits.objectOf(state.doc, state.selected);

export function say(app, text) {
  app.state.set({ hint: text });
  clearTimeout(app.hintTimer);
  app.hintTimer = setTimeout(() => app.state.set({ hint: "" }), 4000);
}

/** The selected object, or a hint that there is none. */
export function chosen(app) {
  const item = selectedObject(app);
  if (!item) say(app, "Select an object first: click it, or press ]");
  return item;
}
