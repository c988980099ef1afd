"""What a published dataset says about itself: the card for people, Croissant for programs."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kt3dmoseg.files import sha256_file
from kt3dmoseg.types import Clip

if TYPE_CHECKING:
    from kt3dmoseg.publishing import PublishOptions

_TAGS = ["motion segmentation", "point trajectories", "rigid motion", "video"]
_SIZES = ((1000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))
_PROTOCOL = (
    "Labels are of trajectories: by regions outlined by hand on key frames or by masks, turned into labels "
    "by a documented rule, or by exact geometry for synthetic drives. The label marked as background is the "
    "static scene, other numbers are moving objects, 0 is unlabelled, rejected or in conflict."
)
_WITH_LABELS = " with labels of independent rigid motions"
_UNLABELLED = "No trajectory is labelled: every label is 0."
_TRACKED = (
    "Points are tracked from frame to frame; trajectories shorter than the tracker's least length are "
    "dropped."
)
_GIVEN = (
    "Points are those of another tracker; those outside of the image, and trajectories that are then shorter "
    "than the least length, are dropped."
)
_TYPES = {"clip": "sc:Text", "motion": "sc:Text", "x": "sc:Float", "y": "sc:Float"}
_TYPES |= {"evaluated": "sc:Boolean", "background": "sc:Boolean"}
FIELDS = {
    "trajectories": {
        "clip": "name of the clip",
        "track": "identity of the trajectory in its clip",
        "first_frame": "index of the first frame in which it is visible, from 0; -1 for none",
        "last_frame": "index of the last one",
        "length": "number of frames in which it is visible",
        "evaluated": "whether it is scored",
        "label": "its motion; 0 = unlabelled, outlier or not evaluated",
        "motion": "name of the motion",
        "background": "whether its motion is the static scene",
    },
    "points": {
        "clip": "name of the clip",
        "track": "identity of the trajectory in its clip",
        "frame": "index of the frame in the clip, from 0",
        "frame_number": "number of the frame in its source",
        "x": "pixels to the right from the centre of the top-left pixel",
        "y": "pixels down from the centre of the top-left pixel",
    },
}
_CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "sc": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "dct": "http://purl.org/dc/terms/",
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
}
_TERMS = (
    "citeAs column equivalentProperty extract field fileProperty fileObject fileSet format includes "
    "isLiveDataset jsonPath key md5 parentField path recordSet references regex repeated replace "
    "samplingRate separator source subField transform"
)


def table(clips: Iterable[Clip]) -> str:
    """Markdown, one line per clip and a line of totals."""
    lines = [
        "| clip | frames | trajectories | mean length | evaluated | motions | largest share |",
        "|---|--:|--:|--:|--:|--:|--:|",
    ]
    sums = np.zeros(4, dtype=np.int64)
    for clip in clips:
        counts = np.unique(clip.labels.label[clip.labels.label > 0], return_counts=True)[1]
        share = f"{100 * counts.max() / counts.sum():.1f} %" if counts.size else "-"
        length = f"{clip.dense.lengths.mean():.1f}" if len(clip.dense) else "-"
        row = clip.name, clip.n_frames, len(clip.dense), length, len(clip.evaluated), clip.n_motions, share
        lines.append(f"| {' | '.join(map(str, row))} |")
        sums += (1, clip.n_frames, len(clip.dense), len(clip.evaluated))
    lines.append("| **{} clips** | {} | {} | | {} | | |".format(*sums.tolist()))
    return "\n".join(lines) + "\n"


def _labelled(facts: Mapping[str, Any]) -> bool:
    return any(clip["motions"] for clip in facts["clips"].values())


def _protocol(facts: Mapping[str, Any]) -> str:
    return _PROTOCOL if _labelled(facts) else _UNLABELLED


def _preprocessing(facts: Mapping[str, Any]) -> str:
    """Say which trajectories there are, and which are evaluated, as the clips record it."""
    options, points = facts["built"]["options"], _GIVEN if facts["built"]["flow"] == "" else _TRACKED
    if not _labelled(facts):
        return f"{points} All are evaluated."
    smallest = options.get("smallest", 1) if isinstance(options, Mapping) else 1  # else no build made them
    moving = "moving trajectories" + f" of objects with at least {smallest} of them" * (smallest != 1)
    return f"{points} All labelled {moving} are evaluated, and a random part of the background."


def card(facts: Mapping[str, Any], counted: str, settings: PublishOptions) -> str:
    """Return README.md: YAML front matter (JSON is YAML) and what a reader asks first."""
    count = sum(clip["trajectories"] for clip in facts["clips"].values())
    configs: list[dict[str, Any]] = []
    for what in FIELDS:
        files = [{"split": split, "path": f"data/{what}/{split}.parquet"} for split in facts["splits"]]
        configs.append({"config_name": what, "data_files": files} | ({} if configs else {"default": True}))
    head = {
        "license": facts["license"],
        "pretty_name": facts["name"],
        "version": facts["version"],
        "tags": _TAGS,
        "size_categories": [next((name for most, name in _SIZES if count < most), "n>1M")],
        "configs": configs,
    }
    yaml = "\n".join(f"{key}: {json.dumps(value, ensure_ascii=False)}" for key, value in head.items())
    splits = "; ".join(f"{split}: {len(names)} clips" for split, names in facts["splits"].items())
    columns = "\n".join(
        f"- `{what}`: " + ", ".join(f"`{name}` ({text})" for name, text in fields.items())
        for what, fields in FIELDS.items()
    )
    labels = _WITH_LABELS * _labelled(facts)
    sources = "\n".join(f"- {name}: {clip['source']}" for name, clip in facts["clips"].items())
    return f"""---
{yaml}
---

