"""Inputs that users bring: the right result, or one line that names the cause; never a wrong number."""

import json
import os
import resource
import subprocess
import sys
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import pytest
from evaluation_helpers import CLIPS, perfect, truth

import kt3dmoseg
import mseg
import mseg.benchmark.runner  # before a test replaces what it imports
import mseg.cli
from kt3dmoseg.errors import InputFileError, InvalidValueError
from kt3dmoseg.types import Clip, Labels, Trajectories
from mseg.errors import SegmentationError
from mseg.evaluation import (
    SubmissionMeta,
    score_submission,
    validate_submission,
    write_report,
    write_submission,
)

CLIP = CLIPS["example_two"]
IDS = CLIP.dense.track_id[CLIP.evaluated]


@pytest.fixture
def data(tmp_path):
    for name, clip in CLIPS.items():
        kt3dmoseg.save(clip, tmp_path / "data" / f"{name}.h5")
    return tmp_path / "data"


def same_in_all_seeds(folder, seeds, clips=CLIPS):
    """A submission with a third of the labels moved, the same in every seed."""
    runs = {}
    for name, clip in clips.items():
        label = clip.labels.label
        moved = np.random.default_rng(len(label)).random(len(label)) < 1 / 3
        runs[name] = np.where(moved, label % label.max() + 1, label)
    meta = SubmissionMeta(folder.name, dataset_version="unnamed", benchmark="custom")
    return write_submission(folder, clips.values(), dict.fromkeys(range(seeds), runs), meta)


def test_python_predictions_that_count_from_zero_are_refused():
    with pytest.raises(InvalidValueError, match=r"pred: .*label 0.*outliers=True"):
        mseg.score(truth=[1, 1, 2, 2, 3, 3], pred=[0, 0, 1, 1, 2, 2])


def test_a_truth_that_counts_from_zero_is_refused_unless_labels_say_so():
    for values in ([0, 0, 1, 1], [0, 0, 0, 1, 2]):
        with pytest.raises(InvalidValueError, match=r"truth: .*add 1 .* or give Labels\(truth\)"):
            mseg.score(values, np.array(values) + 1)
        labels = Labels(np.array(values))
        assert mseg.score(labels, np.array(values) + 1).clips[0].n == np.count_nonzero(values)
    with pytest.warns(
        UserWarning, match="label 0, which is not scored, at 1 of 5; add 1 if they count from 0"
    ):
        assert mseg.score([1, 1, 2, 2, 0], [1, 1, 2, 2, 2]).error == 0


def test_a_data_frame_is_joined_by_track(data):
    table = pd.DataFrame({"track": IDS, "label": CLIP.labels.label}).sample(frac=1, random_state=0)
    assert mseg.score(truth=CLIP, pred=table).error == 0
    assert mseg.score(str(data / "example_two.h5"), table).error == 0


def test_tracks_that_are_texts_are_called_so():
    table = pd.DataFrame({"track": IDS.astype(str).astype(object), "label": CLIP.labels.label})
    with pytest.raises(InvalidValueError, match=r"pred: track: .*found the text '"):
        mseg.score(CLIP, table)


def test_complex_positions_are_refused():
    xy, visible = CLIP.dense.xy, CLIP.dense.visible
    with pytest.raises(InvalidValueError, match=r"an array \(N, F, 2\)"):
        mseg.segment((xy + 0j, visible), method="affine", n_motions=2)
    with pytest.raises(InvalidValueError, match="expected real numbers, found complex128"):
        Trajectories(xy + 0j, visible)


def test_a_submission_written_again_leaves_no_older_result(tmp_path):
    perfect(tmp_path / "mine", meta=SubmissionMeta("old"))
    with pytest.raises(InvalidValueError, match="example_three"):
        write_submission(tmp_path / "mine", [CLIP], {CLIP.name: CLIP.labels.label}, SubmissionMeta("new"))
    assert validate_submission(tmp_path / "mine", CLIPS).submission.meta.method == "old"


MANY = {f"clip{i:02}": Clip(f"clip{i:02}", CLIP.dense, CLIP.evaluated, CLIP.labels) for i in range(7)}


