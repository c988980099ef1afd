// The strip that asks about the proposal in view.

import { button } from "./dialog.js";
import { element, fill } from "./dom.js";
import * as propose from "./propose.js";

export function watchReview(app, root) {
  app.state.on(["review", "proposals"], ({ review, proposals }) => {
    root.hidden = !review;
    if (!review) return;
    if (review.item) ask(app, root, review, proposals.length);
    else wait(app, root, review, proposals.length);
  });
}

function ask(app, root, { item, index }, count) {
  const first = button("Accept", () => propose.accept(app), "primary");
  fill(root, element("span", {}, `${item.name}: ${index + 1} of ${count} proposed`), first,
    button("Correct", () => propose.correct(app)), button("Reject", () => propose.reject(app)),
    button("Skip", () => propose.next(app)), button("Done", () => propose.endReview(app)));
  first.focus();
}

function wait(app, root, { name }, left) {
  fill(root, element("span", {}, `${name} is an object now: put it right, then`),
    button(left ? `Go on (${left} left)` : "Done", () => propose.next(app, 0), "primary"));
}
