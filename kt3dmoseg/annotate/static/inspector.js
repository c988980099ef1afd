// The selected object's properties; without one, how the trajectories are labelled.

import { deleteHere, deleteObject, forgetKey, regionOf, setMotion, setVisibility, update } from "./actions.js";
import { BACKGROUND, PROBLEM, REJECTED, colourOfMotion } from "./colours.js";
import { byId, element, fill, row } from "./dom.js";
import { on, selectedObject, state } from "./state.js";
import { chip } from "./timeline.js";

const MOTIONS = [1, 2, 3, 4, 5, 6, 7, 8, 9, 0, "reject"];
const MEANING = { reject: "reject: ambiguous (X)", 0: "static, in front (0)" };
const VISIBILITY = { visible: "seen here", occluded: "occluded from here on (O)", outside: "outside from here on (E)" };

const root = byId("inspector");

function draw() {
  const focused = root.contains(document.activeElement) ? document.activeElement : null;
  if (!state.doc || state.dragging || focused?.matches("input")) return;
  const item = selectedObject();
  fill(root, item ? properties(item) : counts());
  if (focused) root.querySelector(`[data-focus="${focused.dataset.focus}"]`)?.focus();
}

function properties(item) {
  const region = regionOf(item, state.frame);
  return [
    field("Name", input(item, "name")),
    field("Kind", kinds(item)),
    field("Motion", element("div", { className: "keys" }, MOTIONS.map((motion) => motionButton(item, motion)))),
    field("Here", element("div", { className: "three" }, Object.entries(VISIBILITY).map(([visibility, title]) =>
      choice(visibility, title, () => setVisibility(visibility), { className: region.visibility === visibility ? "on" : "" })))),
    field("Note", input(item, "note", "why, when it is not obvious")),
    row(
      choice("Forget key", "Let it follow the motion here (Backspace)", forgetKey, { disabled: !region.key }),
      choice("Delete here", "Not in this frame (Delete)", deleteHere),
      choice("Delete object", "From the whole clip (Shift+Delete)", deleteObject, { className: "danger" })),
  ];
}

const field = (name, content) => row(element("label", {}, name), content);

const choice = (text, title, run, more = {}) =>
  element("button", { title, "data-focus": text, onclick: () => run(), ...more }, text);

function input(item, name, placeholder = "") {
  const commit = (event) => {
    const value = event.target.value.trim();
    if (value !== (item[name] ?? "") && (value || name !== "name")) update({ [name]: value });
  };
  return element("input", {
    value: item[name] ?? "", maxLength: 200, "aria-label": name, "data-focus": name, placeholder, onchange: commit,
    // Not before the focus has gone to where Tab sends it: what is drawn again cannot take it.
    onblur: () => setTimeout(draw),
  });
}

function kinds(item) {
  const choose = (event) => {
    update({ kind: event.target.value });
    event.target.blur();
  };
  return element("select", { "aria-label": "Kind", "data-focus": "kind", onchange: choose },
    state.clip.kinds.map((kind) => element("option", { value: kind, selected: kind === item.kind }, kind)));
}

function motionButton(item, motion) {
  const chosen = item.motion === motion;
  const made = choice(motion === "reject" ? "x" : String(motion), MEANING[motion] ?? `motion ${motion}`,
    () => setMotion(motion), { className: chosen ? "on" : "", "aria-pressed": String(chosen) });
  made.style.background = colourOfMotion(motion);
  return made;
}

function counts() {
  const { labels, doc, tracks } = state;
  if (!labels) {
    const text = tracks ? "labelling…" : "not there yet";
    return [element("h2", {}, "Trajectories"), element("p", { className: "faint" }, text)];
  }
  const { motions, rejected, short, conflict } = labels.counts;
  const names = new Map(doc.objects.map((item) => [item.motion, item.name]));
  const numbers = Object.keys(motions).map((label) => label - 1).filter((motion) => motion >= 1);
  const rows = [
    ["background", BACKGROUND, motions[1] ?? 0],
    ...numbers.map((motion) => [names.get(motion) ?? `motion ${motion}`, colourOfMotion(motion), motions[motion + 1]]),
    ["rejected", REJECTED, rejected],
    ["too short to tell", PROBLEM, short],
    ["in conflict", PROBLEM, conflict],
  ];
  const cells = rows.flatMap(([name, colour, count]) =>
    [chip(" ", colour), element("span", {}, name), element("span", { className: "n" }, String(count))]);
  return [element("h2", {}, `${labels.label.length} trajectories`), element("div", { className: "counts" }, cells)];
}

on(["doc", "selected", "frame", "labels", "regions", "dragging", "clip"], draw);
