"use strict";
// Draws the trajectories of a clip, true and predicted, on its frames. Data sit in the page.
// Colours come from the one palette, kt3dmoseg/draw/palette.py; a label has the number and colour that it has in files and pictures.
const colourOf = (i, background) => {
  if (i === 0) return PALETTE.unlabelled;
  return i === background ? PALETTE.background : PALETTE.labels[(i - 1) % PALETTE.labels.length];
};
const MISSING = -32768;
const TRAIL = 6; // frames
const stillPlease = matchMedia("(prefers-reduced-motion: reduce)").matches;

function bytes(text) {
  return Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
}

function positions(text) {
  const raw = bytes(text), view = new DataView(raw.buffer), out = new Int16Array(raw.length / 2);
  for (let i = 0; i < out.length; i++) out[i] = view.getInt16(2 * i, true);
  return out;
}

class Viewer {
  constructor(root) {
    this.root = root;
    const data = JSON.parse(root.querySelector("script").textContent);
    this.data = data;
    this.xy = positions(data.xy);
    this.truth = bytes(data.truth);
    this.runs = data.runs.map((run) => ({ shown: bytes(run.shown), wrong: bytes(run.wrong) }));
    this.canvases = [...root.querySelectorAll("canvas")];
    this.slider = root.querySelector("input[type=range]");
    this.output = root.querySelector("output");
    this.onlyErrors = root.querySelector("input[type=checkbox]");
    this.choice = root.querySelector("select");
    this.button = root.querySelector("button");
    this.images = data.frames.map(() => null);
    this.timer = 0;
    const redraw = () => this.draw();
    this.slider.addEventListener("input", redraw);
    this.onlyErrors.addEventListener("change", redraw);
    if (this.choice) this.choice.addEventListener("change", redraw);
    this.button.addEventListener("click", () => this.play());
    this.draw();
  }

  play() {
    if (this.timer) {
      clearInterval(this.timer);
      this.timer = 0;
    } else {
      this.timer = setInterval(() => {
        this.slider.value = (Number(this.slider.value) + 1) % this.data.n_frames;
        this.draw();
      }, stillPlease ? 800 : 160);
    }
    this.button.textContent = this.timer ? "Pause" : "Play";
    this.button.setAttribute("aria-pressed", String(Boolean(this.timer)));
  }

  image(frame) {
    if (!this.data.frames.length) return null;
    if (!this.images[frame]) {
      const image = new Image();
      image.onload = () => this.draw();
      image.src = this.data.frames[frame];
      this.images[frame] = image;
    }
    return this.images[frame].complete ? this.images[frame] : null;
  }

  at(n, frame) {
    return 2 * (n * this.data.n_frames + frame);
  }

  trail(pen, n, frame, onCanvas, radius, colour) {
    pen.beginPath();
    for (let f = frame; f >= Math.max(0, frame - TRAIL); f--) {
      const at = this.at(n, f);
      if (this.xy[at] === MISSING) break;
      pen.lineTo(onCanvas(this.xy[at]), onCanvas(this.xy[at + 1]));
    }
    pen.globalAlpha = 0.7;
    pen.lineWidth = radius * 0.7;
    pen.strokeStyle = colour;
    pen.stroke();
    pen.globalAlpha = 1;
  }

  draw() {
    const frame = Number(this.slider.value);
    this.output.textContent = `frame ${this.data.numbers[frame]}`;
    this.slider.setAttribute("aria-valuetext", this.output.textContent);
    const run = this.runs[this.choice ? this.choice.selectedIndex : 0];
    this.canvases.forEach((canvas, i) => this.paint(canvas, frame, run, i === 1));
  }

  paint(canvas, frame, run, predicted) {
    const { width, height, scale } = this.data;
    const across = canvas.clientWidth || 1000, density = devicePixelRatio || 1;
    const zoom = Math.min(3, (across * density) / width);
    canvas.width = Math.round(width * zoom);
    canvas.height = Math.round(height * zoom);
    const pen = canvas.getContext("2d");
    const image = this.image(frame);
    if (image) {
      pen.globalAlpha = 0.75; // dimmed by the dark ground, so that points are visible
      pen.drawImage(image, 0, 0, canvas.width, canvas.height);
      pen.globalAlpha = 1;
    }
    const shown = predicted ? run && run.shown : this.truth;
    if (!shown) return;
    const radius = density * Math.max(1.4, Math.min(3, across / 420));
    const onCanvas = (step) => (step / scale + 0.5) * zoom;
    for (let n = 0; n < shown.length; n++) {
      const at = this.at(n, frame);
      if (this.xy[at] === MISSING) continue;
      const wrong = run && run.wrong[n];
      if (this.onlyErrors.checked && !wrong) continue;
      const x = onCanvas(this.xy[at]), y = onCanvas(this.xy[at + 1]);
      const colour = colourOf(shown[n], this.data.background);
      this.trail(pen, n, frame, onCanvas, radius, colour);
      pen.beginPath();
      pen.arc(x, y, radius, 0, 7);
      pen.fillStyle = colour;
      pen.fill();
      pen.lineWidth = 0.7;
      pen.strokeStyle = "rgba(0,0,0,.65)";
      pen.stroke();
      if (predicted && wrong) {
        pen.beginPath();
        pen.arc(x, y, radius * 1.9, 0, 7);
        pen.lineWidth = radius * 0.75;
        pen.strokeStyle = "#ffffff";
        pen.stroke();
        pen.lineWidth = radius * 0.4;
        pen.strokeStyle = "#e3170a";
        pen.stroke();
      }
    }
  }
}

// A viewer is made when it is first near the window, so that not all clips' frames are decoded at once;
// a printed page shows them all.
const waiting = new Set(document.querySelectorAll(".viewer"));
const make = (root) => {
  if (!waiting.delete(root)) return;
  near.unobserve(root);
  new Viewer(root);
};
const near = new IntersectionObserver(
  (entries) => entries.filter((entry) => entry.isIntersecting).forEach((entry) => make(entry.target)),
  { rootMargin: "400px" },
);
waiting.forEach((root) => near.observe(root));
addEventListener("beforeprint", () => {
  document.querySelectorAll("details").forEach((part) => { part.open = true; });
  waiting.forEach(make);
});
document.querySelectorAll("[data-colour]").forEach((dot) => {
  dot.style.background = colourOf(Number(dot.dataset.colour), Number(dot.closest("section").dataset.background));
});
