// All clips and how far each is.

import { button, close, open, row, table } from "./dialog.js";
import { element, fill } from "./dom.js";
import { meter, overall, percent, shareOf } from "./progress.js";

const HEADS = ["clip", "frames", "objects", "motions", "labelled", "", "saved", "by"];

let body = null;

export function clips(app) {
  body = element("div");
  open("Clips", body, row(button("Close", close)));
  draw(app);
  body.querySelector("button.on")?.focus();
}

export function watchClips(app) {
  app.state.on(["summaries"], () => body?.isConnected && draw(app));
}

function draw(app) {
  const { summaries } = app.state;
  if (!summaries) {
    fill(body, element("p", {}, "Counting…"));
    return;
  }
  const focused = document.activeElement?.dataset?.clip;
  const rows = summaries.map((summary) => [link(app, summary.name), `${summary.n_frames}`, `${summary.objects ?? ""}`,
    `${summary.motions ?? ""}`, ...progress(summary), saved(summary), summary.annotator ?? ""]);
  const top = body.querySelector(".scroll")?.scrollTop ?? 0;
  fill(body, total(overall(summaries)), table(HEADS, rows));
  body.querySelector(".scroll").scrollTop = top;
  if (focused) body.querySelector(`[data-clip="${CSS.escape(focused)}"]`)?.focus({ preventScroll: true });
}

function total(all) {
  const text = [`${all.annotated} of ${all.clips} clips annotated.`];
  if (all.total) text.push(`${percent(all)} of ${all.total} trajectories labelled, ${all.open} open.`);
  if (all.counting) text.push(`Counting ${all.counting} more…`);
  if (all.unknown) text.push(`Without trajectories yet: ${all.unknown}; open them, or start with --tracks.`);
  return element("p", { role: "status" }, meter(all), ` ${text.join(" ")}`);
}

function link(app, name) {
  const here = name === app.state.clip?.name;
  const go = button(name, () => {
    close();
    app.open(name);
  }, here ? "on" : "");
  go.dataset.clip = name;
  return go;
}

const saved = ({ objects, revision }) => (objects === undefined ? "" : `rev ${revision}`);

function progress(summary) {
  const note = (text, className = "faint") => [element("span", { className }, text), ""];
  if (summary.error) return note(summary.error, "bad");
  const share = shareOf(summary);
  if (!share) return note(summary.counting ? "counting…" : summary.objects === undefined ? "to do" : "no trajectories yet");
  if (summary.objects === undefined) return [meter(share), "to do"];
  return [meter(share), `${percent(share)}, ${share.open} open`];
}
