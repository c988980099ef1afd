// Puts the page together: what it shows about itself and how, its size.

import { setTool } from "./actions.js";
import { clamp } from "./annotation.js";
import { clips, openClip } from "./clips.js";
import { byId } from "./dom.js";
import "./keys.js";
import "./panel.js";
import "./pointer.js";
import { drawRegions } from "./regions.js";
import { saver } from "./saving.js";
import { USUAL, attempt, on, set, state } from "./state.js";
import { drawTracks } from "./tracks.js";
import { drawPicture, goToNumber, refit, zoomTo } from "./view.js";

const TITLE = { object: "a new object", region: "the object again in this frame", part: "another part" };

function instruction({ pending, tool }) {
  if (!pending) return "";
  if (tool === "click") {
    return "Click on what moves, or drag a box around it; a further click adds, Alt+click takes away; "
      + "Enter: the next object, Esc leaves";
  }
  if (tool === "brush") return "Drag to paint, with Alt to erase (or the other way); ↑ and ↓ change the size; Esc leaves";
  if (tool === "lasso") return "Draw around trajectories; Esc cancels";
  return `Outline ${TITLE[pending.mode]}: click points or draw freehand; Enter or the first point closes, `
    + "Backspace takes one back, Esc cancels";
}

on(["clip", "frame", "flickered"], () => {
  const { clip, frame, flickered } = state;
  const shown = flickered ?? frame;
  byId("frame-badge").textContent = `${clip.frame_names[shown]} · ${shown + 1} of ${clip.n_frames}`;
  byId("clip-name").textContent = clip.name;
  document.querySelector("h1").textContent = `Labelling ${clip.name}`;
  document.title = `${clip.name} · kt3dmoseg label`;
});
on(["hint", "pending", "tool"], () => (byId("hint").textContent = state.hint || instruction(state)));
on(["computing"], () => (byId("loading").textContent = state.computing ?? ""));
on(["tool", "playing", "flickered", "done", "undone", "clip"], () => {
  for (const b of tools) b.ariaPressed = b.dataset.tool === state.tool;
  byId("stage").className = state.tool;
  byId("play").ariaPressed = state.playing;
  byId("flicker").ariaPressed = state.flickered !== null;
  byId("undo").disabled = !state.done.length;
  byId("redo").disabled = !state.undone.length;
});

const tools = document.querySelectorAll("[data-tool]");
for (const b of tools) if (!b.dataset.key) b.onclick = () => state.doc && setTool(b.dataset.tool);
byId("clips").onclick = () => attempt(clips);

// How things are shown: the form behind "View"

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
  const { hidden, problems, brightness, contrast, ...kept } = Object.fromEntries(names.map((name) => [name, state[name]]));
  localStorage.setItem("look", JSON.stringify(kept)); // but nothing is left out, or too bright, in another clip
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

// The panel's edges are dragged, or moved with the arrow keys; this browser keeps where they are.
const EDGES = [
  ["panel", "panel", "offsetHeight", "ArrowUp", "ArrowDown"],
  ["list", "objects", "offsetWidth", "ArrowRight", "ArrowLeft"],
  ["inspector", "inspector", "offsetWidth", "ArrowLeft", "ArrowRight"],
];
const LEAST = 110;
const STEP = 24;

for (const [name, part, side, larger, smaller] of EDGES) {
  const edge = byId(`${name}-edge`);
  const place = (wanted) => {
    const most = Math.max(LEAST, side === "offsetHeight" ? innerHeight - 240 : innerWidth * 0.4);
    const pixels = Math.round(clamp(wanted, LEAST, most));
    byId("panel").style.setProperty(`--${name}`, `${pixels}px`);
    Object.assign(edge, { ariaValueMin: LEAST, ariaValueMax: Math.round(most), ariaValueNow: pixels });
    localStorage.setItem(`size:${name}`, pixels);
  };
  const kept = Number(localStorage.getItem(`size:${name}`));
  if (kept) place(kept);
  else edge.ariaValueNow = byId(part)[side];
  edge.onpointerdown = (event) => edge.setPointerCapture(event.pointerId);
  edge.onpointermove = ({ buttons, clientX, clientY }) =>
    buttons & 1 && place({ panel: innerHeight - clientY, list: clientX, inspector: innerWidth - clientX }[name]);
  edge.onkeydown = (event) => {
    const by = { [larger]: STEP, [smaller]: -STEP }[event.key];
    if (!by) return;
    place(byId(part)[side] + by);
    event.preventDefault();
    event.stopPropagation();
  };
}

const resized = new ResizeObserver((entries) => {
  set({ resized: performance.now() });
  if (state.clip && entries.some(({ target }) => target.id === "stage")) refit();
});
["stage", "timeline"].forEach((id) => resized.observe(byId(id)));
addEventListener("popstate", () => openClip(new URLSearchParams(location.search).get("clip"), "replaceState"));

window.labeller = { state, saver, drawPicture, drawTracks, drawRegions };
openClip(document.documentElement.dataset.clip, "replaceState");
