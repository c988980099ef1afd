// Okabe and Ito's palette, distinguishable by colour-blind eyes, as in kt3dmoseg/annotate/overlay.py.

const PALETTE = ["#e69f00", "#56b4e9", "#009e73", "#f0e442", "#0088cc", "#d55e00", "#cc79a7"];

export const BACKGROUND = "#9aa7b8";
export const REJECTED = "#ff4d4d";
export const PROBLEM = "#ff2bd6";
export const UNSEEN = "#6b7280";

export function colourOfMotion(motion) {
  if (motion === "reject") return REJECTED;
  return motion >= 1 ? PALETTE[(motion - 1) % PALETTE.length] : BACKGROUND;
}

export const REASONS = ["labelled", "unseen", "short", "conflict", "rejected"];

/** Colour of a trajectory: its label's, or what keeps it unlabelled. */
export function colourOfTrack(label, reason) {
  if (reason === 4) return REJECTED;
  if (reason === 2 || reason === 3) return PROBLEM;
  return label >= 2 ? colourOfMotion(label - 1) : BACKGROUND;
}

const TRAILS = ["#3b82f6", "#22d3ee", "#4ade80", "#facc15", "#fb923c"];

/** Colour by the number of frames that a trajectory lives. */
export function colourOfLength(length, frames) {
  return TRAILS[Math.min(TRAILS.length - 1, Math.floor((length / frames) * TRAILS.length))];
}
