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
const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));

function view(root) {
  const find = (what) => root.querySelector(what);
  const data = JSON.parse(find("script").textContent);
  const xy = new Int16Array(bytes(data.xy).buffer), truth = bytes(data.truth);
  const runs = data.runs.map((run) => ({ shown: bytes(run.shown), wrong: bytes(run.wrong) }));
  const slider = find("input[type=range]"), output = find("output"), button = find("button");
  const onlyErrors = find("input[type=checkbox]"), choice = find("select"), images = [];
  let timer = 0;

  function picture(frame) {
    if (!data.frames.length) return null;
    if (!images[frame]) {
      images[frame] = new Image();
      images[frame].onload = draw;
      images[frame].src = data.frames[frame];
    }
    return images[frame].complete ? images[frame] : null;
  }

  function draw() {
    const frame = Number(slider.value), run = runs[choice ? choice.selectedIndex : 0];
    output.textContent = `frame ${data.numbers[frame]}`;
    slider.setAttribute("aria-valuetext", output.textContent);
    root.querySelectorAll("canvas").forEach((canvas, i) => paint(canvas, frame, run, i === 1));
  }

  function paint(canvas, frame, run, predicted) {
    const across = canvas.clientWidth || 1000, density = devicePixelRatio || 1;
    const zoom = Math.min(3, (across * density) / data.width);
    canvas.width = Math.round(data.width * zoom);
    canvas.height = Math.round(data.height * zoom);
    const pen = canvas.getContext("2d"), image = picture(frame);
    if (image) {
      pen.globalAlpha = 0.75; // dimmed by the dark ground, so that points are visible
      pen.drawImage(image, 0, 0, canvas.width, canvas.height);
    }
    const radius = density * Math.max(1.4, Math.min(3, across / 420));
    const at = (n, f) => 2 * (n * data.n_frames + f);
    const onCanvas = (i) => (xy[i] / data.scale + 0.5) * zoom;
    const stroke = (width, colour, alpha = 1) => {
      Object.assign(pen, { lineWidth: width, strokeStyle: colour, globalAlpha: alpha });
      pen.stroke();
    };
    (predicted ? run.shown : truth).forEach((label, n) => {
      const here = at(n, frame), wrong = run && run.wrong[n];
      if (xy[here] === MISSING || (onlyErrors.checked && !wrong)) return;
      const x = onCanvas(here), y = onCanvas(here + 1), colour = colourOf(label, data.background);
      pen.beginPath();
      for (let f = frame; f >= Math.max(0, frame - TRAIL) && xy[at(n, f)] !== MISSING; f--) {
        pen.lineTo(onCanvas(at(n, f)), onCanvas(at(n, f) + 1));
      }
      stroke(radius * 0.7, colour, 0.7);
      pen.beginPath();
      pen.arc(x, y, radius, 0, 7);
      Object.assign(pen, { fillStyle: colour, globalAlpha: 1 });
      pen.fill();
      stroke(0.7, "rgba(0,0,0,.65)");
      if (predicted && wrong) {
        pen.beginPath();
        pen.arc(x, y, radius * 1.9, 0, 7);
        stroke(radius * 0.75, "#ffffff");
        stroke(radius * 0.4, "#e3170a");
      }
    });
  }

  button.addEventListener("click", () => {
    clearInterval(timer);
    timer = timer ? 0 : setInterval(() => {
      slider.value = (Number(slider.value) + 1) % data.n_frames;
      draw();
    }, stillPlease ? 800 : 160);
    button.textContent = timer ? "Pause" : "Play";
    button.setAttribute("aria-pressed", String(Boolean(timer)));
  });
  slider.addEventListener("input", draw);
  onlyErrors.addEventListener("change", draw);
  if (choice) choice.addEventListener("change", draw);
  draw();
}

// A viewer is made when it is first near the window, so that not all clips' frames are decoded at once;
// a printed page shows them all.
const waiting = new Set(document.querySelectorAll(".viewer"));
const make = (root) => {
  if (!waiting.delete(root)) return;
  near.unobserve(root);
  view(root);
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
