"""Describe a built dataset: a Markdown table per clip, and croissant.json for dataset search engines.

    tools/make_data_card.py out/ --croissant docs/croissant.json --table table.md

Reads the clip files that `kt3dmoseg build` wrote; the croissant file names each with its sha256 and size
(Croissant 1.0, http://mlcommons.org/croissant/1.0).
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

import kt3dmoseg
from kt3dmoseg.files import sha256_file, write_text
from kt3dmoseg.io import dataset_paths
from kt3dmoseg.types import Clip

LICENCE = "https://creativecommons.org/licenses/by-nc-sa/3.0/"
ABOUT = (
    "Dense point trajectories and motion labels of 22 clips of 10 to 20 frames from KITTI raw, filmed "
    "from a moving car: strong perspective, forward translation, 1 to 6 moving objects. Version 2: "
    "trajectories and labels rebuilt from the frames with open tools; the data card states how it differs "
    "from the 2018 release."
)
CITATION = (
    "Xu, X., Cheong, L.-F., Li, Z.: Motion Segmentation by Exploiting Complementary Geometric Models. "
    "CVPR 2018. Geiger, A., Lenz, P., Stiller, C., Urtasun, R.: Vision meets Robotics: The KITTI "
    "Dataset. IJRR 2013."
)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dataset", type=Path, help="folder of built clips")
    parser.add_argument("--croissant", type=Path, required=True, help="JSON-LD file to write")
    parser.add_argument("--table", type=Path, required=True, help="Markdown file to write")
    given = parser.parse_args()
    paths = dataset_paths(given.dataset)
    clips = {name: kt3dmoseg.load(path) for name, path in paths.items()}
    write_text(given.table, table(clips))
    write_text(given.croissant, json.dumps(croissant(paths), indent=2, ensure_ascii=False) + "\n")
    print(f"{len(clips)} clips: {given.table}, {given.croissant}")


def table(clips: dict[str, Clip]) -> str:
    """Markdown, one line per clip and a line of totals."""
    lines = ["| clip | frames | trajectories | mean length | evaluated | motions | largest share |",
             "|---|--:|--:|--:|--:|--:|--:|"]  # fmt: skip
    sums = np.zeros(3, dtype=np.int64)
    for name, clip in clips.items():
        counts = np.unique(clip.labels.label[clip.labels.label > 0], return_counts=True)[1]
        share = f"{100 * counts.max() / counts.sum():.1f} %" if counts.size else "-"
        lines.append(
            f"| {name} | {clip.n_frames} | {len(clip.dense)} | {clip.dense.lengths.mean():.1f} "
            f"| {len(clip.evaluated)} | {clip.n_motions} | {share} |"
        )
        sums += (clip.n_frames, len(clip.dense), len(clip.evaluated))
    lines.append(f"| **{len(clips)} clips** | {sums[0]} | {sums[1]} | | {sums[2]} | | |")
    return "\n".join(lines) + "\n"


def croissant(paths: dict[str, Path]) -> dict[str, Any]:
    """Croissant 1.0 metadata: one FileObject per clip."""
    return {
        "@context": {
            "@vocab": "https://schema.org/",
            "sc": "https://schema.org/",
            "cr": "http://mlcommons.org/croissant/",
            "dct": "http://purl.org/dc/terms/",
            "conformsTo": "dct:conformsTo",
            "citeAs": "cr:citeAs",
        },
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": "KT3DMoSeg",
        "description": ABOUT,
        "version": "2.0.0",
        "license": LICENCE,
        "citeAs": CITATION,
        "keywords": ["motion segmentation", "point trajectories", "KITTI", "autonomous driving"],
        "distribution": [
            {
                "@type": "cr:FileObject",
                "@id": path.name,
                "name": name,
                "contentUrl": path.name,
                "contentSize": f"{path.stat().st_size} B",
                "encodingFormat": "application/x-hdf5",
                "sha256": sha256_file(path),
            }
            for name, path in paths.items()
        ],
    }


if __name__ == "__main__":
    main()
