// How things are shown: the form behind "View", the number of the frame, the zoom.

import { byId } from "./dom.js";
import { USUAL, on, set, state } from "./state.js";
import { goToNumber, zoomTo } from "./view.js";

const form = byId("look");
const names = Object.keys(USUAL);

/** The field of a name, and which of its properties holds the value. */
function field(name) {
  const found = form.elements[name];
  return [found, { checkbox: "checked", range: "valueAsNumber" }[found.type] ?? "value"];
}

form.oninput = ({ target: { name } }) => {
  const [found, property] = field(name);
  set({ [name]: found[property] });
};
form.onsubmit = (event) => event.preventDefault();
byId("usual").onclick = () => set(USUAL);

function show() {
  document.documentElement.style.colorScheme = state.theme;
  for (const name of names) {
    const [found, property] = field(name);
    found[property] = state[name];
  }
  const { hidden, problems, ...kept } = Object.fromEntries(names.map((name) => [name, state[name]]));
  localStorage.setItem("look", JSON.stringify(kept)); // but nothing is left out when the page opens again
}

// Numbers that are shown and may be typed
for (const [id, keys, shown, run] of [
  ["frame", ["clip", "frame"], () => state.clip.numbers[state.frame], goToNumber],
  ["scale", ["view"], () => `${Math.round(100 * state.view?.scale)} %`, (text) => zoomTo(parseFloat(text))],
]) {
  const input = byId(id);
  const update = () => document.activeElement !== input && state.clip && (input.value = shown());
  input.onchange = () => input.value.trim() && run(input.value);
  input.onfocus = () => input.select();
  input.onblur = update;
  on(keys, update);
}

on(names, show);
matchMedia("(prefers-color-scheme: dark)").onchange = () => set({ resized: performance.now() });
set(JSON.parse(localStorage.getItem("look") ?? "{}"));
show();
