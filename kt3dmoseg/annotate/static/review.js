// The strip that asks about the proposal in view.

import { button } from "./dialog.js";
import { element, fill } from "./dom.js";
import * as propose from "./propose.js";

export function watchReview(app, root) {
  app.state.on(["review", "proposals"], ({ review, proposals }) => {
    root.hidden = !review;
    if (!review) return;
    const text = `${review.item.name}: ${review.index + 1} of ${proposals.length} proposals`;
    const first = button("Accept", () => propose.accept(app), "primary");
    fill(root, element("span", {}, text), first, button("Reject", () => propose.reject(app)),
      button("Next", () => propose.next(app)), button("Done", () => propose.endReview(app)));
    first.focus();
  });
}
