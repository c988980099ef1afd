// Puts the page together: its buttons, what it shows about itself, its size.

import { setTool } from "./actions.js";
import { clips, openClip } from "./clips.js";
import { byId } from "./dom.js";
import { clamp } from "./geometry.js";
import { describe, press } from "./keys.js";
import "./objects.js";
import "./pointer.js";
import { drawRegions } from "./regions.js";
import { saver } from "./saving.js";
import { attempt, on, set, state } from "./state.js";
import { drawTracks } from "./tracks.js";
import { drawPicture, fitAll } from "./view.js";

const TITLE = { object: "a new object", region: "the object again in this frame", part: "another part" };

/** What to do next while drawing. */
function instruction({ pending, tool }) {
  if (!pending) return "";
  if (tool === "lasso") return "Draw around trajectories; Esc cancels";
  return `Outline ${TITLE[pending.mode]}: click points or draw freehand; Enter or the first point closes, `
    + "Backspace takes one back, Esc cancels";
}

on(["clip", "frame", "flickered", "view"], () => {
  const { clip, frame, flickered, view } = state;
  const shown = flickered ?? frame;
  byId("frame-badge").textContent = `${clip.frame_names[shown]} · ${shown + 1} of ${clip.n_frames}`
    + (view ? ` · ${Math.round(100 * view.scale)} %` : "");
  byId("clip-name").textContent = clip.name;
  document.title = `${clip.name} · kt3dmoseg label`;
});
on(["hint", "pending", "tool"], () => (byId("hint").textContent = state.hint || instruction(state)));
on(["computing"], () => (byId("loading").textContent = state.computing ?? ""));
on(["tool", "playing", "flickered", "clip"], () => {
  const mark = (id, name, wanted) => byId(id).classList.toggle(name, wanted);
  document.querySelectorAll("[data-tool]").forEach((b) => b.classList.toggle("on", b.dataset.tool === state.tool));
  mark("play", "on", state.playing);
  mark("flicker", "on", state.flickered !== null);
  mark("stage", "draw", state.tool === "draw");
  mark("stage", "lasso", state.tool === "lasso");
});

on(["undoable", "redoable", "clip"], () => {
  byId("undo").disabled = !state.undoable;
  byId("redo").disabled = !state.redoable;
});

for (const b of document.querySelectorAll("[data-key]")) {
  b.title = describe(b.dataset.key);
  b.addEventListener("click", () => press(b.dataset.key));
}
for (const b of document.querySelectorAll("[data-tool]")) {
  b.addEventListener("click", () => state.doc && setTool(b.dataset.tool));
}
byId("clips").addEventListener("click", () => attempt(clips));

// The panel's edges are dragged, or moved with the arrow keys; this browser keeps where they are.
const EDGES = {
  panel: { size: (x, y) => innerHeight - y, most: () => innerHeight - 240, larger: "ArrowUp", smaller: "ArrowDown" },
  list: { size: (x) => x, most: () => innerWidth * 0.4, larger: "ArrowRight", smaller: "ArrowLeft" },
  inspector: { size: (x) => innerWidth - x, most: () => innerWidth * 0.4, larger: "ArrowLeft", smaller: "ArrowRight" },
};
const LEAST = 110;
const STEP = 24;

for (const [name, { size, most, larger, smaller }] of Object.entries(EDGES)) {
  const edge = byId(`${name}-edge`);
  const place = (wanted) => {
    const pixels = Math.round(clamp(wanted, LEAST, Math.max(LEAST, most())));
    byId("panel").style.setProperty(`--${name}`, `${pixels}px`);
    edge.setAttribute("aria-valuenow", pixels);
    edge.setAttribute("aria-valuemax", Math.round(most()));
    localStorage.setItem(`size:${name}`, pixels);
  };
  const present = () => {
    const box = edge.getBoundingClientRect();
    return Math.round(size(box.x + box.width / 2, box.y + box.height / 2));
  };
  edge.setAttribute("aria-valuemin", LEAST);
  const kept = Number(localStorage.getItem(`size:${name}`));
  if (kept) place(kept);
  else edge.setAttribute("aria-valuenow", present());
  edge.addEventListener("pointerdown", (event) => edge.setPointerCapture(event.pointerId));
  edge.addEventListener("pointermove", (event) => event.buttons & 1 && place(size(event.clientX, event.clientY)));
  edge.addEventListener("keydown", (event) => {
    const by = { [larger]: STEP, [smaller]: -STEP }[event.key];
    if (!by) return;
    place(present() + by);
    event.preventDefault();
    event.stopPropagation();
  });
}

const resized = new ResizeObserver((entries) => {
  set({ resized: performance.now() });
  if (state.clip && entries.some(({ target }) => target.id === "stage")) fitAll();
});
["stage", "timeline"].forEach((id) => resized.observe(byId(id)));
addEventListener("popstate", () => openClip(new URLSearchParams(location.search).get("clip"), false));

window.labeller = { state, saver, drawPicture, drawTracks, drawRegions };
openClip(document.documentElement.dataset.clip);
