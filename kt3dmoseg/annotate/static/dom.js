// Elements, colours, canvases in CSS pixels, and the one dialog of the page.

export const byId = (id) => document.getElementById(id);

/** element("button", { className: "x", onclick: f, "aria-label": "y" }, "text", child) */
export function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key in made) made[key] = value;
    else made.setAttribute(key, value);
  }
  made.append(...children.flat());
  return made;
}

export const fill = (parent, ...children) => parent.replaceChildren(...children.flat());

export const button = (text, run, className = "", more = {}) =>
  element("button", { type: "button", onclick: () => run(), className, ...more }, text);

export const row = (...content) => element("div", { className: "row" }, ...content);
export const paragraph = (...content) => element("p", {}, ...content);
export const faint = (text) => element("span", { className: "faint" }, text);
const line = (cells, name = "td") => element("tr", {}, cells.map((cell) => element(name, {}, cell)));

export const table = (rows, heads) =>
  element("table", {}, heads ? line(heads, "th") : [], rows.map((cells) => line(cells)));

/** A square in a colour; `meaning` is how it is read aloud. */
export const chip = (text, colour, title = "", meaning = "") =>
  element("span", { className: "chip", style: `background: ${colour}`, title,
    ...(meaning && { role: "img", ariaLabel: meaning }) }, text);

// Colours of labels, from the one palette (kt3dmoseg/draw/palette.py).
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

export const colourOfLength = (share) => LENGTHS[Math.min(LENGTHS.length - 1, Math.floor(share * LENGTHS.length))];

/** A motion's sign, and what it means in files. */
export const signOf = (motion) => (motion === "reject" ? "x" : String(motion));

export function meaningOf(motion) {
  if (motion === "reject") return "reject: ambiguous (X)";
  return motion ? `motion ${motion}, label ${motion + 1} in files` : "static, in front: label 1 in files (0)";
}

/** Clear a canvas, as large as it is shown, and give its context in CSS pixels. */
export const begin = (canvas) => sized(canvas, canvas.clientWidth, canvas.clientHeight);

export function sized(canvas, width, height) {
  const ratio = devicePixelRatio || 1;
  const sides = [Math.round(width * ratio), Math.round(height * ratio)];
  const context = canvas.getContext("2d");
  if (canvas.width === sides[0] && canvas.height === sides[1]) context.reset();
  else [canvas.width, canvas.height] = sides;
  context.scale(ratio, ratio);
  return context;
}

/** Slanted lines, for what is in doubt. */
export function hatch(context, strokeStyle) {
  const tile = new OffscreenCanvas(5, 5).getContext("2d");
  Object.assign(tile, { strokeStyle, lineWidth: 1.2 });
  tile.stroke(new Path2D("M-1 6L6 -1M-1 1L1 -1M4 6L6 4"));
  return context.createPattern(tile.canvas, "repeat");
}

const dialog = byId("dialog");

/** The item of a list after the one at an index, or before it; at no index (-1) the first or the last. */
export const nextOf = (list, at, by) => list.at(((at < 0 && by < 0 ? 0 : at) + by) % list.length);

/** With the arrow keys, go to the next or previous of some elements; a field with suggestions has them itself. */
export function walk(event, items) {
  const by = { ArrowDown: 1, ArrowUp: -1 }[event.key];
  if (!by || !items.length || event.target.list) return;
  nextOf(items, items.indexOf(document.activeElement), by).focus();
  event.preventDefault();
}

dialog.onkeydown = (event) => walk(event, [...dialog.querySelectorAll(".scroll button")]);

/** Open the dialog; closing it gives the focus back to the stage. */
export function open(title, ...content) {
  fill(dialog, element("h2", {}, title), ...content);
  if (!dialog.open) dialog.showModal();
  else dialog.querySelector("button:enabled")?.focus();
  dialog.scrollTop = 0; // a button that got the focus may be at the end of a long text
  dialog.onclose = () => byId("stage").focus();
}

export const close = () => dialog.open && dialog.close();

export function download(content, name) {
  const link = element("a", { href: URL.createObjectURL(content), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