def test_the_number_of_equal_seeds_is_no_difference(tmp_path, capsys):
    for name, clip in MANY.items():
        kt3dmoseg.save(clip, tmp_path / "data" / f"{name}.h5")
    few, many = (str(same_in_all_seeds(tmp_path / n, k, MANY)) for n, k in (("few", 3), ("many", 7)))
    assert mseg.cli.main(["compare", few, many, str(tmp_path / "data")]) == 0
    assert "is better than" not in capsys.readouterr().out
    db = str(tmp_path / "board.sqlite")
    for folder in (few, many):
        assert mseg.cli.main(["leaderboard", "add", folder, str(tmp_path / "data"), "--db", db]) == 0
    capsys.readouterr()
    assert mseg.cli.main(["leaderboard", "rank", "--db", db, "--json"]) == 0
    [board] = json.loads(capsys.readouterr().out)
    assert [rank for rank, _ in board["ranked"]] == [1, 1]


def test_label_files_that_count_from_zero_or_a_word_about_it(data, tmp_path, capsys):
    """In one file, cluster 1 is empty."""
    (tmp_path / "labels").mkdir()
    for name, label in truth().items():
        label = label - 1 if name == "example_two" else np.where(label == 1, 0, label)
        np.savetxt(tmp_path / "labels" / f"{name}.txt", label, fmt="%d")
    words = [
        "example-submission",
        str(data),
        "--from",
        str(tmp_path / "labels"),
        "-o",
        str(tmp_path / "mine"),
    ]
    assert mseg.cli.main(words) == 2
    assert "label 0" in capsys.readouterr().err
    assert mseg.cli.main([*words, "--zero", "first"]) == 0
    assert score_submission(tmp_path / "mine", CLIPS).error == 0


@pytest.mark.parametrize("value", [-0.5, 35.0])
def test_scores_out_of_range_are_refused(data, tmp_path, capsys, value):
    scores = scores_file(tmp_path, lambda s: [c["values"].update(error=value) for c in s["clips"]])
    assert mseg.cli.main(["leaderboard", "add", str(scores), "--db", str(tmp_path / "b.sqlite")]) == 2
    assert "error" in capsys.readouterr().err


def scores_file(tmp_path, change):
    from mseg.evaluation.scoring import to_json

    scores = to_json(score_submission(same_in_all_seeds(tmp_path / "s", 2, MANY), MANY))
    change(scores)
    (tmp_path / "scores.json").write_text(json.dumps(scores))
    return tmp_path / "scores.json"


def test_scores_of_fewer_clips_are_refused(tmp_path, capsys):
    scores = scores_file(tmp_path, lambda s: s.update(clips=[c for c in s["clips"] if c["clip"] != "clip00"]))
    assert mseg.cli.main(["leaderboard", "add", str(scores), "--db", str(tmp_path / "b.sqlite")]) == 2
    assert "clip" in capsys.readouterr().err


def few_points(folder):
    xy = np.random.default_rng(0).uniform(0, 200, (5, 8, 2))
    tracks = Trajectories(xy, np.ones((5, 8), bool))
    kt3dmoseg.save(Clip("few", tracks, np.arange(5), Labels(np.array([1, 1, 1, 2, 2]))), folder / "few.h5")


def test_a_run_in_which_every_clip_failed_is_a_failure(tmp_path, capsys):
    few_points(tmp_path / "data")
    command = ["run", str(tmp_path / "data"), "-o", str(tmp_path / "mine"), "--method", "lsa", "--quiet"]
    assert mseg.cli.main(command) == 1
    assert "failed: few.failed: " in capsys.readouterr().err
    with pytest.raises(SegmentationError, match=r"found few\.failed: "):
        mseg.benchmark.predict(tmp_path / "data", tmp_path / "other", "lsa")
    assert (tmp_path / "other" / "meta.toml").is_file()


def test_one_motion_found_where_one_is_true_is_valid(tmp_path):
    still = CLIP.with_labels(Labels(np.ones(len(CLIP.evaluated), dtype=int)))
    folder = write_submission(tmp_path / "s", [still], {CLIP.name: still.labels.label}, SubmissionMeta("m"))
    assert validate_submission(folder, [still]).ok


