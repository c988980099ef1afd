"use strict";
// What pages do: sort and filter tables, keep what is shown in the address, and draw the trajectories of clips.
const all = (what, root = document) => [...root.querySelectorAll(what)];
const make = (tag, text, values = {}) => Object.assign(document.createElement(tag), { textContent: text }, values);

// --- the address: #ANCHOR&name=value&... ---------------------------------------------------------------------
const address = (hash = location.hash) => {
  const [, anchor, rest] = /^#?([^&]*)&?(.*)$/.exec(hash);
  return { anchor: decodeURI(anchor), values: Object.fromEntries(new URLSearchParams(rest)) };
};
const written = (anchor, values) => {
  const stated = new URLSearchParams(Object.entries(values).filter(([, value]) => value !== ""));
  return `#${encodeURI(anchor)}${stated.size ? "&" : ""}${stated}`;
};
const keep = (changes, anchor = address().anchor) =>
  history.replaceState(null, "", written(anchor, { ...address().values, ...changes }));

// --- tables --------------------------------------------------------------------------------------------------
const valueOf = (row, k) => {
  const cell = row.cells[k], text = cell.textContent.trim();
  return cell.tagName === "TH" || isNaN(parseFloat(text)) ? text.toLowerCase() : parseFloat(text); // "1R2RC" is a name
};

function sort(table, k, down) {
  const sign = down ? -1 : 1, kind = (value) => (value === "" || value === "-" ? 2 : typeof value === "string" ? 1 : 0);
  const rows = [...table.tBodies[0].rows].map((row) => [valueOf(row, k), row]);
  rows.sort(([a], [b]) => kind(a) - kind(b) || sign * (a < b ? -1 : a > b ? 1 : 0)); // what has no value stays last
  table.tBodies[0].append(...rows.map(([, row]) => row));
  [...table.tHead.rows[0].cells].forEach((head, i) => {
    if (i === k) head.setAttribute("aria-sort", down ? "descending" : "ascending");
    else head.removeAttribute("aria-sort");
  });
}

all("table.sorts").forEach((table) => [...table.tHead.rows[0].cells].forEach((head, k) => {
  if (head.matches(".track")) return;
  const button = make("button", "", { type: "button", className: "sort" });
  button.append(...head.childNodes);
  head.append(button);
  button.addEventListener("click", () => {
    sort(table, k, head.getAttribute("aria-sort") === "ascending");
    keep({ sort: `${table.id}.${k}${head.getAttribute("aria-sort") === "descending" ? "d" : ""}` });
  });
}));

// In a narrow window each row is a block, whose cells have their headings in front.
all("table.stacks").forEach((table) => [...table.tBodies[0].rows].forEach((row) => [...row.cells].forEach((cell, k) => {
  cell.dataset.head = cell.matches(".track") || !cell.textContent ? "" : table.tHead.rows[0].cells[k].textContent;
})));

// Elements with data-row are hidden with the row of a table.facets of that name; ranks are among what is shown.
function filter(form) {
  const wanted = [...new FormData(form)].filter(([, value]) => value);
  const fits = (row) => wanted.every(([name, value]) => {
    const have = row.dataset[name], { test } = form.elements[name].dataset;
    if (have === undefined) return true;
    if (test === "least") return Number(have) >= Number(value);
    return test === "part" ? have.toLowerCase().includes(value.toLowerCase()) : have === value;
  });
  const rows = all(".facets tbody tr"), hidden = new Set(rows.filter((row) => !fits(row)).map((row) => row.dataset.row));
  all("[data-row]").forEach((each) => { each.hidden = hidden.has(each.dataset.row); });
  all("[data-board]").forEach((board) => { board.hidden = !all(".facets tbody tr:not([hidden])", board).length; });
  const ranked = rows.filter((row) => row.dataset.group && !row.hidden), pooled = Boolean(form.elements.unit?.value);
  const shown = (row) => Number(row.dataset[pooled ? "pooled" : "shown"]);
  all("table.board").filter((table) => table.classList.contains("pooled") !== pooled).forEach((table) => {
    table.classList.toggle("pooled", pooled);
    const key = ({ dataset: d }) => 400 * (d.kind === "printed") + 200 * (d.number === "found") + 100 * !d.group;
    table.tBodies[0].append(...[...table.tBodies[0].rows].sort((a, b) => key(a) - key(b) || shown(a) - shown(b)));
  });
  ranked.forEach((row) => {
    const better = (other) => other.dataset.group === row.dataset.group && shown(other) < shown(row);
    const rank = 1 + ranked.filter(better).length;
    row.cells[0].textContent = rank;
    row.classList.toggle("own", rank === 1);
  });
  all("output.count", form).forEach((each) => { each.textContent = `${rows.length - hidden.size} of ${rows.length} rows`; });
}

