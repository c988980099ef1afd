// The keys, and from the same table their help.

import * as actions from "./actions.js";
import { clips } from "./clips.js";
import { compare, nextDifference } from "./compare.js";
import { exchange } from "./exchange.js";
import { help } from "./help.js";
import { propose } from "./propose.js";

const key = (keys, shown, text, run) => ({ keys: keys.split(" "), shown, text, run });

export const KEYS = {
  "Frames": [
    key("ArrowLeft", "←", "previous frame (Shift: 5)", (app) => actions.step(app, -1)),
    key("ArrowRight", "→", "next frame (Shift: 5)", (app) => actions.step(app, 1)),
    key("Shift+ArrowLeft", "", "", (app) => actions.step(app, -5)),
    key("Shift+ArrowRight", "", "", (app) => actions.step(app, 5)),
    key("Home", "Home", "first frame", (app) => actions.goTo(app, 0)),
    key("End", "End", "last frame", (app) => actions.goTo(app, Infinity)),
    key("Space", "Space", "play, stop", actions.play),
    key("f", "F", "flicker this frame and the next", actions.flicker),
    key(",", ",", "previous key frame of the object", (app) => actions.toKeyFrame(app, -1)),
    key(".", ".", "next key frame", (app) => actions.toKeyFrame(app, 1)),
  ],
  "Labels": [
    ...[1, 2, 3, 4, 5, 6, 7, 8, 9].map((n) =>
      key(String(n), n === 1 ? "1 – 9" : "", "motion of the object or the lasso", (app) => actions.setMotion(app, n))),
    key("0", "0", "background: static, in front of a motion", (app) => actions.setMotion(app, 0)),
    key("x", "X", "reject: ambiguous", (app) => actions.setMotion(app, "reject")),
    key("q", "Q", "lasso trajectories, then a label", (app) => actions.setTool(app, "lasso")),
    key("Shift+Q", "Shift+Q", "remove the lassos of this frame", actions.removeMarksHere),
  ],
  "Objects": [
    key("n", "N", "outline a new object", (app) => actions.setTool(app, "draw", "object")),
    key("r", "R", "outline it anew in this frame", (app) => actions.redraw(app, "region")),
    key("p", "P", "outline another part of it", (app) => actions.redraw(app, "part")),
    key("]", "]", "next object", (app) => actions.cycleObject(app, 1)),
    key("[", "[", "previous object", (app) => actions.cycleObject(app, -1)),
    key("c", "C", "copy to the next frame by motion", actions.copyToNext),
    key("o", "O", "occluded from here on", (app) => actions.toggleVisibility(app, "occluded")),
    key("e", "E", "leaves: outside from here on", (app) => actions.toggleVisibility(app, "outside")),
    key("Shift+E", "Shift+E", "enters here: outside before", actions.enterHere),
    key("Backspace", "Backspace", "forget this key frame (while drawing: last point)", (app) =>
      app.state.pending ? actions.takeBackPoint(app) : actions.forgetKey(app)),
    key("Delete", "Delete", "not in this frame", actions.deleteHere),
    key("Shift+Delete", "Shift+Delete", "delete the object from the clip", actions.deleteObject),
  ],
  "Points": [
    key("v", "V", "next point (Shift: previous)", (app) => actions.cycleVertex(app, 1)),
    key("Shift+V", "", "", (app) => actions.cycleVertex(app, -1)),
    key("i", "I J K L", "move the point, or the cross to draw with", (app) => actions.nudge(app, 0, -1)),
    key("k", "", "", (app) => actions.nudge(app, 0, 1)),
    key("j", "", "", (app) => actions.nudge(app, -1, 0)),
    key("l", "", "", (app) => actions.nudge(app, 1, 0)),
    key("Shift+I", "Shift", "10 pixels at once", (app) => actions.nudge(app, 0, -10)),
    key("Shift+K", "", "", (app) => actions.nudge(app, 0, 10)),
    key("Shift+J", "", "", (app) => actions.nudge(app, -10, 0)),
    key("Shift+L", "", "", (app) => actions.nudge(app, 10, 0)),
    key("Enter", "Enter", "point at the cross; again: done", actions.enter),
    key("Escape", "Esc", "let go, step by step", actions.escape),
    key("w", "W", "insert a point after this one", actions.insertVertex),
    key("d", "D", "delete the point (or right click)", (app) => actions.deleteVertex(app)),
  ],
  "View": [
    key("+ = Shift++", "+", "zoom in at the cursor (wheel)", (app) => actions.zoom(app, 1.4)),
    key("-", "−", "zoom out", (app) => actions.zoom(app, 1 / 1.4)),
    key("z", "Z", "zoom to the object", actions.fitObject),
    key("Shift+Z", "Shift+Z", "whole frame", actions.fitAll),
    key("Ctrl+ArrowLeft", "Ctrl+arrows", "pan (drag the ground)", (app) => actions.pan(app, 80, 0)),
    key("Ctrl+ArrowRight", "", "", (app) => actions.pan(app, -80, 0)),
    key("Ctrl+ArrowUp", "", "", (app) => actions.pan(app, 0, 80)),
    key("Ctrl+ArrowDown", "", "", (app) => actions.pan(app, 0, -80)),
    key("t", "T", "trails", (app) => actions.toggle(app, "trails")),
    key("y", "Y", "colour by label, by length, none", actions.cycleColouring),
    key("u", "U", "only unlabelled and conflicts", (app) => actions.toggle(app, "problems")),
    key("g", "G", "go to the next of them", actions.nextProblem),
    key("h", "H", "hide the regions", (app) => actions.toggle(app, "hidden")),
    key("b", "B", "brighter picture", actions.brighten),
  ],
  "Work": [
    key("Ctrl+z", "Ctrl+Z", "undo, without end", (app) => app.undo()),
    key("Ctrl+Shift+Z Ctrl+y", "Ctrl+Shift+Z", "redo", (app) => app.redo()),
    key("Ctrl+s", "Ctrl+S", "save now (it saves by itself)", (app) => app.saver.flush()),
    key("s", "S", "propose regions", propose),
    key("m", "M", "compare with the other annotator", compare),
    key("Shift+G", "Shift+G", "next difference from the other", nextDifference),
    key("Ctrl+e", "Ctrl+E", "import and export", exchange),
    key("PageDown", "PageDown", "next clip", (app) => app.openNext(1)),
    key("PageUp", "PageUp", "previous clip", (app) => app.openNext(-1)),
    key("F2", "F2", "all clips and their progress", clips),
    key("? Shift+?", "?", "these keys", help),
  ],
};

