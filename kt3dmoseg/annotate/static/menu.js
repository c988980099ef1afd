// The menu of the right mouse button, or of the key for it: actions of the table of keys, on what is under it.

import { objectUnder } from "./actions.js";
import { button, byId, element, fill } from "./dom.js";
import { TABLE, here, press } from "./keys.js";
import { select, selectedObject, state } from "./state.js";
import { toImage } from "./view.js";

const OF_OBJECT = "r p c o e Shift+E Backspace z Shift+H Shift+R Delete Shift+Delete".split(" ");
const OF_PLACE = "n q s Shift+Z h t y".split(" ");

const menu = byId("menu");
const stage = byId("stage");

/** Open the menu of an object, or of none, at a place of the window. */
function show(item, x, y) {
  if (item) select(item.id);
  fill(menu, (item ? OF_OBJECT : OF_PLACE).map((name) => {
    const { shown, text } = TABLE.get(name);
    const run = () => (menu.hidePopover(), press(name));
    return button([text.replace(/ \(.*/, ""), element("kbd", {}, here(shown))], run, "", { role: "menuitem" });
  }));
  menu.setAttribute("aria-label", item ? item.name : "Clip");
  menu.showPopover();
  menu.style.left = `${Math.max(0, Math.min(x, innerWidth - menu.offsetWidth - 4))}px`;
  menu.style.top = `${Math.max(0, Math.min(y, innerHeight - menu.offsetHeight - 4))}px`;
  menu.firstChild.focus();
}

/** What a place on the stage, in the list or on the timeline is about. */
function itemAt({ target, clientX, clientY, pointerType }) {
  const listed = target.closest(".entry");
  if (listed) return state.doc.objects.find((item) => String(item.id) === listed.dataset.id);
  const box = stage.getBoundingClientRect();
  return target.closest("#stage") && pointerType !== "" ? objectUnder(toImage([clientX - box.left, clientY - box.top]))
    : selectedObject(); // asked for by key
}

addEventListener("contextmenu", (event) => {
  const { target, clientX, clientY } = event;
  if (event.defaultPrevented || !state.doc || !target.closest("#stage, .entry, #timeline")) return;
  event.preventDefault();
  show(itemAt(event), clientX, clientY);
});

menu.onkeydown = (event) => {
  const by = { ArrowDown: 1, ArrowUp: -1 }[event.key];
  event.stopPropagation();
  if (event.key === "Tab") menu.hidePopover();
  if (!by) return;
  const items = [...menu.children];
  items.at((items.indexOf(document.activeElement) + by) % items.length).focus();
  event.preventDefault();
};
menu.ontoggle = ({ newState }) => newState === "closed" && stage.focus({ preventScroll: true });