const forms = all("form.filters");
const cleared = (form) => Object.fromEntries([...form.elements].map((each) => [each.name, ""]));
forms.forEach((form) => {
  form.addEventListener("submit", (event) => event.preventDefault());
  form.addEventListener("reset", () => setTimeout(() => form.dispatchEvent(new Event("input"))));
  form.addEventListener("input", () => {
    filter(form);
    keep({ ...cleared(form), ...Object.fromEntries(new FormData(form)) });
  });
});

// --- clips ---------------------------------------------------------------------------------------------------
// Colours come from the one palette, kt3dmoseg/draw/palette.py; a label has the number and colour that it has in files and pictures.
const colourOf = (i, background) => {
  if (i === 0) return PALETTE.unlabelled;
  return i === background ? PALETTE.background : PALETTE.labels[(i - 1) % PALETTE.labels.length];
};
const MISSING = -32768;
const TRAIL = 6; // frames
const NEIGHBOURS = 8;
const NEAR = 14; // CSS pixels from the pointer
const stillPlease = matchMedia("(prefers-reduced-motion: reduce)").matches;
const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
const views = new Map(); // by name of the clip
let only = null; // { axis, bin }: the trajectories of one bar

function view(root) {
  const find = (what) => root.querySelector(what);
  const section = root.closest("section"), name = section.id.slice(5), data = JSON.parse(find("script").textContent);
  const xy = new Int16Array(bytes(data.xy).buffer), truth = bytes(data.truth), count = truth.length;
  const bins = Object.fromEntries(Object.entries(data.bins).map(([axis, text]) => [axis, bytes(text)]));
  const runs = data.runs.map((run) => ({ ...run, shown: bytes(run.shown), wrong: bytes(run.wrong) }));
  const slider = find("input[type=range]"), output = find("output"), button = find("button"), strip = find(".strip");
  const onlyErrors = find("input[type=checkbox]"), choice = find("select"), picked = find(".picked"), images = [];
  const canvases = all("figure canvas", root), around = { zoom: 1, x: 0, y: 0 }; // what part of the picture is shown
  const methods = canvases.map((canvas) => canvas.dataset.method).filter((k) => k !== "").map(Number);
  let timer = 0, track = -1, neighbours = [];

  const seed = () => (choice ? Number(choice.value) : runs.length ? runs[0].seed : 0);
  const runOf = (k) => runs.find((r) => r.method === k && r.seed === seed()) ?? runs.find((r) => r.method === k);
  const seedOf = (k) => (runOf(k).seed === seed() ? "" : ` (seed ${runOf(k).seed}; none of seed ${seed()})`); // it failed
  const wrongOf = (method, n) => (method === "" ? methods : [Number(method)]).some((k) => runOf(k).wrong[n]); // in the truth: by any
  const at = (n, f) => 2 * (n * data.n_frames + f);
  const place = (n, f) => [xy[at(n, f)] / data.scale, xy[at(n, f) + 1] / data.scale];
  const far = (n, f, x, y) => Math.hypot(place(n, f)[0] - x, place(n, f)[1] - y);
  const visible = (n, f) => xy[at(n, f)] !== MISSING;
  const wanted = (n) => !only || (truth[n] > 0 && bins[only.axis][n] === only.bin);

  function picture(frame) {
    while (frame > 0 && !data.frames[frame]) frame--; // of long clips not every frame is here
    if (!data.frames.length) return null;
    if (!images[frame]) {
      images[frame] = new Image();
      images[frame].onload = draw;
      images[frame].src = data.frames[frame];
    }
    return images[frame].complete ? images[frame] : null;
  }

  function draw() {
    const frame = Number(slider.value);
    output.textContent = `frame ${data.numbers[frame]}`;
    slider.setAttribute("aria-valuetext", output.textContent);
    canvases.forEach((canvas) => paint(canvas, frame, canvas.dataset.method));
    all("figcaption[data-method]", root).forEach((each) => {
      each.dataset.text ??= each.textContent;
      each.textContent = each.dataset.text + seedOf(Number(each.dataset.method));
    });
    drawStrip(frame);
  }

  function paint(canvas, frame, method) {
    const predicted = method !== "", run = runOf(Number(method));
    const across = canvas.clientWidth || 1000, density = devicePixelRatio || 1;
    const base = Math.min(3, (across * density) / data.width), zoom = base * around.zoom;
    canvas.width = Math.round(data.width * base);
    canvas.height = Math.round(data.height * base);
    canvas.style.touchAction = around.zoom > 1 ? "none" : "pan-y";
    const pen = canvas.getContext("2d"), image = picture(frame);
    const toX = (x) => (x + 0.5 - around.x) * zoom, toY = (y) => (y + 0.5 - around.y) * zoom;
    if (image) {
      pen.globalAlpha = 0.75; // dimmed by the dark ground, so that points are visible
      pen.drawImage(image, toX(-0.5), toY(-0.5), data.width * zoom, data.height * zoom);
    }
    const radius = density * Math.max(1.4, Math.min(3, across / 420)) * Math.min(2, Math.sqrt(around.zoom));
    const stroke = (width, colour, alpha = 1) => {
      Object.assign(pen, { lineWidth: width, strokeStyle: colour, globalAlpha: alpha });
      pen.stroke();
    };
    const circle = (n, size) => {
      const [x, y] = place(n, frame);
      pen.beginPath();
      pen.arc(toX(x), toY(y), size, 0, 7);
    };
    const ring = (n, size, width, colour) => { circle(n, size); stroke(width, colour); };
    (predicted ? run.shown : truth).forEach((label, n) => {
      const wrong = wrongOf(method, n);
      if (!visible(n, frame) || (onlyErrors.checked && !wrong)) return;
      const colour = colourOf(label, data.background), faint = wanted(n) ? 1 : 0.12;
      pen.beginPath();
      for (let f = frame; f >= Math.max(0, frame - TRAIL) && visible(n, f); f--) {
        const [x, y] = place(n, f);
        pen.lineTo(toX(x), toY(y));
      }
      stroke(radius * 0.7, colour, 0.7 * faint);
      circle(n, radius);
      Object.assign(pen, { fillStyle: colour, globalAlpha: faint });
      pen.fill();
      stroke(0.7, "rgba(0,0,0,.65)", faint);
      if (predicted && wrong && faint === 1) {
        ring(n, radius * 1.9, radius * 0.75, "#ffffff");
        ring(n, radius * 1.9, radius * 0.4, PALETTE.wrong);
      }
    });
    neighbours.filter((n) => visible(n, frame)).forEach((n) => ring(n, radius * 2.6, radius * 0.5, "#ffffff"));
    if (track >= 0 && visible(track, frame)) {
      ring(track, radius * 4, radius * 1.3, "#000000");
      ring(track, radius * 4, radius * 0.7, "#ffffff");
    }
  }

  // Wrong trajectories of every frame, one row of bars per method.
  const wrongIn = (run, f) => { let n = 0; run.wrong.forEach((w, i) => { n += w && wanted(i) && visible(i, f) ? 1 : 0; }); return n; };
  function drawStrip(frame) {
    const density = devicePixelRatio || 1, width = strip.clientWidth * density, high = 26 * density;
    Object.assign(strip, { width, height: high * Math.max(1, methods.length) });
    const pen = strip.getContext("2d"), style = getComputedStyle(strip), step = width / data.n_frames;
    const frames = [...Array(data.n_frames).keys()], table = methods.map((k) => frames.map((f) => wrongIn(runOf(k), f)));
    const most = Math.max(1, ...table.flat());
    const bar = (colour, ...box) => { pen.fillStyle = style.getPropertyValue(colour); pen.fillRect(...box); };
    bar("--hover", frame * step, 0, step, strip.height);
    Object.assign(pen, { font: `${11 * density}px sans-serif`, textBaseline: "top" });
    table.forEach((row, k) => row.forEach((n, f) => {
      const tall = n ? Math.max(density, (n / most) * (high - 4 * density)) : 0;
      bar(f === frame ? "--ink" : "--bad", f * step + density, (k + 1) * high - tall, step - 2 * density, tall);
      bar("--line", f * step + density, (k + 1) * high - 1, step - 2 * density, 1);
      pen.fillStyle = style.getPropertyValue("--ink");
      if (!f && METHODS.length > 1) pen.fillText(METHODS[methods[k]].split(" ")[0], 2 * density, k * high + 2 * density);
    }));
    strip.title = methods.map((k, i) => `${METHODS[k]}${seedOf(k)}: ${table[i][frame]} wrong in frame ${data.numbers[frame]}`).join("; ");
  }

  function remember() {
    const values = { frame: Number(slider.value), track: track < 0 ? "" : data.ids[track], seed: choice ? seed() : "" };
    const part = around.zoom > 1 ? [around.zoom, around.x, around.y].map((v) => v.toFixed(2)).join("_") : "";
    keep({ ...values, part }, section.id);
  }

  function zoomBy(factor, x = around.x + data.width / around.zoom / 2, y = around.y + data.height / around.zoom / 2) {
    const zoom = Math.min(12, Math.max(1, around.zoom * factor)), ratio = around.zoom / zoom;
    move(x - (x - around.x) * ratio, y - (y - around.y) * ratio, zoom);
  }

  function move(x, y, zoom = around.zoom) {
    const fit = (value, size) => Math.min(Math.max(0, value), size - size / zoom);
    Object.assign(around, { zoom, x: fit(x, data.width), y: fit(y, data.height) });
    draw();
    remember();
  }

  function select(n) {
    const frame = Number(slider.value), apart = (k) => far(k, frame, ...place(n, frame));
    track = n;
    const near = [...Array(count).keys()].filter((k) => n >= 0 && k !== n && visible(k, frame) && visible(n, frame));
    neighbours = near.sort((a, b) => apart(a) - apart(b)).slice(0, NEIGHBOURS);
    picked.replaceChildren(...(n < 0 ? [] : described(n)));
    draw();
    remember();
  }

  function described(n) {
    const mark = (k) => methods.map((m) => [m, runOf(m)]).map(([m, r]) => `${METHODS[m].split(" ")[0]} ${r.wrong[k] ? "✗" : "✓"}`).join(" ");
    const dot = (label) => make("span", "", { className: "dot", style: `background:${colourOf(label, data.background)}` });
    const line = make("p", ""), list = make("p", "Nearest: ", { className: "neighbours" });
    const facts = Object.keys(bins).map((axis) => `${AXES[axis][0]}: ${AXES[axis][1 + bins[axis][n]]}`);
    const true_ = truth[n] ? `true motion ${truth[n]}` : "no true label";
    line.append(make("b", `Trajectory ${data.ids[n]} `), dot(truth[n]), `${true_}; ${truth[n] ? mark(n) : ""}`);
    neighbours.forEach((k) => {
      const other = make("button", "", { type: "button" });
      other.append(dot(truth[k]), `${data.ids[k]} ${truth[k] ? mark(k) : "-"}`);
      other.addEventListener("click", () => select(k));
      list.append(other);
    });
    return [line, make("p", facts.join("; "), { className: "quiet" }), list];
  }

  canvases.forEach((canvas) => {
    let from = null;
    const where = (event) => {
      const box = canvas.getBoundingClientRect(), unit = data.width / around.zoom / box.width;
      return [around.x + (event.clientX - box.x) * unit - 0.5, around.y + (event.clientY - box.y) * unit - 0.5, unit];
    };
    canvas.addEventListener("pointerdown", (event) => {
      from = { x: event.clientX, y: event.clientY, left: around.x, top: around.y, moved: false };
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!from || !event.buttons) return;
      const unit = where(event)[2], dx = event.clientX - from.x, dy = event.clientY - from.y;
      from.moved ||= Math.hypot(dx, dy) > 4;
      if (from.moved && around.zoom > 1) move(from.left - dx * unit, from.top - dy * unit);
    });
    canvas.addEventListener("click", (event) => {
      if (from && from.moved) return;
      const [x, y, unit] = where(event), frame = Number(slider.value);
      const shown = (n) => visible(n, frame) && wanted(n) && (!onlyErrors.checked || wrongOf(canvas.dataset.method, n));
      const apart = (n) => far(n, frame, x, y);
      const found = [...Array(count).keys()].filter(shown).reduce((a, b) => (a < 0 || apart(b) < apart(a) ? b : a), -1);
      select(found >= 0 && apart(found) < NEAR * unit ? found : -1);
    });
    canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.metaKey) return; // the page scrolls
      event.preventDefault();
      zoomBy(event.deltaY < 0 ? 1.25 : 0.8, ...where(event));
    }, { passive: false });
  });
  button.addEventListener("click", () => {
    clearInterval(timer);
    timer = timer ? 0 : setInterval(() => {
      slider.value = (Number(slider.value) + 1) % data.n_frames;
      draw();
    }, stillPlease ? 800 : 160);
    button.textContent = timer ? "Pause" : "Play";
    button.setAttribute("aria-pressed", String(Boolean(timer)));
  });
  all("[data-zoom]", root).forEach((each) => each.addEventListener("click", () => zoomBy(Number(each.dataset.zoom))));
  strip.addEventListener("click", (event) => {
    slider.value = Math.floor((event.offsetX / strip.clientWidth) * data.n_frames);
    select(track);
  });
  slider.addEventListener("input", () => select(track));
  onlyErrors.addEventListener("change", draw);
  if (choice) choice.addEventListener("change", () => select(track));
  draw();
  views.set(name, {
    draw,
    show({ frame, track: id, seed: wantedSeed, part }) {
      if (choice && wantedSeed) choice.value = wantedSeed;
      if (frame) slider.value = frame;
      if (part) move(...((p) => [p[1], p[2], p[0]])(part.split("_").map(Number)));
      select(id ? data.ids.indexOf(Number(id)) : -1);
    },
  });
}