CELLS = {
    "five million rows": b"track,label\n" + b"1,1\n" * 5_000_000,
    "five million letters": b"track,label\n" + b"a,b\n" * 5_000_000,
    "five million lines of one value": b"1\n" * 5_000_000,
    "five million commas": b"track,label\n" + b"," * 5_000_000,
    "no line end": b"track,label\n" + b"1" * 20_000_000,
    "empty lines": b"track,label\n" + b"\n" * 30_000_000,
    "NUL": b"track,label\n1,\0\n",
    "not UTF-8": b"track,label\n1,\xff\n",
    "400 digits": b"track,label\n1," + b"9" * 400 + b"\n",
    "long integers": b"track,label\n1," + b"9" * 30 + b"\n",
    "400 digits after the point": b"track,label\n1,1." + b"3" * 400 + b"\n",
}
BOUNDED = """
import sys
from kt3dmoseg.io.predictions import parse_prediction
content = open(sys.argv[1], "rb").read()
problems = parse_prediction(content, "a.csv", "a").problems
assert problems and all("\\n" not in str(p) and len(str(p)) < 600 for p in problems), problems
"""


@pytest.mark.parametrize("kind", CELLS)
def test_a_hostile_table_is_refused_in_one_line_within_bounds(tmp_path, kind):
    (tmp_path / "a.csv").write_bytes(CELLS[kind])
    refused_within_bounds(BOUNDED, tmp_path / "a.csv")


