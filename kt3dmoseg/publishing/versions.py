"""Publishing: a folder of clips becomes a named version that others load in one line; versions compared.

OUT/clips/<clip>.h5                     the files
OUT/data/trajectories/<split>.parquet   one row per trajectory
OUT/data/points/<split>.parquet         one row per trajectory and frame
OUT/dataset.json                        name, version, splits, checksums
OUT/croissant.json                      Croissant 1.0 with its responsible-AI fields
OUT/README.md                           the card: YAML front matter that `datasets.load_dataset` reads
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping, Sequence
from datetime import date
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from kt3dmoseg import __version__, catalog
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError, optional
from kt3dmoseg.files import (
    JSON_BYTES,
    PathLike,
    atomic_path,
    hold_folder,
    is_hidden,
    parse_json,
    read_bytes,
    sha256_arrays,
    sha256_file,
    write_text,
)
from kt3dmoseg.frames import recorded_inputs, recorded_source
from kt3dmoseg.io import dataset_paths, load
from kt3dmoseg.options import from_mapping
from kt3dmoseg.publishing import PublishOptions
from kt3dmoseg.publishing.card import FIELDS, card, croissant, table
from kt3dmoseg.text import several
from kt3dmoseg.types import Clip

MANIFEST = "dataset.json"
_KITTI, _OWN = "cc-by-nc-sa-3.0", "mit"
_FORMS = {
    "name": (r"[\w. -]{1,100}", "a name of letters, digits, . _ -"),
    "version": (r"[0-9]+(\.[0-9]+){1,3}([-.+]?[A-Za-z0-9]+)?", "a version, as 1.0.0"),
}
_MIXED = ("options", "flow", "algorithms")  # of what clips are built with, in their provenance


def publish(
    dataset: PathLike,
    output: PathLike,
    *,
    splits: Sequence[str] = (),
    **options: Any,  # noqa: ANN401
) -> dict[str, Any]:
    """Publish a folder of clips as a version of a dataset.

    Parameters
    ----------
    dataset : path
        Folder of clips, as `kt3dmoseg.pipeline.build_dataset` writes it.
    output : path
        New or empty, or of an interrupted run of the same version.
    splits : sequence of str
        ``NAME=PATTERN`` with a pattern of clips' names, as ``test=*_test*``; the first that fits counts.
        Other clips are of the split ``train``.
    **options
        Fields of `PublishOptions`; name and version are needed.

    Returns
    -------
    dict
        What ``dataset.json`` holds.

    Raises
    ------
    InputFileError, FileFormatError
        When clips cannot be read or another version is in `output`.
    InvalidValueError
        When name, version, licence or a split makes no sense, or the clips were built in different ways.
    MissingDependencyError
        Without pyarrow, the extra ``publish``.
    """
    settings = from_mapping(PublishOptions, options, where="publish")
    for what, (form, expected) in _FORMS.items():
        if not re.fullmatch(form, text := getattr(settings, what)):
            raise InvalidValueError(what, expected=expected, found=repr(text))
    try:
        proper = not settings.date or f"{date.fromisoformat(settings.date)}" == settings.date
    except ValueError:
        proper = False
    if not proper:
        raise InvalidValueError("date", expected="YYYY-MM-DD", found=repr(settings.date))
    paths = dataset_paths(dataset)
    parts = _splits(list(paths), splits)
    facts = _manifest(paths, parts, settings)
    optional("pyarrow", "publish needs", "publish")
    with hold_folder(output) as folder:
        copies = {f"clips/{name}.h5": path for name, path in paths.items()}
        tables = {f"data/{what}/{split}.parquet": (what, parts[split]) for what in FIELDS for split in parts}
        _check_same_version(folder, facts, {*copies, *tables})
        for file, path in copies.items():
            with atomic_path(folder / file) as temporary:
                shutil.copyfile(path, temporary)
        for file, (what, names) in tables.items():
            _write_table(folder / file, what, [paths[name] for name in names])
        files = {file: folder / file for file in (*tables, *copies)}
        text = json.dumps(croissant(facts, files, settings), indent=1, ensure_ascii=False)
        write_text(folder / "croissant.json", text + "\n")
        write_text(folder / "README.md", card(facts, table(map(load, paths.values())), settings))
        write_text(folder / MANIFEST, json.dumps(facts, indent=1, sort_keys=True, ensure_ascii=False) + "\n")
    return facts


def _splits(names: Sequence[str], rules: Sequence[str]) -> dict[str, list[str]]:
    pairs = [rule.partition("=")[::2] for rule in rules]
    for rule, (split, pattern) in zip(rules, pairs, strict=True):
        if not re.fullmatch(r"\w{1,40}", split) or not any(fnmatch(name, pattern) for name in names):
            found = f"{rule!r}, which fits none of {len(names)}" if pattern else repr(rule)
            raise InvalidValueError("split", expected="NAME=PATTERN of clips", found=found)
    out: dict[str, list[str]] = {}
    for name in names:
        split = next((split for split, pattern in pairs if fnmatch(name, pattern)), "train")
        out.setdefault(split, []).append(name)
    for rule, (split, _) in zip(rules, pairs, strict=True):
        if split not in out:
            found = f"{rule!r}, whose clips are all of a split named before"
            fix = "name it first: the first that fits counts"
            raise InvalidValueError("split", expected=f"a clip in {split}", found=found, fix=fix)
    return out


def _manifest(
    paths: Mapping[str, Path], parts: Mapping[str, Sequence[str]], settings: PublishOptions
) -> dict[str, Any]:
    """Collect what identifies the version; InvalidValueError when clips do not belong together."""
    clips: dict[str, Any] = {}
    built: dict[str, Any] = {}
    kitti, synthetic, known = False, True, catalog.load()
    for name, path in paths.items():
        clip = load(path)
        if clip.name != name or path.suffix != ".h5":  # its tables would have another name
            raise FileFormatError(f"{path}", expected=f"{clip.name}.h5, as it is built", found=path.name)
        inputs = recorded_inputs(clip.provenance)
        source = recorded_source(clip.provenance)
        kitti |= source.get("kind") == "kitti" or name in known
        synthetic &= source.get("kind") == "synthetic"
        way = {key: inputs.get(key) for key in _MIXED}
        first = next(iter(built), name)
        if built.setdefault(first, way) != way:
            found = ", ".join(key for key in _MIXED if way[key] != built[first][key])
            fix = "build all clips by one command"
            expected = f"clips built as {first}"
            raise InvalidValueError(f"{name}: provenance", expected=expected, found=f"other {found}", fix=fix)
        content = sha256_arrays(clip.dense.xy, clip.dense.track_id, clip.evaluated, clip.labels.label)
        clips[name] = {"sha256": sha256_file(path), "content_sha256": content, "frames": clip.n_frames}
        clips[name] |= {"trajectories": len(clip.dense), "evaluated": len(clip.evaluated)}
        clips[name] |= {"motions": clip.n_motions, "source": _source(source, clip)}
    licence = settings.license.lower() or (_KITTI if kitti else _OWN if synthetic else "")
    if not licence or (kitti and licence != _KITTI):
        expected = _KITTI if kitti else "an SPDX identifier, as cc-by-4.0"
        fix = "what is derived from KITTI carries KITTI's licence" if kitti else "give license=ID"
        raise InvalidValueError("license", expected=expected, found=repr(settings.license), fix=fix)
    version = {"name": settings.name, "version": settings.version, "license": licence}
    made = {"toolkit": f"kt3dmoseg {__version__}", "built": next(iter(built.values()))}
    return {**version, "format": "kt3dmoseg-dataset", "splits": dict(parts), "clips": clips, **made}


def _source(source: Mapping[str, Any], clip: Clip) -> str:
    numbers = f"frames {clip.frame_numbers[0]}-{clip.frame_numbers[-1]}" if clip.n_frames else "no frames"
    where = source.get("drive") or source.get("file") or source.get("kind") or clip.provenance.get("format")
    return f"{where or 'unknown'}, {numbers}"


def _check_same_version(folder: Path, facts: Mapping[str, Any], files: set[str]) -> None:
    """Refuse to write over or next to anything but the very same version."""
    old = read_manifest(folder) if (folder / MANIFEST).exists() else facts
    for key in ("name", "version", "license", "splits", "clips"):
        if old.get(key) != facts[key]:
            expected = f"{facts['name']} {facts['version']} with the same clips, or a new folder"
            fix = "a published version never changes: give the next version, and another folder"
            found = f"{old.get('name')} {old.get('version')} with other {key}"
            raise InputFileError(f"{folder}", expected=expected, found=found, fix=fix)
    there = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    others = there - files - {MANIFEST, "README.md", "croissant.json"}
    if others := {path for path in others if not is_hidden(path)}:
        raise InputFileError(f"{folder}", expected="a new folder", found=several(sorted(others)))


def read_manifest(folder: Path) -> dict[str, Any]:
    """Read a published version's ``dataset.json``; FileFormatError when it is none."""
    path = folder / MANIFEST
    found = parse_json(read_bytes(path, JSON_BYTES), f"{path}")
    if not isinstance(found, dict) or found.get("format") != "kt3dmoseg-dataset":
        raise FileFormatError(f"{path}", expected="the manifest of a published dataset", found="other JSON")
    return found


