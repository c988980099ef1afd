// Proposed regions: a person accepts, corrects or rejects each.

import * as api from "./api.js";
import { addObject, nextMotion } from "./annotation.js";
import { button, byId, close, element, faint, fill, inform, line, open, row } from "./dom.js";
import { boundsOf } from "./geometry.js";
import { edit, on, set, state } from "./state.js";
import { goTo, showBox } from "./view.js";

const MEANING = {
  residual: "what does not move with the static scene, from the trajectories",
  tracklets: "KITTI's 3D boxes, projected into the frames",
  masks: "masks from a folder",
  mseg: "the clusters of a motion segmentation; takes some 20 seconds",
};

export function propose() {
  const choices = Object.entries(state.clip.proposers).map(([name, lacking]) => {
    const meaning = MEANING[name] ?? "a method of an installed package";
    const choice = element("button", { disabled: Boolean(lacking), onclick: () => request(name) }, name);
    return line([choice, faint(lacking ? `${meaning}: ${lacking}` : meaning)]);
  });
  open("Propose regions from", element("table", {}, choices), row(button("Cancel", close)));
}

async function request(proposer) {
  open("Propose regions", element("p", {}, `Asking ${proposer}…`));
  try {
    const { objects } = await api.propose(state.clip.name, proposer, state.doc);
    if (!objects.length) return inform("Propose regions", `${proposer} found nothing that moves.`);
    set({ proposals: objects, compared: null });
    review(0);
  } catch (error) {
    inform("No proposals", error.message);
  }
  return undefined;
}

/** Show the proposals one by one on the frame. */
function review(at) {
  close();
  const { proposals } = state;
  if (!proposals?.length) {
    end();
    return;
  }
  const index = (at + proposals.length) % proposals.length;
  const item = proposals[index];
  const key = item.key_frames.find((k) => k.polygons.length);
  goTo(key.frame);
  set({ review: { item, index } });
  showBox(boundsOf(key.polygons));
}

/** Take the proposal in view out of the list. */
function settle() {
  const { proposals, review: { item } } = state;
  set({ proposals: proposals.filter((other) => other !== item) });
}

/** The same, and make it an object. */
function accept() {
  const { doc, review: { item } } = state;
  settle();
  edit(addObject(doc, { ...item, motion: item.motion === "reject" ? "reject" : nextMotion(doc) }));
  set({ selected: state.doc.objects.at(-1).id });
}

/** Wait until a person has put the accepted proposal right. */
function correct() {
  const { item, index } = state.review;
  accept();
  set({ review: { item: null, name: item.name, index } });
  byId("stage").focus();
}

function end() {
  set({ proposals: null, review: null });
  byId("stage").focus();
}

/** The strip that asks about the proposal in view. */
function drawStrip() {
  const { review: shown, proposals } = state;
  const root = byId("review");
  root.hidden = !shown;
  if (!shown) return;
  const { item, name, index } = shown;
  if (!item) {
    fill(root, element("span", {}, `${name} is an object now: put it right, then`),
      button(proposals.length ? `Go on (${proposals.length} left)` : "Done", () => review(index), "primary"));
    return;
  }
  const first = button("Accept", () => (accept(), review(index)), "primary");
  fill(root, element("span", {}, `${item.name}: ${index + 1} of ${proposals.length} proposed`), first,
    button("Correct", correct), button("Reject", () => (settle(), review(index))),
    button("Skip", () => review(index + 1)), button("Done", end));
  first.focus();
}

on(["review", "proposals"], drawStrip);