# {facts["name"]}, version {facts["version"]}

{settings.description or f"Point trajectories of clips{labels and ','}{labels}."}

```python
from datasets import load_dataset
trajectories = load_dataset("PATH", "trajectories")   # one row per trajectory
points = load_dataset("PATH", "points")               # one row per trajectory and frame

import kt3dmoseg
clips = kt3dmoseg.load_dataset("PATH/clips")          # everything, by clip
```

Splits: {splits}. `dataset.json` has the checksums of clips and of their contents; a version never changes,
and `kt3dmoseg diff OLD NEW` compares two. Scores on different versions are not comparable.

## Columns

{columns}

## Clips

{counted}
## Provenance

{settings.collection} Made by {facts["toolkit"]}; every clip's file holds the checksums of its sources, every
option and the versions. {_preprocessing(facts)}

{sources}

## Labels

{_protocol(facts)}

## Limits, use, licence

{settings.limitations} {settings.sensitive} {settings.uses}

Licence: {facts["license"]}. {f"To cite: {settings.citation}" if settings.citation else ""}
"""


def croissant(
    facts: Mapping[str, Any], files: Mapping[str, Path], settings: PublishOptions
) -> dict[str, Any]:
    """Return Croissant 1.0 with the responsible-AI vocabulary 1.0 (http://mlcommons.org/croissant/RAI/1.0)."""
    dated = ("citeAs", settings.citation), ("datePublished", settings.date)
    form = {".parquet": "application/x-parquet", ".h5": "application/x-hdf5"}
    rai = {
        "dataCollection": settings.collection,
        "dataPreprocessingProtocol": _preprocessing(facts),
        "dataAnnotationProtocol": _protocol(facts),
        "dataLimitations": settings.limitations,
        "dataBiases": settings.limitations,
        "personalSensitiveInformation": settings.sensitive,
        "dataUseCases": settings.uses,
        "dataReleaseMaintenancePlan": "A version never changes; corrections are a new version.",
    }
    return {
        "@context": _CONTEXT | {term: f"cr:{term}" for term in _TERMS.split()},
        "@type": "sc:Dataset",
        "conformsTo": ["http://mlcommons.org/croissant/1.0", "http://mlcommons.org/croissant/RAI/1.0"],
        "name": facts["name"],
        "description": settings.description or f"Point trajectories{_WITH_LABELS * _labelled(facts)}.",
        "version": facts["version"],
        "license": f"https://spdx.org/licenses/{facts['license']}",
        "keywords": _TAGS,
        **{key: text for key, text in dated if text},
        **{f"rai:{key}": text for key, text in rai.items()},
        "distribution": [
            _node("FileObject", path, contentUrl=path, contentSize=f"{file.stat().st_size} B")
            | {"encodingFormat": form[file.suffix], "sha256": sha256_file(file)}
            for path, file in files.items()
        ],
        "recordSet": [
            _record_set(what, split, fields) for what, fields in FIELDS.items() for split in facts["splits"]
        ],
    }


def _record_set(what: str, split: str, fields: Mapping[str, str]) -> dict[str, Any]:
    found = []
    for field, text in fields.items():
        source = {"fileObject": {"@id": f"data/{what}/{split}.parquet"}, "extract": {"column": field}}
        about = {"description": text, "dataType": _TYPES.get(field, "sc:Integer"), "source": source}
        found.append(_node("Field", f"{what}_{split}/{field}", **about))
    return _node("RecordSet", f"{what}_{split}", field=found)


def _node(kind: str, name: str, **values: Any) -> dict[str, Any]:  # noqa: ANN401  # JSON
    return {"@type": f"cr:{kind}", "@id": name, "name": name, **values}
