"""Draw the figures of the methods in docs/, in the colours of reports, from results/ and a synthetic scene.

python tools/make_reproduction_figures.py -o docs/figures
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from kt3dmoseg.draw.display import plot_clip_values
from kt3dmoseg.draw.palette import css, label_colour
from kt3dmoseg.types import Trajectories
from mseg.benchmark.publishing import read_results
from mseg.clustering.spectral import spectral_clustering
from mseg.kernels import sample_hypotheses, sparsify, view_kernel

mpl.use("svg")
import matplotlib.pyplot as plt

RESULTS = Path(__file__).resolve().parents[1] / "results"
SHOWN = ("fundamental", "keradd", "coreg", "subset")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/figures"))
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    mpl.rcParams.update(
        {
            "svg.hashsalt": "mseg",
            "svg.fonttype": "none",
            "font.size": 9,
            "axes.spines.top": False,
            "axes.spines.right": False,
        }
    )
    for name, figure in {"per_clip": per_clip_figure(), "planar_slices": planar_slices_figure()}.items():
        figure.savefig(folder / f"{name}.svg", bbox_inches="tight", metadata={"Date": None})


def per_clip_figure() -> Figure:
    """Error per clip of the fusions and the best view, with the prevalence baseline."""
    given = [each for each in read_results(RESULTS)["kt3dmoseg", "2018"] if each.n_motions == "given"]
    errors = {each.title: each for each in given}
    first = errors[SHOWN[0]]
    figure, axes = plt.subplots(figsize=(8, 4.6))
    baseline = 100 * errors["one_motion"].errors.mean(axis=1)
    axes.plot(baseline, range(len(baseline)), "|", color="black", markersize=13, label="all in one motion")
    shown = {name: 100 * errors[name].errors for name in SHOWN}
    axis = "classification error, % (lower is better)"
    title = f"{first.heading}: mean and range over {len(first.seeds)} seeds"
    plot_clip_values(shown, list(first.clips), axis=axis, title=title, ax=axes)
    return figure


def planar_slices_figure() -> Figure:
    """Group the homography view of a static scene without planes: it falls into slices."""
    trajectories, depth = _thicket()
    rng = np.random.default_rng(0)
    kernel = view_kernel(trajectories, sample_hypotheses(trajectories, "homography", rng))
    labels = spectral_clustering(sparsify(kernel, 4.0), 6, rng)
    first = trajectories.xy[:, 0]
    figure, panels = plt.subplots(1, 2, figsize=(9, 2.6), width_ratios=(2, 1))
    near = np.unique(labels)[np.argsort([np.median(depth[labels == k]) for k in np.unique(labels)])]
    for number, k in enumerate(near, start=1):
        mine, style = labels == k, {"color": css(label_colour(number)), "markersize": 4}
        panels[0].plot(*first[mine].T, ".", **style)
        panels[1].plot(first[mine, 0], depth[mine], ".", **style)
    for panel in panels:
        panel.set_facecolor("#14181f")  # the palette is made for dark frames
    panels[0].invert_yaxis()
    panels[0].set_aspect("equal")
    panels[0].set(xlabel="x, pixels", ylabel="y, pixels", title="one static scene, grouped by homographies")
    panels[1].set(xlabel="x, pixels", ylabel="depth, m", title="the same from above", yscale="log")
    panels[1].set_yticks([8, 15, 30, 60], ["8", "15", "30", "60"])
    panels[1].minorticks_off()
    return figure


def _thicket() -> tuple[Trajectories, np.ndarray]:
    """Points scattered in depth (no planes), passed by a camera that drives forward and turns."""
    rng = np.random.default_rng(5)
    depth = np.exp(rng.uniform(np.log(7), np.log(60), size=900))
    pixels = rng.uniform((0, 0), (1240, 370), size=(900, 2))
    scene = np.concatenate([(pixels - (620, 185)) / 720 * depth[:, None], depth[:, None]], axis=1)
    xy = np.empty((900, 10, 2))
    for f in range(10):
        turn = 0.004 * f
        rotation = np.array([[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]])
        moved = (scene - (0.05 * f, 0, 0.35 * f)) @ rotation
        xy[:, f] = 720 * moved[:, :2] / moved[:, 2:] + (620, 185)
    xy += rng.normal(scale=0.1, size=xy.shape)
    inside = ((xy > 0) & (xy < (1240, 370))).all(axis=(1, 2))
    return Trajectories(xy[inside], np.ones((int(inside.sum()), 10), dtype=bool)), depth[inside]


if __name__ == "__main__":
    main()