def _write_table(file: Path, what: str, clips: Sequence[Path]) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = trajectory_rows if what == "trajectories" else point_rows
    schema = pa.Schema.from_pandas(rows(load(clips[0])), preserve_index=False).remove_metadata()
    for k, field in enumerate(schema):  # of a clip without trajectories texts have no type
        if field.name in ("clip", "motion"):
            schema = schema.set(k, pa.field(field.name, pa.string()))
    with atomic_path(file) as temporary, pq.ParquetWriter(temporary, schema, compression="zstd") as writer:
        for path in clips:
            table = pa.Table.from_pandas(rows(load(path)), schema=schema, preserve_index=False)
            writer.write_table(table)


def trajectory_rows(clip: Clip) -> pd.DataFrame:
    """Give one row per trajectory; `label` is 0 and `motion` empty where it is not evaluated."""
    visible, count = clip.dense.visible, len(clip.dense)
    label, evaluated = np.zeros(count, dtype=np.int64), np.isin(np.arange(count), clip.evaluated)
    label[clip.evaluated] = clip.labels.label
    names = [clip.labels.names.get(value, "") if value else "" for value in label.tolist()]
    seen = visible.any(axis=1)
    first = np.where(seen, visible.argmax(axis=1), -1)
    last = np.where(seen, visible.shape[1] - 1 - visible[:, ::-1].argmax(axis=1), -1)
    columns = {"clip": np.full(count, clip.name, dtype=object), "track": clip.dense.track_id}
    columns |= {"first_frame": first, "last_frame": last, "length": clip.dense.lengths}
    columns |= {"evaluated": evaluated, "label": label, "motion": np.array(names, dtype=object)}
    return pd.DataFrame(columns | {"background": label == (clip.labels.background or -1)})


