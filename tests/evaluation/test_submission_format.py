from dataclasses import replace

import numpy as np
import pytest
from evaluation_helpers import CLIPS, META, NAMES, perfect, truth, zip_folder

from kt3dmoseg.errors import InputFileError, InvalidValueError
from kt3dmoseg.io import predictions
from kt3dmoseg.types import Clip, Trajectories
from mseg.evaluation import (
    SubmissionMeta,
    clip_checksum,
    read_submission,
    validate_submission,
    write_failure,
    write_meta,
    write_prediction,
    write_submission,
)


@pytest.mark.parametrize("format", ["csv", "npz", "h5"])
@pytest.mark.parametrize("seeds", [0, 3])
def test_what_is_written_is_valid_and_reads_the_same(tmp_path, format, seeds):
    folder = perfect(tmp_path / "s", format=format, seeds=seeds)
    checked = validate_submission(folder, CLIPS)
    assert checked.ok, str(checked)
    assert checked.submission.seeds == list(range(max(1, seeds)))
    assert sorted({name for _, name in checked.labels}) == NAMES
    for (_, name), label in checked.labels.items():
        np.testing.assert_array_equal(label, truth()[name])


def test_layout(tmp_path):
    folder = perfect(tmp_path / "one")
    assert sorted(p.name for p in folder.iterdir()) == [*(f"{n}.csv" for n in NAMES), "meta.toml"]
    first = (folder / f"{NAMES[1]}.csv").read_text().splitlines()
    clip = CLIPS[NAMES[1]]
    assert first[:2] == ["track,label", f"{clip.dense.track_id[clip.evaluated][0]},{clip.labels.label[0]}"]
    several = perfect(tmp_path / "several", seeds=2)
    assert sorted(p.name for p in several.iterdir()) == ["meta.toml", "seed-0", "seed-1"]


def test_same_predictions_same_bytes_and_a_zip_hashes_as_its_folder(tmp_path):
    one, two = perfect(tmp_path / "a"), perfect(tmp_path / "b")
    for path in one.iterdir():
        assert path.read_bytes() == (two / path.name).read_bytes()
    packed = zip_folder(one, tmp_path / "a.zip")
    assert read_submission(one).sha256 == read_submission(packed).sha256 != ""
    (two / f"{NAMES[0]}.csv").write_text("track,label\n1,1\n")
    assert read_submission(two).sha256 != read_submission(one).sha256


def test_meta_survives(tmp_path):
    meta = SubmissionMeta(
        'Quote " back\\slash \U0001f600',
        ("A", "B"),
        benchmark="kt3dmoseg",
        n_motions_given=False,
        link="https://example.org",
        hardware="x",
        seconds=1.25,
        outliers=True,
        baseline=True,
        fingerprints={"c d": "00"},
        parameters={"alpha": "8\nlines"},
    )
    write_meta(tmp_path, meta)
    read = read_submission(tmp_path)
    assert read.meta == meta
    assert [p.code for p in read.problems] == ["no-predictions"]
    for name, value in {"method": "a\x1b[31m", "authors": ("a\nb",), "seconds": -1.0, "link": None}.items():
        with pytest.raises(InvalidValueError, match=rf"meta\.{name}: expected"):
            write_submission(tmp_path, CLIPS.values(), truth(), replace(meta, **{name: value}))


@pytest.mark.parametrize("seconds", [np.float64(1.5), np.float32(1.5), np.int64(2), 2])
def test_seconds_are_any_real_number(tmp_path, seconds):
    folder = write_submission(tmp_path / "s", CLIPS.values(), truth(), SubmissionMeta("m", seconds=seconds))
    read = read_submission(folder)
    assert (read.meta.seconds, read.problems) == (seconds, [])


