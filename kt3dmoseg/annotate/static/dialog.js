// The one dialog of the page. Closing it gives the focus back to the stage.

import { element, fill } from "./dom.js";

const dialog = document.getElementById("dialog");

// Long lists are walked with the arrow keys.
dialog.addEventListener("keydown", (event) => {
  const by = { ArrowDown: 1, ArrowUp: -1 }[event.key];
  const buttons = [...dialog.querySelectorAll(".scroll button")];
  if (!by || !buttons.length) return;
  const at = buttons.indexOf(document.activeElement);
  buttons[Math.min(buttons.length - 1, Math.max(0, at + by))].focus();
  event.preventDefault();
});

export function open(title, ...content) {
  fill(dialog, element("h2", {}, title), ...content);
  if (!dialog.open) dialog.showModal();
  else dialog.querySelector("button:enabled")?.focus();
  dialog.onclose = () => document.getElementById("stage").focus();
  dialog.oncancel = null;
}

export const close = () => dialog.open && dialog.close();

export const row = (...content) => element("div", { className: "row" }, ...content);

export const button = (text, onclick, className = "") => element("button", { onclick, className }, text);

/** A dialog that must be answered: Escape does not close it. */
export function ask(title, ...content) {
  open(title, ...content);
  dialog.oncancel = (event) => event.preventDefault();
}

export const table = (heads, rows) => element("div", { className: "scroll" },
  element("table", {},
    element("tr", {}, heads.map((head) => element("th", {}, head))),
    rows.map((cells) => element("tr", {}, cells.map((cell) => element("td", {}, cell))))));
