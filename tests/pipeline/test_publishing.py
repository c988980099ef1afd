"""Clips published as a version of a dataset, loaded as others would, and compared with another version."""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from build_scenes import write_clip, write_masks

from kt3dmoseg import load, load_dataset
from kt3dmoseg.cli import main
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError, MissingDependencyError
from kt3dmoseg.io import save
from kt3dmoseg.pipeline import build_dataset
from kt3dmoseg.publishing import diff, publish
from kt3dmoseg.types import Labels

ABOUT = {"name": "Two scenes", "version": "1.0.0", "license": "cc-by-4.0"}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    root = tmp_path_factory.mktemp("built")
    for seed, name in enumerate(("a", "b_test")):
        write_clip(root / "frames" / name, seed)
        write_masks(root / "masks" / name)
    options = {"masks": root / "masks", "flow": "dis_medium", "workers": 1}
    build_dataset(root / "frames", root / "out", **options)
    return root / "out"


@pytest.fixture(scope="module")
def published(built, tmp_path_factory):
    pytest.importorskip("pyarrow")
    folder = tmp_path_factory.mktemp("published") / "v1"
    publish(built, folder, splits=["test=*_test"], **ABOUT)
    return folder


def test_tables_hold_what_the_clips_hold(built, published):
    clips = load_dataset(built)
    for split, name in (("train", "a"), ("test", "b_test")):
        clip, points = clips[name], pd.read_parquet(published / f"data/points/{split}.parquet")
        expected = clip.dense.to_dataframe()
        np.testing.assert_array_equal(points[["track", "frame", "x", "y"]].to_numpy(), expected.to_numpy())
        np.testing.assert_array_equal(points["frame_number"], clip.frame_numbers[expected["frame"]])
        tracks = pd.read_parquet(published / f"data/trajectories/{split}.parquet").set_index("track")
        assert set(tracks["clip"]) == {name}
        chosen = tracks.loc[clip.dense.track_id[clip.evaluated]]
        np.testing.assert_array_equal(chosen["label"], clip.labels.label)
        assert tracks["evaluated"].sum() == len(clip.evaluated)
        assert set(chosen["motion"]) == {"background", "object 1"}
        assert (chosen["background"] == (chosen["label"] == 1)).all()
        np.testing.assert_array_equal(tracks["length"], clip.dense.lengths)


def test_metadata_name_every_file_with_its_checksum_and_every_column(published):
    meta = json.loads((published / "croissant.json").read_text())
    files = {each["@id"]: each for each in meta["distribution"]}
    assert len(files) == 6
    for path, each in files.items():
        content = (published / path).read_bytes()
        assert each["sha256"] == hashlib.sha256(content).hexdigest()
        assert each["contentSize"] == f"{len(content)} B"
    for records in meta["recordSet"]:
        sources = {field["source"]["fileObject"]["@id"] for field in records["field"]}
        columns = [field["source"]["extract"]["column"] for field in records["field"]]
        assert list(pd.read_parquet(published / sources.pop()).columns) == columns
    assert {key for key in meta if key.startswith("rai:")} >= {"rai:dataCollection", "rai:dataLimitations"}


def test_the_card_states_licence_provenance_and_files_for_loaders(published):
    _, head, text = (published / "README.md").read_text().split("---\n", 2)
    values = {key: json.loads(value) for key, value in (line.split(": ", 1) for line in head.splitlines())}
    assert (values["license"], values["version"]) == ("cc-by-4.0", "1.0.0")
    for config in values["configs"]:
        assert [part["split"] for part in config["data_files"]] == ["train", "test"]
        assert all((published / part["path"]).is_file() for part in config["data_files"])
    assert "frames 1-6" in text
    assert "a documented rule" in text


def test_the_card_says_how_trajectories_labels_and_the_evaluated_came_about(built, tmp_path):
    pytest.importorskip("pyarrow")
    frames, masks = built.parent / "frames", built.parent / "masks"
    build_dataset(frames, tmp_path / "theirs", tracks=built, workers=1)
    build_dataset(frames, tmp_path / "large", masks=masks, smallest=3, flow="dis_medium", workers=1)
    for clips, *expected in (
        (built, "tracked from frame to frame", "moving trajectories are evaluated", "outlined by hand"),
        (tmp_path / "theirs", "those of another tracker", "dropped. All are", "No trajectory is labelled"),
        (tmp_path / "large", "frame to frame", "objects with at least 3 of them", "outlined by hand"),
    ):
        publish(clips, tmp_path / f"v{clips.name}", **ABOUT)
        card = (tmp_path / f"v{clips.name}" / "README.md").read_text()
        meta = json.loads((tmp_path / f"v{clips.name}" / "croissant.json").read_text())
        *points, labels = expected
        assert all(text in card for text in expected)
        assert all(text in meta["rai:dataPreprocessingProtocol"] for text in points)
        assert labels in meta["rai:dataAnnotationProtocol"]
        assert all(("with labels" in text) == ("hand" in labels) for text in (card, meta["description"]))