def test_order_of_rows_is_free(tmp_path):
    folder = perfect(tmp_path / "s")
    path = folder / f"{NAMES[0]}.csv"
    head, *rows = path.read_text().splitlines()
    path.write_text(
        "\r\n".join(["\ufefflabel, track", *(",".join(r.split(",")[::-1]) for r in rows[::-1]), ""])
    )
    assert head == "track,label"
    checked = validate_submission(folder, CLIPS)
    assert checked.ok, str(checked)
    np.testing.assert_array_equal(checked.labels[0, NAMES[0]], truth()[NAMES[0]])


def test_failed_clip_is_valid_and_noted(tmp_path):
    folder = perfect(tmp_path / "s")
    write_failure(folder, CLIPS[NAMES[0]], "no\n  memory")
    (folder / f"{NAMES[0]}.csv").unlink()
    checked = validate_submission(folder, CLIPS)
    assert checked.ok
    assert [(n.code, n.clip, n.found) for n in checked.notes] == [("failed", NAMES[0], "no memory")]
    write_prediction(folder, CLIPS[NAMES[0]], truth()[NAMES[0]])
    assert not list(folder.glob("*.failed"))


@pytest.mark.parametrize("labels", [[1, 2], np.zeros((40, 2))])
def test_labels_that_do_not_fit_are_not_written(tmp_path, labels):
    with pytest.raises(InvalidValueError):
        write_prediction(tmp_path, CLIPS["example_two"], labels)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["../up", "a/b", "", ".hidden", "c\0"])
def test_a_clip_name_cannot_leave_the_folder(tmp_path, name):
    clip = CLIPS["example_two"]
    named = Clip(name, clip.dense, clip.evaluated, clip.labels)
    with pytest.raises(InvalidValueError, match="plain file name"):
        write_prediction(tmp_path / "s", named, named.labels.label)
    assert not list(tmp_path.rglob("*.csv"))


def test_a_clip_name_may_be_in_any_language(tmp_path):
    clip = CLIPS["example_two"]
    named = Clip("Straße 2", clip.dense, clip.evaluated, clip.labels)
    folder = write_submission(tmp_path / "s", [named], {"Straße 2": clip.labels.label}, META)
    for path in (folder, zip_folder(folder, tmp_path / "s.zip")):
        checked = validate_submission(path, {"Straße 2": named})
        assert checked.ok, str(checked)


def test_checksum_distinguishes_data_but_not_precision_or_order():
    clip = CLIPS["example_two"]
    tracks = clip.dense
    float32 = Trajectories(tracks.xy.astype(np.float32), tracks.visible, tracks.track_id)
    assert clip_checksum(Clip("x", float32, clip.evaluated, clip.labels)) == clip_checksum(clip)
    order = np.arange(len(clip.evaluated))[::-1]
    assert clip_checksum(Clip("x", tracks, clip.evaluated[order], clip.labels)) == clip_checksum(clip)
    moved = Trajectories(tracks.xy + 0.01, tracks.visible, tracks.track_id)
    assert clip_checksum(Clip("x", moved, clip.evaluated, clip.labels)) != clip_checksum(clip)
    other_ids = Trajectories(tracks.xy, tracks.visible, tracks.track_id + 1)
    assert clip_checksum(Clip("x", other_ids, clip.evaluated, clip.labels)) != clip_checksum(clip)


def test_nothing_there(tmp_path):
    with pytest.raises(InputFileError, match="nothing there"):
        read_submission(tmp_path / "no")


def test_predictions_for_an_unknown_clip(tmp_path):
    from mseg.evaluation import write_submission

    with pytest.raises(InvalidValueError, match="nowhere"):
        write_submission(tmp_path, CLIPS.values(), {"nowhere": [1]}, META)


def test_a_bug_in_the_csv_parser_is_not_reported_as_a_damaged_file(monkeypatch):
    def broken(*_):
        raise ZeroDivisionError

    monkeypatch.setattr(predictions, "_csv_columns", broken)
    with pytest.raises(ZeroDivisionError):
        predictions.parse_prediction(b"track,label\n0,1\n", "a.csv", "a")