def refused_within_bounds(script, path):
    """The bounds are the harness's: 300 MB of memory and 3 s of processor time kill the process."""

    def limit():
        resource.setrlimit(resource.RLIMIT_CPU, (3, 4))

    done = subprocess.run(
        [sys.executable, "-c", script + PEAK, str(path)],
        preexec_fn=limit,
        capture_output=True,
        text=True,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr


def members(value):
    return b"{" + b",".join(b'"%x":%b' % (i, value) for i in range(300_000)) + b"}"


SCORES = b'{"format":"mseg-scores","version":1,"benchmark":"custom","clips":['
FILES = {
    "clips of scores": ("s.json", SCORES + b"{}," * 3_000_000 + b"{}]}"),
    "values of scores": ("s.json", SCORES + b'{"values":' + members(b'""') + b"}]}"),
    "values of results": ("kt3dmoseg/2018/r.json", b'{"clips":' + members(b"{}") + b"}"),
    "tables": ("meta.toml", b"".join(b"[a%d]\n" % i for i in range(29_000))),  # as many as fit
    "more tables": ("meta.toml", b"".join(b"[a%d]\n" % i for i in range(150_000))),
    "hexadecimal": ("meta.toml", b"seconds = 0x" + b"f" * 250_000),
}
READ = """
import pathlib, sys
from kt3dmoseg.errors import KT3DMoSegError
from mseg.benchmark.publishing import read_result
from mseg.evaluation.scoring import load_scores
from mseg.evaluation.submission import parse_meta
path = pathlib.Path(sys.argv[1])
try:
    if path.suffix == ".toml":
        [problem] = parse_meta(path.read_bytes())[1]
        raise KT3DMoSegError(str(problem))
    (load_scores if path.name == "s.json" else read_result)(path)
    raise SystemExit("it was read")
except KT3DMoSegError as error:
    assert "\\n" not in str(error) and len(str(error)) < 600, error
"""


@pytest.mark.parametrize("kind", FILES)
def test_files_with_more_than_fits_are_refused_in_one_line_within_bounds(tmp_path, kind):
    name, content = FILES[kind]
    path = tmp_path / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    refused_within_bounds(READ, path)


def test_a_folder_of_many_files_and_of_other_names_is_read_within_bounds(tmp_path):
    folder = perfect(tmp_path / "s")
    (folder / os.fsdecode(b"\xff.csv")).write_bytes(b"")
    for k in range(5000):
        (folder / f"x{k}.csv").write_bytes(b"")
    (folder / "y.csv").write_bytes(b"track,label\n" + b"1,1\n" * 150_000)
    found = validate_submission(folder, CLIPS).problems
    assert [p.file for p in found if p.code == "unsafe-path"] == ["'\\udcff.csv'"]
    assert [p.file for p in found if p.code == "too-large"] == ["y.csv"]
    assert len(found) == 2 * 5000 + 3


PEAK = """
peak = int(next(line for line in open("/proc/self/status") if line.startswith("VmHWM")).split()[1])
assert peak < 300_000, peak
"""


def test_a_deep_key_is_refused_in_one_line(tmp_path):
    folder = perfect(tmp_path / "s")
    (folder / "meta.toml").write_text("a" + ".a" * 20_000 + " = 1\n")
    [problem] = validate_submission(folder, CLIPS).problems
    assert (problem.code, problem.found) == ("meta-syntax", "more levels inside each other")


def test_a_report_onto_a_pipe_is_refused_before_anything_is_read(tmp_path):
    os.mkfifo(tmp_path / "report.html")
    with pytest.raises(InputFileError, match="FIFO"):
        write_report(tmp_path / "nothing", tmp_path / "nowhere", tmp_path / "report.html")
    assert (tmp_path / "report.html").is_fifo()


# --- neighbours: Python values ------------------------------------------------------------------

LABELS = CLIP.labels.label
SHUFFLED = np.random.default_rng(0).permutation(len(LABELS))
TABLE = pd.DataFrame({"track": IDS, "label": LABELS}).iloc[SHUFFLED]
SAME_LABELS = {
    "tuple": tuple(LABELS.tolist()),
    "floats": LABELS.astype(float),
    "column": LABELS[:, None],
    "series": pd.Series(LABELS),
    "series by track": TABLE.set_index("track")["label"],
    "nullable": pd.Series(LABELS, dtype="Int64"),
    "categorical": pd.Series(LABELS).astype("category"),
    "frame": TABLE,
    "frame by index": TABLE.set_index("track"),
    "frame of more columns": TABLE.assign(score=0.5),
    "mapping": {"track": IDS[SHUFFLED], "label": LABELS[SHUFFLED]},
    "record array": TABLE.to_records(index=False),
    "by clip": {CLIP.name: LABELS},
    "by seed and clip": {0: {CLIP.name: TABLE}, 5: {CLIP.name: LABELS}},
    "labels": CLIP.labels,
}


@pytest.mark.parametrize("kind", SAME_LABELS)
def test_predictions_in_any_form_are_scored_alike(kind):
    assert mseg.score(CLIP, SAME_LABELS[kind]).error == 0


def without(row):
    return TABLE.drop(index=TABLE.index[row])


class OnGpu:
    """A tensor that numpy cannot see."""

    def __array__(self, *_, **__):
        raise TypeError("can't convert cuda:0 device type tensor to numpy. Use Tensor.cpu() first.")


WRONG_LABELS = {
    "on a GPU": (OnGpu(), r"vector of labels, found OnGpu: can't convert cuda:0 .* Use Tensor\.cpu"),
    "bool": (LABELS == 1, "type bool"),
    "texts": (list(map(str, LABELS)), "type <U1"),
    "NaN": (np.where(np.arange(len(LABELS)) == 3, np.nan, LABELS), "NaN in row 3"),
    "infinite": (np.where(np.arange(len(LABELS)) == 3, np.inf, LABELS), "inf in row 3"),
    "fraction": (LABELS + 0.5, "whole numbers"),
    "negative": (LABELS - 2, "labels >= 0"),
    "long": ([10**30, *LABELS[1:].tolist()], "labels >= 0"),
    "short": (LABELS[:-1], "40 labels"),
    "2-D": (np.tile(LABELS, (2, 1)), "vector"),
    "ragged": ([[1, 2], [1]], "unequal"),
    "number": (1, "vector"),
    "nothing": (None, "vector"),
    "set": (set(LABELS.tolist()), "vector"),
    "clip": (CLIP, "vector"),
    "masked": (np.ma.masked_array(LABELS, LABELS == 1), "every trajectory"),
    "nullable": (pd.Series([None, *LABELS[1:].tolist()], dtype="Int64"), "row 0"),
    "categorical": (pd.Series(list(map(str, LABELS))).astype("category"), "row 0"),
    "shuffled series": (pd.Series(LABELS)[SHUFFLED], "trajectories"),
    "missing track": (without(0), "1 missing"),
    "track twice": (pd.concat([TABLE, TABLE.iloc[:1]]), "more than once"),
    "another track": (TABLE.assign(track=TABLE.track.replace(IDS[0], 7777)), "not evaluated"),
    "no track": (pd.DataFrame({"label": LABELS}), "columns track and label"),
    "no label": (pd.DataFrame({"track": IDS, "motion": LABELS}), "columns track and label"),
    "track NaN": (TABLE.assign(track=np.nan), "track"),
    "another clip": ({"example_three": LABELS}, "which is no clip"),
    "two clips": ({CLIP.name: LABELS, "other": LABELS}, "other, which is no clip"),
    "no clip": ({}, "clip names"),
    "texts for seeds": ({"a": {CLIP.name: LABELS}}, "seeds"),
    "outliers": (LABELS - 1, "outliers=True"),
}


@pytest.mark.parametrize("kind", WRONG_LABELS)
def test_python_predictions_that_fit_no_clip_are_refused(kind, tmp_path):
    values, word = WRONG_LABELS[kind]
    with pytest.raises(InvalidValueError, match=word) as caught:
        mseg.score(CLIP, values)
    assert "\n" not in str(caught.value)
    if kind not in ("outliers", "another clip", "two clips", "no clip", "texts for seeds"):
        with pytest.raises(InvalidValueError, match=word):
            write_submission(tmp_path / "s", [CLIP], {CLIP.name: values}, SubmissionMeta("m"))
        assert not (tmp_path / "s").exists()


def test_zero_is_an_outlier_where_that_is_stated(tmp_path):
    some = np.where(np.arange(len(LABELS)) < 4, 0, LABELS)
    for pred in (mseg.Segmentation(some), Labels(some)):
        assert mseg.score(CLIP, pred).error == 0.1
    assert mseg.score(CLIP, some, outliers=True).error == 0.1
    write_submission(tmp_path, [CLIP], {CLIP.name: some}, SubmissionMeta("m"))
    file = tmp_path / f"{CLIP.name}.csv"
    assert mseg.score(CLIP, file, outliers=True).error == 0.1
    with pytest.raises(InvalidValueError, match="label 0 of 4"):
        mseg.score(CLIP, file)


def test_truth_and_predictions_of_several_clips(data, tmp_path):
    for truths in (CLIPS, list(CLIPS.values()), data, truth()):
        table = mseg.score(truths, truth())
        assert (table.error, sorted(table.names)) == (0, sorted(CLIPS))
    folder = perfect(tmp_path / "s")
    assert mseg.score(data, folder / "example_three.csv").names == ["example_three"]
    with pytest.raises(InvalidValueError, match="nothing for example_three"):
        mseg.score(data, {"example_two": LABELS})
    with pytest.raises(InvalidValueError, match="a mapping of clip names"):
        mseg.score(data, LABELS)
    with pytest.raises(InvalidValueError, match="own name"):
        mseg.score([CLIP, CLIP], {CLIP.name: LABELS})


def test_tables_without_a_clip_are_joined_by_track():
    assert mseg.score(TABLE, pd.DataFrame({"track": IDS, "label": LABELS})).error == 0
    assert mseg.score(TABLE.set_index("track").label, TABLE.sample(frac=1, random_state=1)).error == 0
    with pytest.raises(InvalidValueError, match="a table of tracks"):
        mseg.score(LABELS, TABLE)
    for pred in (LABELS, mseg.Segmentation(LABELS)):
        with pytest.raises(
            InvalidValueError, match="pred: expected a table of tracks, as truth is one in no"
        ):
            mseg.score(TABLE.sample(frac=1, random_state=1), pred)


def test_data_and_submission_in_the_wrong_order_are_named(data, tmp_path):
    with pytest.raises(InvalidValueError, match="found a submission"):
        mseg.score(perfect(tmp_path / "s"), data)


def test_scores_of_other_labels_are_not_compared():
    from mseg.evaluation import compare

    with pytest.raises(InvalidValueError, match="same clips and labels"):
        compare([mseg.score([1, 1, 2], [1, 1, 2]), mseg.score([1, 2, 2], [1, 1, 2])])


# --- neighbours: segmenting arrays ----------------------------------------------------------------

XY = CLIP.dense.xy
SEEN = CLIP.dense.visible


def scaled(factor):
    tracks = Trajectories(XY * factor, SEEN, CLIP.dense.track_id, (320, 240))
    return replace(CLIP, dense=tracks)


@pytest.mark.parametrize(
    ("given", "more"),
    [
        (CLIP.dense, {}),
        (XY, {}),
        ((np.nan_to_num(XY), SEEN), {}),
        (XY.tolist(), {"visible": SEEN.astype(int)}),
    ],
    ids=["trajectories", "xy", "pair", "visible"],
)
def test_arrays_are_segmented_as_the_clip_is(given, more):
    every = Clip("all", CLIP.dense, np.arange(len(CLIP.dense)), Labels(np.zeros(len(CLIP.dense), int)))
    wanted = mseg.segment(every, "affine", n_motions=2)
    assert mseg.segment(given, "affine", n_motions=2, **more).labels.tolist() == wanted.labels.tolist()


@pytest.mark.parametrize(
    ("given", "more", "word"),
    [
        ("clip.h5", {}, "kt3dmoseg.load"),
        (XY[..., 0], {}, r"shape \(N, F, 2\)"),
        (XY.swapaxes(1, 2), {}, r"shape \(N, F, 2\)"),
        (XY.swapaxes(0, 1), {}, "paths that bend less in time .* exchange the axes of tracks and frames"),
        (XY / (320, 240), {}, "xy: expected pixels, found at most"),
        (XY, {"visible": SEEN[1:]}, "visible"),
        (XY, {"visible": np.full(SEEN.shape, 0.5)}, "True or False"),
        (XY, {"visible": np.ones_like(SEEN)}, "finite"),
        (np.ma.masked_array(np.ones((9, 4, 2)), True), {"visible": np.ones((9, 4))}, "finite"),
        (np.where(SEEN[..., None], XY, -1), {}, r"found \d+ at exactly \(-1, -1\)"),
        (np.nan_to_num(XY, nan=7.5), {"visible": ~SEEN}, "in two frames or more, .* not occluded"),
        (CLIP, {"visible": SEEN}, "nothing with a clip"),
        (Trajectories(XY / 1000, SEEN), {}, "clip: expected pixels, found all within"),
        (scaled(0.01), {}, "all within"),
        (scaled(10.0), {}, "most points outside"),
        (CLIP, {"n_motions": 2.5}, "n_motions"),
        (CLIP, {"n_motions": True}, "n_motions"),
        (CLIP, {"n_motions": "2"}, "n_motions"),
        (CLIP, {"seed": -1}, "seed"),
        (CLIP, {"seed": None}, "seed"),
    ],
)
def test_what_cannot_be_segmented_is_refused(given, more, word):
    with pytest.raises(InvalidValueError, match=word):
        mseg.segment(given, "affine", **{"n_motions": 2, **more})


@dataclass(frozen=True)
class Careless:
    """A method with everything wrong that is no error."""

    def segment(self, clip, *, n_motions, rng):
        labels = np.ones(len(clip.evaluated), dtype=int)
        labels[:3] = 0
        return mseg.Segmentation(labels, {"converged": False, "warnings": ["2 parts never seen together"]})


NOTES = (
    "groups found: 1, asked for: 2",
    "3 trajectories are outliers (label 0), which was not asked for",
    "the method did not converge",
    "2 parts never seen together",
)


def test_motions_that_were_never_seen_together_are_reported():
    seen = np.zeros((40, 9), dtype=bool)
    seen[:20, :4], seen[20:, 4:] = True, True
    xy = np.random.default_rng(0).uniform(0, 100, (40, 9, 2))
    [note] = mseg.segment(xy, "one_motion", visible=seen).report["notes"]
    assert note.startswith("2 parts of the clip have no trajectory in common")
    seen[0] = True
    assert mseg.segment(xy, "one_motion", visible=seen).report["notes"] == ()


def test_what_a_method_did_otherwise_than_asked_is_reported(data, tmp_path, monkeypatch, capsys):
    found = mseg.segment(CLIP, Careless(), n_motions=2)
    assert found.report["notes"] == NOTES
    assert NOTES[0] in repr(found)
    monkeypatch.setattr("mseg.methods.create", lambda name, **_: Careless())
    monkeypatch.setattr("mseg.benchmark.runner.create", lambda name, **_: Careless())
    assert mseg.cli.main(["run", str(data), "-o", str(tmp_path / "s"), "--seeds", "2", "--quiet"]) == 0
    line = f"note: example_two: {'; '.join(NOTES)}"
    assert line in capsys.readouterr().err.splitlines()
    table = score_submission(tmp_path / "s", CLIPS)
    assert table.meta.notes["example_two"] == "; ".join(NOTES)
    assert mseg.cli.main(["score", str(tmp_path / "s"), str(data)]) == 0
    out = capsys.readouterr().out
    assert f"The method reports on example_two: {'; '.join(NOTES)}." in out
    assert mseg.cli.main(["report", str(tmp_path / "s"), str(data), "-o", str(tmp_path / "r.html")]) == 0
    assert NOTES[3] in (tmp_path / "r.html").read_text()


def test_fewer_groups_than_the_given_number_are_named_with_the_scores(data, tmp_path, capsys):
    labels = {**truth(), "example_three": np.minimum(truth()["example_three"], 2)}
    folder = write_submission(tmp_path / "s", CLIPS.values(), labels, SubmissionMeta("m"))
    assert mseg.cli.main(["score", str(folder), str(data)]) == 0
    assert "though their number was given: example_three (2 of 3)." in capsys.readouterr().out


def test_a_run_into_a_folder_of_other_predictions_is_refused(data, tmp_path, capsys):
    folder = str(perfect(tmp_path / "s"))
    assert mseg.cli.main(["run", str(data), "-o", folder, "--method", "one_motion", "--quiet"]) == 2
    assert "not written by 'mseg run'" in capsys.readouterr().err


# --- neighbours: writing and running ----------------------------------------------------------------


def test_hidden_files_and_other_forms_of_a_clip_are_no_older_results(tmp_path):
    (tmp_path / "._other.csv").write_text("left by macOS")
    write_submission(tmp_path, CLIPS, truth(), SubmissionMeta("one"))
    write_submission(tmp_path, CLIPS.values(), truth(), SubmissionMeta("two"), format="npz")
    assert validate_submission(tmp_path, CLIPS).ok


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"predictions": [LABELS]}, "predictions: expected a mapping, found list of ndarray"),
        ({"predictions": {True: {CLIP.name: LABELS}}}, "seeds"),
        ({"meta": "m"}, "SubmissionMeta"),
        ({"format": "tsv"}, "csv or npz or h5"),
        ({"clips": [CLIP, CLIP]}, "own name"),
        ({"clips": [LABELS]}, "ndarray"),
    ],
)
def test_a_submission_that_cannot_be_written_writes_nothing(tmp_path, changes, word):
    given = {"clips": [CLIP], "predictions": {CLIP.name: LABELS}, "meta": SubmissionMeta("m"), **changes}
    with pytest.raises(InvalidValueError, match=word):
        write_submission(tmp_path / "s", **given)
    assert not (tmp_path / "s").exists() or not list((tmp_path / "s").iterdir())


@pytest.mark.parametrize("seeds", [0, -1, True, 1.5, [], [0, 0], [-1], ["0"]])
def test_seeds_are_whole_numbers_each_once(tmp_path, data, seeds):
    with pytest.raises(InvalidValueError, match="seeds"):
        mseg.benchmark.predict(data, tmp_path / "p", "one_motion", seeds=seeds)


@pytest.mark.parametrize("result", [None, LABELS])
def test_a_method_that_returns_no_segmentation_is_at_fault(result):
    class Odd:
        def segment(self, clip, *, n_motions, rng):
            return result

    with pytest.raises(SegmentationError, match="fault of the method"):
        mseg.segment(CLIP, Odd(), n_motions=2)
    with pytest.raises(InvalidValueError, match="name of a method"):
        mseg.segment(CLIP, Odd, n_motions=2)


def test_an_indexed_series_is_never_taken_by_position():
    from mseg.evaluation import classification_error

    with pytest.raises(InvalidValueError, match="index"):
        classification_error(LABELS, pd.Series(LABELS)[SHUFFLED])