def test_datasets_loads_it_offline(published, tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    datasets = pytest.importorskip("datasets")
    found = datasets.load_dataset(str(published), "points", cache_dir=str(tmp_path))
    assert {name: set(part["clip"]) for name, part in found.items()} == {"train": {"a"}, "test": {"b_test"}}


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of what it uses
def test_mlcroissant_accepts_it(published):
    croissant = pytest.importorskip("mlcroissant")
    found = croissant.Dataset(jsonld=str(published / "croissant.json"))
    row = next(iter(found.records("trajectories_test")))
    assert row["trajectories_test/clip"] == b"b_test"


def test_a_version_never_changes(built, published, tmp_path):
    before = {path: path.read_bytes() for path in published.rglob("*") if path.is_file()}
    publish(built, published, splits=["test=*_test"], **ABOUT)  # as after an interruption
    assert {path: path.read_bytes() for path in published.rglob("*") if path.is_file()} == before
    for changes in ({"version": "1.0.1"}, {"splits": []}):
        with pytest.raises(InputFileError, match="a published version never changes: give the next version"):
            publish(built, published, **{"splits": ["test=*_test"]} | ABOUT | changes)
    with pytest.raises(InputFileError, match=r"found Two scenes 1\.0\.0 with other license"):
        publish(built, published, splits=["test=*_test"], **ABOUT | {"license": "cc0-1.0"})
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputFileError, match=r"expected a new folder, found notes\.txt"):
        publish(built, tmp_path, **ABOUT)


def test_files_of_another_version_that_was_interrupted_are_not_mixed_in(built, published, tmp_path):
    (tmp_path / "v").mkdir()
    shutil.copytree(published / "clips", tmp_path / "v" / "clips")
    shutil.copy(built / "a.h5", tmp_path / "v" / "clips" / "other.h5")
    with pytest.raises(InputFileError, match=r"expected a new folder, found clips/other\.h5"):
        publish(built, tmp_path / "v", splits=["test=*_test"], **ABOUT)
    shutil.copy(published / "dataset.json", tmp_path / "v")
    with pytest.raises(FileFormatError, match=r"other\.h5: expected only clips of Two scenes 1\.0\.0"):
        diff(tmp_path / "v", built)


def test_a_clip_is_published_under_its_own_name_only(built, tmp_path):
    (tmp_path / "in").mkdir()
    shutil.copy(built / "a.h5", tmp_path / "in" / "renamed.h5")
    with pytest.raises(FileFormatError, match=r"renamed\.h5: expected a\.h5, as it is built"):
        publish(tmp_path / "in", tmp_path / "v", **ABOUT)


def test_a_missing_package_is_named_before_anything_is_written(built, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(MissingDependencyError, match=r"needs pyarrow; pip install 'kt3dmoseg\[publish\]'"):
        publish(built, tmp_path / "v", **ABOUT)
    assert not (tmp_path / "v").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": ""}, "name: expected a name"),
        ({"version": "two"}, "version: expected a version, as 1.0.0, found 'two'"),
        ({"date": "yesterday"}, "date: expected YYYY-MM-DD, found 'yesterday'"),
        ({"date": "2026-02-30"}, "date: expected YYYY-MM-DD"),
        ({"date": "20260130"}, "date: expected YYYY-MM-DD"),
        ({"license": ""}, "license: expected an SPDX identifier.*license=ID"),
        (
            {"splits": ["test=z*"]},
            "split: expected NAME=PATTERN of clips, found 'test=z\\*', which fits none",
        ),
        (
            {"splits": ["test=*_test", "val=*_test"]},
            "split: expected a clip in val, found 'val=.*', whose clips are all of a split named before",
        ),
    ],
)
def test_what_a_version_needs_is_asked_for(built, tmp_path, changes, message):
    with pytest.raises(InvalidValueError, match=message):
        publish(built, tmp_path / "v", **ABOUT | changes)