const TABLE = new Map(Object.values(KEYS).flat().flatMap((entry) => entry.keys.map((name) => [name, entry])));

function nameOf(event) {
  const pressed = event.key === " " ? "Space" : event.key;
  const shifted = event.shiftKey && (pressed.length > 1 || pressed.toUpperCase() !== pressed.toLowerCase() || pressed === "+");
  const ctrl = event.ctrlKey || event.metaKey;
  const letter = pressed.length === 1 && !event.shiftKey ? pressed.toLowerCase() : pressed;
  return `${ctrl ? "Ctrl+" : ""}${shifted ? "Shift+" : ""}${shifted && letter.length === 1 ? letter.toUpperCase() : letter}`;
}

/** Run what a key stands for; true when it stands for something. */
export function press(app, event) {
  const entry = TABLE.get(nameOf(event));
  if (!entry || event.altKey || !app.state.doc) return false;
  app.attempt(entry.run);
  return true;
}

export function listen(app) {
  addEventListener("keydown", (event) => {
    const { target } = event;
    if (document.querySelector("dialog[open]")) return;
    if (target.matches("input, select, textarea")) {
      if (event.key === "Escape" || (event.key === "Enter" && target.matches("input"))) target.blur();
      if (!(event.ctrlKey && "sz".includes(event.key.toLowerCase()))) return;
      target.blur();
    }
    if (target.matches("button") && (event.key === "Enter" || event.key === " ")) return;
    if (press(app, event)) event.preventDefault();
  });
}
