// Where the frame lies on the screen: (x, y) is the image position of the stage's top left corner.

const CLOSEST = 40;
// So many pixels of the screen always show a part of the frame.
const KEPT = 60;

/** The view, moved back where next to nothing of the frame was left in sight. */
export function held(view, [width, height], stage) {
  const within = (at, size, room) => Math.min(size - KEPT / view.scale, Math.max(at, (KEPT - room) / view.scale));
  return { ...view, x: within(view.x, width, stage.width), y: within(view.y, height, stage.height) };
}

export function fit([width, height], stage) {
  const scale = Math.min(stage.width / width, stage.height / height);
  return centred((width - 1) / 2, (height - 1) / 2, scale, stage);
}

export function centred(x, y, scale, stage) {
  return { x: x - stage.width / scale / 2, y: y - stage.height / scale / 2, scale };
}

export const toScreen = (view, [x, y]) => [(x - view.x) * view.scale, (y - view.y) * view.scale];

export const toImage = (view, [x, y]) => [x / view.scale + view.x, y / view.scale + view.y];

/** Zoom by a factor; what is under the screen point stays there. */
export function zoomed(view, factor, [sx, sy], farthest) {
  const scale = Math.min(CLOSEST, Math.max(farthest, view.scale * factor));
  const [x, y] = toImage(view, [sx, sy]);
  return { x: x - sx / scale, y: y - sy / scale, scale };
}

export const panned = (view, dx, dy) => ({ ...view, x: view.x - dx / view.scale, y: view.y - dy / view.scale });

/** Show a box with some surroundings. */
export function around([left, top, right, bottom], stage) {
  const scale = Math.min(CLOSEST / 2, (0.6 * stage.width) / (right - left + 8), (0.6 * stage.height) / (bottom - top + 8));
  return centred((left + right) / 2, (top + bottom) / 2, scale, stage);
}
