// What the page says about itself: saved revision, frame, hints, progress of the trajectories.

const TEXT = {
  saved: (s) => (s.revision ? `✓ saved · rev ${s.revision}` : "no edits yet · rev 0"),
  unsaved: () => "• edited",
  busy: () => "saving…",
  offline: (s) => `⚠ ${s.message || "server away"}: edits kept in this browser`,
  conflict: () => "⚠ saved elsewhere: choose",
  failed: (s) => `⚠ not saved: ${s.message}`,
};

export function watchStatus(app) {
  const by = (id) => document.getElementById(id);
  const { state } = app;
  state.on(["saving"], () => {
    by("saved").textContent = TEXT[state.saving.kind](state.saving);
    by("saved").className = state.saving.kind;
    by("saved").title = state.saving.message ?? "";
  });
  state.on(["clip", "frame", "doc", "flickered"], () => {
    if (!state.clip) return;
    const frame = state.flickered ?? state.frame;
    by("frame-badge").textContent = `${frame} / ${state.clip.n_frames - 1}`;
    by("clip-name").textContent = state.clip.name;
    document.title = `${state.clip.name} · kt3dmoseg label`;
  });
  state.on(["hint", "pending", "tool"], () => (by("hint").textContent = state.hint || standing(state)));
  state.on(["computing"], () => (by("loading").textContent = state.computing ?? ""));
  state.on(["tool", "playing", "flickered", "clip"], () => {
    document.querySelectorAll("[data-tool]").forEach((b) => b.classList.toggle("on", b.dataset.tool === state.tool));
    by("play").classList.toggle("on", state.playing);
    by("flicker").classList.toggle("on", state.flickered !== null);
    const stage = by("stage");
    stage.classList.toggle("draw", state.tool === "draw");
    stage.classList.toggle("lasso", state.tool === "lasso");
  });
}

function standing({ pending, tool }) {
  if (!pending) return "";
  if (tool === "lasso") return "Draw around trajectories; Esc cancels";
  const what = { object: "a new object", region: "the object anew in this frame", part: "another part" }[pending.mode];
  return `Outline ${what}: click points or draw freehand; Enter or the first point closes, Backspace takes one back, Esc cancels`;
}
