// The panel below the frame: the objects, and the properties of the selected one.

import { setMotion, setVisibility, update, weakFrames } from "./actions.js";
import {
  BACKGROUND, PROBLEM, REJECTED, button, byId, chip, colourOfMotion, element, faint, fill, meaningOf, signOf,
} from "./dom.js";
import { on, regionOf, select, selectedObject, set, state, toggleObject } from "./state.js";
import { nextProblem, problems } from "./tracks.js";
import { fitObject } from "./view.js";

const FIRST_STEPS = [
  "Shift+O, then drag a box around something that moves; or N, and click around it. Or S for proposals.",
  "1 to 9 gives it its motion.",
  "→ on through the frames: it follows the image. Where it left the edge, drag it back.",
  "E where it leaves, O where it is hidden. ? shows all keys.",
];
const MOTIONS = [1, 2, 3, 4, 5, 6, 7, 8, 9, 0, "reject"];

const list = byId("objects");
const properties = byId("properties");

function drawList() {
  if (!state.doc || state.dragging) return;
  const { objects } = state.doc;
  const focused = list.contains(document.activeElement) && document.activeElement.closest(".entry")?.dataset.id;
  fill(list, objects.length ? objects.map(entry)
    : element("ol", { className: "empty" }, FIRST_STEPS.map((step) => element("li", {}, step))));
  if (focused) list.querySelector(`[data-id="${focused}"] .object`)?.focus();
  list.querySelector(".on")?.scrollIntoView({ block: "nearest" });
}

function entry(item) {
  const { id, name, kind, motion, note = "" } = item;
  const chosen = id === state.selected;
  const weak = weakFrames(item).length;
  const doubt = weak ? element("span", { className: "weak" }, `${weak} weak`) : faint(kind);
  const object = element("button", {
    className: "object", title: note, "aria-pressed": String(chosen), onclick: () => select(id), ondblclick: fitObject,
  }, chip(signOf(motion), colourOfMotion(motion), meaningOf(motion), `motion ${signOf(motion)}`),
  element("span", { className: "name" }, name), doubt);
  // Not on the way of Tab, which goes from object to object: both have keys.
  const toggle = (what, text, title) => button(text, () => toggleObject(what, id), "switch", {
    title, tabIndex: -1, "aria-label": `${title} ${name}`, "aria-pressed": String(state[what].has(id)),
  });
  return element("div", { className: chosen ? "entry on" : "entry", "data-id": id }, object,
    toggle("unseen", "H", "Hide (Shift+H)"), toggle("locked", "L", "Lock (Shift+R)"));
}

// The selected object's properties; without one, how the trajectories are labelled.

let shown = null;
let byPointer = false;

function drawProperties() {
  if (!state.doc || state.dragging || properties.querySelector("input:focus")) return;
  shown = selectedObject();
  properties.hidden = !shown;
  fill(byId("counts"), shown ? [] : counts());
  if (!shown) return;
  const { visibility, key } = regionOf(shown, state.frame);
  const { name, kind, note, forget } = properties.elements;
  for (const field of [name, kind, note]) field.value = shown[field.name] ?? "";
  for (const b of properties.querySelectorAll("[value]")) {
    b.ariaPressed = [visibility, String(shown.motion)].includes(b.value);
  }
  forget.disabled = !key;
}

function change({ target }) {
  const { name } = target;
  const value = target.value.trim();
  if (value !== (shown[name] ?? "") && (value || name !== "name")) update(shown, { [name]: value });
  if (target.matches("select") && byPointer) target.blur(); // typed letters go on choosing
}

byId("motions").append(...MOTIONS.map((motion) => button(signOf(motion), () => setMotion(motion), "",
  { title: meaningOf(motion), value: motion, style: `background: ${colourOfMotion(motion)}` })));
properties.onclick = ({ target }) => target.name === "visibility" && setVisibility(target.value);
properties.onchange = change;
properties.onpointerdown = properties.onkeydown = ({ type }) => {
  byPointer = type === "pointerdown";
};
properties.addEventListener("focusout", drawProperties);

function counts() {
  const { labels, doc, tracks } = state;
  const head = (text) => element("h2", {}, text);
  if (!labels) return [head("Trajectories"), faint(tracks ? "labelling…" : "not there yet")];
  const { motions, rejected, short, conflict } = labels.counts;
  const names = new Map(doc.objects.toReversed().map((item) => [item.motion, item.name]));
  const numbers = Object.keys(motions).map((label) => label - 1).filter((motion) => motion >= 1);
  const rows = [
    ["background (label 1)", BACKGROUND, motions[1] ?? 0],
    ...numbers.map((m) => [`${names.get(m) ?? `motion ${m}`} (label ${m + 1})`, colourOfMotion(m), motions[m + 1]]),
    ["rejected", REJECTED, rejected],
    ["too short to label", PROBLEM, short],
    ["in conflict", PROBLEM, conflict],
  ];
  const cells = rows.flatMap(([name, colour, count]) =>
    [chip(" ", colour), element("span", {}, name), element("span", { className: "n" }, String(count))]);
  const found = problems();
  const open = doc.objects.filter(({ id }) => found.has(id)).map(({ id, name }) =>
    button(`${found.get(id).length} unlabelled at ${name}`, () => nextProblem(id)));
  return [head(`${labels.label.length} trajectories`), element("div", { className: "counts" }, cells), ...open];
}

list.onscroll = () => set({ scrolled: list.scrollTop });
on(["doc", "dragging", "selected", "clip", "unseen", "locked", "weak"], drawList);
on(["clip"], () => fill(properties.elements.kind, state.clip.kinds.map((kind) => element("option", {}, kind))));
on(["doc", "selected", "frame", "labels", "regions", "dragging", "clip"], drawProperties);
