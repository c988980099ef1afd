// Proposed regions: a person accepts, corrects or rejects each.

import * as actions from "./actions.js";
import * as api from "./api.js";
import { button, close, open, row } from "./dialog.js";
import { element } from "./dom.js";
import { nextId, nextMotion } from "./edits.js";
import { boundsOf } from "./geometry.js";
import { around } from "./view.js";

const WHAT = {
  residual: "what does not move with the static scene, from the trajectories",
  tracklets: "KITTI's 3D boxes, projected into the frames",
  masks: "masks from a folder",
  mseg: "the clusters of a motion segmentation; takes some 20 seconds",
};

export function propose(app) {
  const choices = Object.entries(app.state.clip.proposers).map(([name, lacking]) => {
    const what = WHAT[name] ?? "a method of an installed package";
    const choice = element("button", { disabled: Boolean(lacking), onclick: () => ask(app, name) }, name);
    return element("tr", {}, element("td", {}, choice),
      element("td", { className: "faint" }, lacking ? `${what}: ${lacking}` : what));
  });
  open("Propose regions from", element("table", {}, choices), row(button("Cancel", close)));
}

async function ask(app, proposer) {
  open("Propose regions", element("p", {}, `Asking ${proposer}…`));
  try {
    const { objects } = await api.propose(app.state.clip.name, proposer, app.state.doc);
    if (!objects.length) return open("Propose regions", element("p", {}, `${proposer} found nothing that moves.`), row(button("Close", close)));
    app.state.set({ proposals: objects, compared: null });
    review(app, 0);
  } catch (error) {
    open("No proposals", element("p", {}, error.message), row(button("Close", close)));
  }
  return undefined;
}

/** Show the proposals one by one beside the frame. */
function review(app, at) {
  close();
  const { proposals } = app.state;
  if (!proposals?.length) {
    endReview(app);
    return;
  }
  const index = (at + proposals.length) % proposals.length;
  const item = proposals[index];
  const key = item.key_frames.find((k) => k.polygons.length);
  actions.goTo(app, key.frame);
  app.state.set({ review: { item, index }, view: around(boundsOf(key.polygons), app.stage()) });
}

/** Take the proposal in view out of the list; where `kept`, it becomes an object. */
function settle(app, kept) {
  const { proposals, doc, review: { item } } = app.state;
  app.state.set({ proposals: proposals.filter((other) => other !== item) });
  if (!kept) return;
  const id = nextId(doc);
  const motion = item.motion === "reject" ? "reject" : nextMotion(doc);
  app.history.edit({ ...doc, objects: [...doc.objects, { ...item, id, motion }] });
  app.state.set({ selected: id });
}

export function accept(app) {
  const { index } = app.state.review;
  settle(app, true);
  review(app, index);
}

/** Accept it and wait until a person has put it right. */
export function correct(app) {
  const { item, index } = app.state.review;
  settle(app, true);
  app.state.set({ review: { item: null, name: item.name, index } });
  document.getElementById("stage").focus();
}

export function reject(app) {
  const { index } = app.state.review;
  settle(app, false);
  review(app, index);
}

/** Go to another proposal, or on after a correction. */
export const next = (app, by = 1) => review(app, app.state.review.index + by);

export function endReview(app) {
  app.state.set({ proposals: null, review: null });
  document.getElementById("stage").focus();
}