// A viewer is made when it is first near the window, so that not all clips' frames are decoded at once;
// a printed page shows them all.
const waiting = new Set(all(".viewer"));
const start = (root) => {
  if (!waiting.delete(root)) return;
  near.unobserve(root);
  view(root);
};
const near = new IntersectionObserver(
  (entries) => entries.filter((entry) => entry.isIntersecting).forEach((entry) => start(entry.target)),
  { rootMargin: "400px" },
);
waiting.forEach((root) => near.observe(root));
addEventListener("beforeprint", () => {
  all("details").forEach((part) => { part.open = true; });
  [...waiting].forEach(start);
});
all("[data-colour]").forEach((dot) => {
  dot.style.background = colourOf(Number(dot.dataset.colour), Number(dot.closest("section").dataset.background));
});

// --- from a bar to its trajectories --------------------------------------------------------------------------
function showOnly(text) {
  const parts = all("[data-bin]").filter((each) => each.classList.toggle("own", each.dataset.bin === text));
  const [axis, bin] = text.split(".");
  only = parts.length ? { axis, bin: Number(bin) } : null;
  views.forEach((each) => each.draw());
}
all(".only button").forEach((each) => each.addEventListener("click", () => { keep({ bin: "" }); showOnly(""); }));

// --- what the address asks for -------------------------------------------------------------------------------
function fill(form, values) {
  [...form.elements].filter((e) => e.name).forEach((e) => {
    if (e.type === "checkbox") e.checked = Boolean(values[e.name]);
    else e.value = values[e.name] ?? "";
  });
  filter(form);
}

