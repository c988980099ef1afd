// Puts the page together.

import * as actions from "./actions.js";
import * as api from "./api.js";
import { clips, watchClips } from "./clips.js";
import { compare, watchCompare } from "./compare.js";
import { watchConflicts } from "./conflict.js";
import { button, close, open, row } from "./dialog.js";
import { element } from "./dom.js";
import * as drafts from "./drafts.js";
import { exchange } from "./exchange.js";
import { help } from "./help.js";
import { History } from "./history.js";
import { Inspector } from "./inspector.js";
import { listen } from "./keys.js";
import { Labeller } from "./labeller.js";
import { Layer } from "./layer.js";
import { merge } from "./merge.js";
import { Objects } from "./objects.js";
import { Picture } from "./picture.js";
import { Pointer } from "./pointer.js";
import { watchProgress } from "./progress.js";
import { propose } from "./propose.js";
import { Regions } from "./regions.js";
import { watchReview } from "./review.js";
import { Saver } from "./saver.js";
import { State } from "./state.js";
import { watchStatus } from "./status.js";
import { Timeline } from "./timeline.js";
import { Tracks } from "./tracks.js";
import { fit, toImage } from "./view.js";

const FRESH = {
  doc: null, frame: 0, selected: null, vertex: null, tool: "select", pending: null, lassoed: null, cross: null,
  pointer: null, hovered: null, tracks: null, labels: null, regions: null, view: null, conflict: null, computing: "loading",
  proposals: null, review: null, compared: null, dragging: false, flickered: null, playing: false, hint: "", scrolled: 0,
};

class App {
  constructor() {
    const by = (id) => document.getElementById(id);
    this.state = new State({
      ...FRESH, clip: null, saving: { kind: "saved", revision: 0 }, trails: true, hidden: false, problems: false,
      colouring: "label", resized: 0, summaries: null,
    });
    this.stageElement = by("stage");
    this.pictureCanvas = by("picture");
    this.layers = ["picture", "tracks", "regions"].map((id) => new Layer(by(id)));
    this.history = new History(this.state);
    this.picture = new Picture(this.state, this.layers[0]);
    this.tracks = new Tracks(this.state, this.layers[1]);
    this.regions = new Regions(this.state, this.layers[2]);
    this.labeller = new Labeller(this.state);
    this.saver = new Saver(this.state);
    this.objects = new Objects(this, by("objects"));
    this.timeline = new Timeline(this, by("timeline"));
    this.inspector = new Inspector(this, by("inspector"));
    new Pointer(this, this.stageElement);
    watchStatus(this);
    watchConflicts(this);
    watchClips(this);
    watchProgress(this, by("progress"));
    watchReview(this, by("review"));
    watchCompare(this, by("differences"));
    listen(this);
    this.#buttons();
    new ResizeObserver(() => this.#resize()).observe(this.stageElement);
    addEventListener("popstate", () => this.open(new URLSearchParams(location.search).get("clip"), false));
  }

  stage() {
    return { width: this.stageElement.clientWidth, height: this.stageElement.clientHeight };
  }

  screenMiddle() {
    const { width, height } = this.stage();
    return [width / 2, height / 2];
  }

  middle() {
    return toImage(this.state.view, this.screenMiddle());
  }

  farthest() {
    return fit(this.state.clip.image_size, this.stage()).scale * 0.5;
  }

  undo() {
    if (!this.history.undo()) actions.say(this, "Nothing to undo");
    this.#forgetGone();
  }

  redo() {
    if (!this.history.redo()) actions.say(this, "Nothing to redo");
    this.#forgetGone();
  }

  #forgetGone() {
    this.state.set({ vertex: null });
    if (!actions.selectedObject(this)) this.state.set({ selected: null });
  }

  /** Open a clip, or say why not. */
  async open(name, remember = true) {
    try {
      await this.#show(name, remember);
    } catch (error) {
      open("The clip cannot be opened", element("p", {}, error.message),
        row(button("Try again", () => (close(), this.open(name, remember))), button("Close", close)));
    }
  }

  /** Run an action; one that fails, for instance because the server is away, says so. */
  async attempt(action) {
    try {
      await action(this);
    } catch (error) {
      actions.say(this, error.message);
    }
  }

  /** What is not saved of the present clip is saved first, or stays in this browser. */
  async #show(name, remember) {
    if (this.saver.pending) await this.saver.flush();
    const clip = await api.getClip(name);
    if (remember) history.pushState(null, "", `?clip=${encodeURIComponent(name)}`);
    this.history.clear();
    const { annotation } = clip;
    this.saver.base = undefined;
    this.state.set({ ...FRESH, clip, doc: annotation, view: fit(clip.image_size, this.stage()) });
    this.saver.open(name, annotation);
    this.picture.open();
    this.stageElement.focus({ preventScroll: true });
    await this.#recover(name, annotation);
    await this.labeller.load(clip);
  }

  /** Bring back edits that did not reach the server before the page was closed. */
  async #recover(name, saved) {
    for (const { base, doc } of await drafts.recover(name)) {
      this.history.edit(base.revision === saved.revision ? doc : merge(base, doc, this.state.doc));
      actions.say(this, "Edits from before, which had not reached the server, are back");
    }
  }

  async openNext(by) {
    const names = (await api.listClips()).map((clip) => clip.name);
    const at = names.indexOf(this.state.clip.name) + by;
    if (names[at]) await this.open(names[at]);
    else actions.say(this, by > 0 ? "This is the last clip" : "This is the first clip");
  }

  #buttons() {
    const run = {
      previous: () => actions.step(this, -1), next: () => actions.step(this, 1), play: () => actions.play(this),
      flicker: () => actions.flicker(this), propose: () => propose(this), exchange: () => exchange(this),
      compare: () => compare(this), help: () => help(),
    };
    document.querySelectorAll("[data-do]").forEach((b) => b.addEventListener("click", () => this.state.doc && this.attempt(run[b.dataset.do])));
    document.querySelectorAll("[data-tool]").forEach((b) =>
      b.addEventListener("click", () => this.state.doc && actions.setTool(this, b.dataset.tool)));
    document.getElementById("clips").addEventListener("click", () => this.attempt(clips));
  }

  #resize() {
    const { width, height } = this.stage();
    this.layers.forEach((layer) => layer.resize(width, height));
    this.state.set({ resized: performance.now() });
    if (this.state.clip) this.state.set({ view: fit(this.state.clip.image_size, this.stage()) });
  }
}

window.labeller = new App();
window.labeller.open(document.documentElement.dataset.clip);
