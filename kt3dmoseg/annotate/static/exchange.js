// Import and export of other tools' formats.

import * as api from "./api.js";
import { button, close, open, row } from "./dialog.js";
import { element } from "./dom.js";

const NAMES = {
  cvat: "CVAT for video 1.1 (XML)", davis: "DAVIS indexed PNG (zip)", mots_txt: "KITTI MOTS (text)",
  mots_png: "KITTI MOTS PNG (zip)", coco: "COCO with RLE masks (JSON)", labelme: "LabelMe (zip)",
};

export function exchange(app) {
  const rows = Object.entries(app.state.clip.formats).map(([name, suffix]) => {
    const file = element("input", { type: "file", accept: suffix, hidden: true, onchange: () => read(app, name, file.files[0]) });
    return element("tr", {},
      element("td", {}, NAMES[name] ?? name),
      element("td", {}, button("Export", () => write(app, name, suffix))),
      element("td", {}, button("Import…", () => file.click()), file));
  });
  open("Files of other tools", element("p", { className: "faint" },
    "An import replaces what is drawn, as one edit that Ctrl+Z takes back."), element("table", {}, rows), row(button("Close", close)));
}

async function write(app, format, suffix) {
  try {
    const content = await api.exportAs(app.state.clip.name, format, app.state.doc);
    const link = element("a", { href: URL.createObjectURL(content), download: `${app.state.clip.name}_${format}${suffix}` });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  } catch (error) {
    failed("Not exported", error);
  }
}

async function read(app, format, file) {
  if (!file) return;
  try {
    const found = await api.importFrom(app.state.clip.name, format, file);
    app.history.edit({ ...app.state.doc, objects: found.objects, marks: found.marks });
    close();
    app.state.set({ selected: found.objects[0]?.id ?? null });
  } catch (error) {
    failed("Not imported", error);
  }
}

const failed = (title, error) => open(title, element("p", {}, error.message), row(button("Close", close)));
