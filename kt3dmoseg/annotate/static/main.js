// Puts the page together: its buttons, what it shows about itself, its size.

import { setTool } from "./actions.js";
import { clips, openClip } from "./clips.js";
import { byId } from "./dom.js";
import { press } from "./keys.js";
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

on(["clip", "frame", "flickered"], () => {
  const { clip, frame, flickered } = state;
  byId("frame-badge").textContent = `${flickered ?? frame} / ${clip.n_frames - 1}`;
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

for (const b of document.querySelectorAll("[data-key]")) b.addEventListener("click", () => press(b.dataset.key));
for (const b of document.querySelectorAll("[data-tool]")) {
  b.addEventListener("click", () => state.doc && setTool(b.dataset.tool));
}
byId("clips").addEventListener("click", () => attempt(clips));

new ResizeObserver(() => {
  set({ resized: performance.now() });
  if (state.clip) fitAll();
}).observe(byId("stage"));
addEventListener("popstate", () => openClip(new URLSearchParams(location.search).get("clip"), false));

window.labeller = { state, saver, drawPicture, drawTracks, drawRegions };
openClip(document.documentElement.dataset.clip);
