// Colours of labels, from the one palette of kt3dmoseg (kt3dmoseg/draw/palette.py).

const palette = JSON.parse(document.documentElement.dataset.palette);
const LENGTHS = ["#3b82f6", "#22d3ee", "#4ade80", "#facc15", "#fb923c"];

export const BACKGROUND = palette.background;
export const REJECTED = palette.rejected;
export const PROBLEM = "#ff2bd6";

/** Colour of a motion of the annotation: motion m has label m + 1, label 1 is the background. */
export function colourOfMotion(motion) {
  if (motion === "reject") return REJECTED;
  return motion >= 1 ? palette.labels[motion % palette.labels.length] : BACKGROUND;
}

/** Colour of a trajectory: its label's, or what keeps it unlabelled: 2 too short, 3 in conflict, 4 rejected. */
export function colourOfTrack(label, reason) {
  if (reason === 4) return REJECTED;
  return reason === 2 || reason === 3 ? PROBLEM : colourOfMotion(label - 1);
}

/** Colour by the number of frames that a trajectory lives. */
export function colourOfLength(length, frames) {
  return LENGTHS[Math.min(LENGTHS.length - 1, Math.floor((length / frames) * LENGTHS.length))];
}
