// Proposed regions: a person accepts, corrects or rejects each.

import * as actions from "./actions.js";
import * as api from "./api.js";
import { button, close, open, row } from "./dialog.js";
import { element } from "./dom.js";
import { boundsOf } from "./geometry.js";
import { around } from "./view.js";

const WHAT = {
  residual: "what does not move with the static scene, from the trajectories",
  tracklets: "KITTI's 3D boxes, projected into the frames (start with --kitti)",
  masks: "masks from a folder (start with --masks)",
};

export function propose(app) {
  const choices = app.state.clip.proposers.map((name) => element("tr", {},
    element("td", {}, button(name, () => ask(app, name))),
    element("td", { className: "faint" }, WHAT[name] ?? "a method of an installed package")));
  open("Propose regions from", element("table", {}, choices), row(button("Cancel", close)));
}

async function ask(app, proposer) {
  open("Propose regions", element("p", {}, `Asking ${proposer}…`));
  try {
    const { objects } = await api.propose(app.state.clip.name, proposer, app.state.doc);
    if (!objects.length) return open("Propose regions", element("p", {}, `${proposer} found nothing that moves.`), row(button("Close", close)));
    app.state.set({ proposals: objects });
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
    app.state.set({ proposals: null, review: null });
    return;
  }
  const index = (at + proposals.length) % proposals.length;
  const item = proposals[index];
  const key = item.key_frames.find((k) => k.polygons.length);
  actions.goTo(app, key.frame);
  app.state.set({ review: { item, index }, view: around(boundsOf(key.polygons), app.stage()) });
}

const without = (app, item) => app.state.set({ proposals: app.state.proposals.filter((other) => other !== item) });

export function accept(app) {
  const { item, index } = app.state.review;
  const { doc } = app.state;
  const id = Math.max(0, ...doc.objects.map((o) => o.id)) + 1;
  const motion = item.motion === "reject" ? "reject" : Math.max(0, ...doc.objects.map((o) => (o.motion === "reject" ? 0 : o.motion))) + 1;
  app.history.edit({ ...doc, objects: [...doc.objects, { ...item, id, motion }] });
  without(app, item);
  app.state.set({ selected: id });
  review(app, index);
}

export function reject(app) {
  const { item, index } = app.state.review;
  without(app, item);
  review(app, index);
}

export function next(app) {
  review(app, app.state.review.index + 1);
}

export function endReview(app) {
  app.state.set({ proposals: null, review: null });
}
