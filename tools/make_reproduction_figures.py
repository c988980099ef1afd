"""Draw the figures of the methods in docs/ from results that ``mseg benchmark --json`` wrote.

mseg benchmark kt3dmoseg --seeds 10 --json kt3dmoseg.json --methods affine homography fundamental ...
python tools/make_reproduction_figures.py --results kt3dmoseg.json -o docs/figures

The virtual planar slices need none: they are made of a
synthetic scene.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from kt3dmoseg.types import Trajectories
from mseg.clustering import spectral_clustering
from mseg.evaluation import load_protocol
from mseg.kernels import sample_hypotheses, sparsify, view_kernel

mpl.use("svg")
import matplotlib.pyplot as plt

ORDER = ("affine", "homography", "fundamental", "keradd", "coreg", "subset")
PUBLISHED = {"keradd": "KerAdd", "coreg": "CoReg", "subset": "Subset"}
COLOURS = dict(zip(ORDER, ("#999999", "#777777", "#555555", "#1b6ca8", "#d97a27", "#3a8f4d"), strict=True))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--results", type=Path, required=True, help="one run of the six methods, all seeds")
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/figures"))
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    mpl.rcParams.update(
        {"svg.hashsalt": "mseg", "font.size": 9, "axes.spines.top": False, "axes.spines.right": False}
    )
    results = json.loads(arguments.results.read_text())
    drawings = {
        "seeds": seeds_figure(results),
        "per_clip": per_clip_figure(results),
        "planar_slices": planar_slices_figure(),
    }
    for name, figure in drawings.items():
        figure.savefig(arguments.output / f"{name}.svg", bbox_inches="tight", metadata={"Date": None})


def errors_of(results: dict[str, Any], method: str) -> np.ndarray:
    """Errors (clips, seeds) of a method, in per cent."""
    row = [m["method"] for m in results["methods"]].index(method)
    return 100 * np.array(results["errors"][row])


def seeds_figure(results: dict[str, Any]) -> Figure:
    """Mean error of every seed, with the printed value."""
    figure, axes = plt.subplots(figsize=(7.5, 3))
    published = load_protocol("kt3dmoseg").published
    for column, method in enumerate(ORDER):
        means = np.sort(errors_of(results, method).mean(axis=0))
        offsets = np.linspace(-0.22, 0.22, len(means))
        axes.plot(column + offsets, means, "o", color=COLOURS[method], markersize=4)
        axes.hlines(means.mean(), column - 0.3, column + 0.3, color=COLOURS[method], linewidth=1.5)
        printed = published[PUBLISHED.get(method, method)]["all"]["mean"]
        axes.plot(
            column,
            printed,
            "x",
            color="black",
            markersize=7,
            label="printed, all 22 clips" if not column else None,
        )
    axes.set_xticks(range(len(ORDER)), ORDER)
    axes.set_ylabel("mean error, %")
    axes.set_ylim(bottom=0)
    axes.legend(frameon=False)
    axes.set_title(f"{len(results['seeds'])} seeds, {results['coverage']}; bar = mean over seeds", fontsize=9)
    return figure


def per_clip_figure(results: dict[str, Any]) -> Figure:
    """Error per clip of the fusions and the best view, with the prevalence baseline."""
    clips = list(results["clips"])
    prevalence = load_protocol("kt3dmoseg").prevalence
    figure, axes = plt.subplots(figsize=(9, 3.2))
    width = 0.2
    for column, method in enumerate(("fundamental", "keradd", "coreg", "subset")):
        errors = errors_of(results, method)
        x = np.arange(len(clips)) + (column - 1.5) * width
        axes.bar(x, errors.mean(axis=1), width, color=COLOURS[method], label=method)
        axes.vlines(x, errors.min(axis=1), errors.max(axis=1), color="black", linewidth=0.6)
    for column, clip in enumerate(clips):
        if clip in prevalence:
            axes.hlines(
                prevalence[clip],
                column - 0.45,
                column + 0.45,
                color="crimson",
                label=None if column else "one motion for all",
            )
    axes.set_xticks(
        range(len(clips)), [c.replace("Seq", "").replace("_Clip", " ").replace("_clip", " ") for c in clips]
    )
    axes.tick_params(axis="x", rotation=40)
    axes.set_ylabel("error, %; line: range over seeds")
    axes.legend(frameon=False, ncols=5, loc="upper left", bbox_to_anchor=(0, 1.15))
    return figure


def planar_slices_figure() -> Figure:
    """Group the homography view of a static scene without planes: it falls into slices."""
    trajectories, depth = _thicket()
    rng = np.random.default_rng(0)
    kernel = view_kernel(trajectories, sample_hypotheses(trajectories, "homography", rng))
    labels = spectral_clustering(sparsify(kernel, 4.0), 6, rng)
    first = trajectories.xy[:, 0]
    figure, panels = plt.subplots(1, 2, figsize=(9, 2.6), width_ratios=(2, 1))
    for k in np.unique(labels)[np.argsort([np.median(depth[labels == k]) for k in np.unique(labels)])]:
        mine = labels == k
        panels[0].plot(*first[mine].T, ".", markersize=4)
        panels[1].plot(first[mine, 0], depth[mine], ".", markersize=4)
    panels[0].invert_yaxis()
    panels[0].set_aspect("equal")
    panels[0].set(xlabel="x, pixels", ylabel="y, pixels", title="one static scene, groups of the H view")
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