// A link of the page keeps what is shown in the address, but for the place in a clip.
addEventListener("click", (event) => {
  const link = event.target.closest("a[href^='#']");
  if (!link || event.ctrlKey || event.metaKey || event.shiftKey) return;
  event.preventDefault();
  const { anchor, values } = address(link.getAttribute("href")), { frame, track, part, ...shown } = address().values;
  const hash = written(anchor, { ...shown, ...values });
  if (location.hash === hash) follow();
  else location.hash = hash;
});

function follow() {
  const { anchor, values } = address(), target = document.getElementById(anchor);
  forms.forEach((form) => fill(form, values));
  if (target?.closest("[hidden]")) { // a filter hides what is asked for
    forms.forEach((form) => fill(form, {}));
    forms.forEach((form) => keep(cleared(form)));
  }
  const [, id, k, down] = /^(.*)\.(\d+)(d?)$/.exec(values.sort ?? "") ?? [];
  if (id && document.getElementById(id)) sort(document.getElementById(id), Number(k), Boolean(down));
  if ((values.bin ?? "") !== (only ? `${only.axis}.${only.bin}` : "")) showOnly(values.bin ?? "");
  if (!target) return;
  for (let part = target; part; part = part.parentElement) if (part.tagName === "DETAILS") part.open = true;
  target.scrollIntoView({ block: target.matches("table") ? "nearest" : "start" });
  const viewer = target.querySelector(".viewer");
  if (!viewer) return;
  start(viewer);
  if (values.frame || values.track || values.part) views.get(anchor.slice(5)).show(values);
}
addEventListener("hashchange", follow);
follow();