def point_rows(clip: Clip) -> pd.DataFrame:
    """Give one row per trajectory and frame in which it is visible."""
    found = clip.dense.to_dataframe()
    found.insert(0, "clip", clip.name)
    found.insert(3, "frame_number", clip.frame_numbers[found["frame"]])
    return found.astype({"clip": object})


def diff(old: PathLike, new: PathLike) -> pd.DataFrame:
    """Compare two versions of a dataset: one row per clip that differs.

    Trajectories are the same when all their positions are, whatever their ids.

    Parameters
    ----------
    old, new : path
        Folders of clips, or of published versions.

    Returns
    -------
    pandas.DataFrame
        `clip`, `change` (added, removed, changed), numbers of trajectories `added`, `removed` and the `same`,
        `labels` that changed among those evaluated in both, `evaluated` in one version only, and `built`: in
        what the builds differ, and whether the labels have another `background` or other `names`.

    Raises
    ------
    InputFileError, FileFormatError
        When a folder or clip cannot be read.
    """
    before, after = (_clips_of(Path(path)) for path in (old, new))
    rows = []
    for name in sorted({*before, *after}):
        if name not in before or name not in after:
            clip = load((before | after)[name])
            added = len(clip.dense) * (name in after)
            change = "added" if name in after else "removed"
            rows.append((name, change, added, len(clip.dense) - added, 0, 0, 0, ""))
        elif sha256_file(before[name]) != sha256_file(after[name]):
            rows.append((name, "changed", *_changes(load(before[name]), load(after[name]))))
    columns = ["clip", "change", "added", "removed", "same", "labels", "evaluated", "built"]
    return pd.DataFrame(rows, columns=columns)


def _clips_of(folder: Path) -> dict[str, Path]:
    if not (folder / MANIFEST).is_file():
        return dataset_paths(folder)
    paths, manifest = dataset_paths(folder / "clips"), read_manifest(folder)
    for name in sorted({*manifest["clips"], *paths}):
        wanted = manifest["clips"].get(name, {}).get("sha256")
        found = sha256_file(paths[name]) if name in paths else None
        if found != wanted:
            version = f"{manifest['name']} {manifest['version']}"
            expected = f"the clip of {version}" if wanted else f"only clips of {version}"
            found = "another file" if found else "none"
            raise FileFormatError(f"{folder}/clips/{name}.h5", expected=expected, found=found)
    return paths


def _changes(a: Clip, b: Clip) -> tuple[int, int, int, int, int, str]:
    first, second = _labels(a), _labels(b)
    common = pd.concat([first, second], axis=1, join="inner")
    known = (common >= 0).sum(axis=1)
    changed = int((common[known == 2].nunique(axis=1) == 2).sum())
    inputs = [recorded_inputs(clip.provenance) for clip in (a, b)]
    built = sorted(key for key in {*inputs[0], *inputs[1]} if inputs[0].get(key) != inputs[1].get(key))
    built += [what for what in ("background", "names") if getattr(a.labels, what) != getattr(b.labels, what)]
    added, removed, once = len(second) - len(common), len(first) - len(common), int((known == 1).sum())
    return added, removed, len(common), changed, once, ", ".join(built)


def _labels(clip: Clip) -> pd.Series[int]:
    """Labels by the positions of the trajectories, equal ones numbered; -1 where not evaluated."""
    label = np.full(len(clip.dense), -1)
    label[clip.evaluated] = clip.labels.label
    content = pd.Series([xy.tobytes() for xy in np.nan_to_num(clip.dense.xy, nan=-1e9)], dtype=object)
    return pd.Series(label, [content, content.groupby(content).cumcount()])