def test_clips_and_tracks_without_anything_to_see_are_published(built, tmp_path):
    shutil.copytree(built, tmp_path / "clips")
    first = load(built / "a.h5")
    none = replace(
        first,
        dense=first.dense.select(np.zeros(0, dtype=int)),
        evaluated=np.zeros(0, dtype=int),
        labels=Labels([]),
    )
    save(none, tmp_path / "clips" / "a.h5")
    second = load(built / "b_test.h5")
    xy, seen = np.array(second.dense.xy), np.array(second.dense.visible)
    xy[0], seen[0] = np.nan, False
    dense = replace(second.dense, xy=xy, visible=seen)
    save(replace(second, dense=dense), tmp_path / "clips" / "b_test.h5")
    publish(tmp_path / "clips", tmp_path / "v", **ABOUT)
    tracks = pd.read_parquet(tmp_path / "v/data/trajectories/train.parquet")
    assert set(tracks["clip"]) == {"b_test"}
    assert tracks.loc[0, ["first_frame", "last_frame", "length"]].tolist() == [-1, -1, 0]


def test_kitti_keeps_its_licence_and_builds_are_not_mixed(built, tmp_path):
    clip = load(built / "a.h5")
    save(replace(clip, name="Seq005_Clip01"), tmp_path / "kitti" / "Seq005_Clip01.h5")
    with pytest.raises(
        InvalidValueError, match=r"license: expected cc-by-nc-sa-3.0, found 'cc-by-4.0'; .*KITTI"
    ):
        publish(tmp_path / "kitti", tmp_path / "v", **ABOUT)
    tracked = replace(clip, name="t", provenance={"source": {"kind": "kitti"}})  # by `track`, not built
    save(tracked, tmp_path / "tracked" / "t.h5")
    with pytest.raises(InvalidValueError, match=r"license: expected cc-by-nc-sa-3\.0"):
        publish(tmp_path / "tracked", tmp_path / "v", **ABOUT)
    other = json.loads(json.dumps(clip.provenance["inputs"]))
    other["options"]["spacing"] = 4
    save(clip, tmp_path / "mixed" / "a.h5")
    save(replace(clip, name="c", provenance={"inputs": other}), tmp_path / "mixed" / "c.h5")
    with pytest.raises(
        InvalidValueError, match="c: provenance: expected clips built as a, found other options"
    ):
        publish(tmp_path / "mixed", tmp_path / "v", **ABOUT)


def test_versions_are_compared_by_content(built, tmp_path, capsys):
    clip = load(built / "a.h5")
    label = clip.labels.label.copy()
    label[0] = 3 - label[0]
    relabelled = replace(clip, labels=Labels(label, clip.labels.background))
    save(relabelled, tmp_path / "new" / "a.h5")
    save(replace(clip, name="c"), tmp_path / "new" / "c.h5")
    found = diff(built, tmp_path / "new").set_index("clip")
    assert found["change"].to_dict() == {"a": "changed", "b_test": "removed", "c": "added"}
    assert found.loc["a", ["added", "removed", "same", "labels"]].tolist() == [0, 0, len(clip.dense), 1]
    assert main(["diff", str(built), str(built)]) == 0
    assert "no clip differs" in capsys.readouterr().out
    fewer = np.arange(1, len(clip.dense))
    kept = clip.evaluated[clip.evaluated > 0]
    labels = Labels(clip.labels.label[clip.evaluated > 0], clip.labels.background)
    dense = clip.dense.select(fewer)
    save(replace(clip, dense=dense, evaluated=kept - 1, labels=labels), tmp_path / "less" / "a.h5")
    assert main(["diff", str(built), str(tmp_path / "less"), "--json"]) == 0
    row = json.loads(capsys.readouterr().out)[0]
    assert (row["added"], row["removed"], row["labels"]) == (0, 1, 0)


def test_a_clip_that_changed_after_it_was_published_is_noticed(built, published, tmp_path):
    assert diff(published, built).empty
    clip = load(published / "clips" / "a.h5")
    manifest = (published / "dataset.json").read_bytes()
    (tmp_path / "v").mkdir()
    (tmp_path / "v" / "dataset.json").write_bytes(manifest)
    save(replace(clip, name="a"), tmp_path / "v" / "clips" / "a.h5")
    with pytest.raises(
        FileFormatError, match=r"b_test\.h5: expected the clip of Two scenes 1\.0\.0, found none"
    ):
        diff(tmp_path / "v", built)


def test_another_background_or_name_is_a_difference(built, tmp_path):
    clip = load(built / "a.h5")
    for change in ({"background": 2}, {"names": {2: "tram"}}):
        other = tmp_path / next(iter(change))
        save(replace(clip, labels=replace(clip.labels, **change)), other / "a.h5")
        save(load(built / "b_test.h5"), other / "b_test.h5")
        [row] = [row for row in diff(built, other).to_dict("records") if row["clip"] == "a"]
        assert (row["labels"], row["built"]) == (0, next(iter(change)))
