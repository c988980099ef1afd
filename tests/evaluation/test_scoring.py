import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from evaluation_helpers import CLIPS, META, NAMES, perfect, truth, zip_folder

import kt3dmoseg
import mseg
import mseg.cli
from kt3dmoseg.errors import InvalidValueError, UnknownNameError
from kt3dmoseg.types import Labels
from mseg.errors import RejectedSubmissionError
from mseg.evaluation import (
    SubmissionMeta,
    score_submission,
    validate_submission,
    write_failure,
    write_submission,
)
from mseg.types import Segmentation


def test_bare_arrays_and_what_holds_labels():
    labels = [1, 1, 1, 2, 2]
    assert mseg.score(truth=labels, pred=[3, 3, 3, 9, 9]).error == 0
    table = mseg.score(truth=np.array(labels), pred=Segmentation(np.array([3, 3, 9, 9, 9])))
    assert table.error == pytest.approx(0.2)
    assert table["recall"] == pytest.approx((2 / 3 + 1) / 2)
    assert mseg.score(truth=Labels(np.array(labels)), pred=Labels(np.array(labels))).error == 0
    clip = CLIPS[NAMES[0]]
    assert mseg.score(truth=clip, pred=clip.labels).names == [NAMES[0]]
    with pytest.raises(UnknownNameError, match="recall"):
        table["recal"]


def test_printed_scores_are_one_line_per_metric_and_shown_ones_a_line():
    table = mseg.score(truth=[1, 1, 2, 2], pred=[1, 1, 1, 2])
    assert repr(table) == "ScoreTable(labels on clips of no benchmark, 1 clip, 1 seed: error 25.00 %)"
    lines = str(table).splitlines()
    assert lines[0] == "mean over 1 clip and 1 seed"
    assert lines[1].split() == ["error", "0.2500"]


def test_paths(tmp_path):
    for name, clip in CLIPS.items():
        kt3dmoseg.save(clip, tmp_path / "data" / f"{name}.h5")
    folder = perfect(tmp_path / "s")
    assert mseg.score(truth=tmp_path / "data", pred=folder).error == 0
    assert mseg.score(truth=tmp_path / "data" / f"{NAMES[0]}.h5", pred=truth()[NAMES[0]]).error == 0


def test_one_file_of_labels(tmp_path):
    clip = CLIPS["example_two"]
    folder = perfect(tmp_path / "s")
    assert mseg.score(truth=clip, pred=folder / "example_two.csv").error == 0
    (tmp_path / "labels.txt").write_text("\n".join(map(str, clip.labels.label)))
    assert mseg.score(truth=clip, pred=str(tmp_path / "labels.txt")).error == 0
    with pytest.raises(RejectedSubmissionError, match="60 evaluated"):
        mseg.score(truth=CLIPS["example_three"], pred=folder / "example_two.csv")
    with pytest.raises(InvalidValueError, match="join ids"):
        mseg.score(truth=[1, 2], pred=folder / "example_two.csv")


def test_perfect_scores_zero_and_every_metric_its_best(tmp_path):
    scores = score_submission(perfect(tmp_path / "s", seeds=2), CLIPS)
    assert scores.error == 0
    assert scores.complete
    assert {
        m: scores[m] for m in ("adjusted_rand", "nmi", "f_measure", "iou", "region_f", "moving_f")
    } == dict.fromkeys(("adjusted_rand", "nmi", "f_measure", "iou", "region_f", "moving_f"), pytest.approx(1))
    assert scores["count_error"] == scores["over_segmentation"] == scores["under_segmentation"] == 0
    assert scores["objects"] == (1 + 2) / 2


@pytest.mark.parametrize("seed", range(3))
def test_random_relabelling_is_still_perfect(tmp_path, seed):
    names = np.random.default_rng(seed).choice(1000, 4, replace=False) + 1
    relabelled = {name: names[label] for name, label in truth().items()}
    folder = write_submission(tmp_path / "s", CLIPS.values(), relabelled, META)
    assert score_submission(folder, CLIPS).error == 0


def test_mean_over_clips_is_not_pooled(tmp_path):
    pred = truth()
    pred["example_two"] = np.where(np.arange(40) == 0, 2, pred["example_two"])  # 1 of 40 wrong
    summary = score_submission(write_submission(tmp_path / "s", CLIPS.values(), pred, META), CLIPS).summary()
    assert summary.mean == pytest.approx((1 / 40 + 0) / 2)
    assert summary.median == pytest.approx((1 / 40 + 0) / 2)
    assert summary.pooled == pytest.approx(1 / 100)
    assert summary.seed_sd is None
    assert summary.interval.low == 0
    assert summary.interval.high == pytest.approx(1 / 40)


def test_seeds_are_averaged_and_their_spread_given(tmp_path):
    worse = truth()
    worse["example_two"] = np.where(np.arange(40) < 4, 3 - worse["example_two"], worse["example_two"])
    folder = write_submission(tmp_path / "s", CLIPS.values(), {0: truth(), 5: worse}, META)
    scores = score_submission(folder, CLIPS)
    assert scores.seeds == [0, 5]
    summary = scores.summary()
    assert summary.mean == pytest.approx(0.1 / 2 / 2)
    assert summary.seed_sd == pytest.approx(np.std([0, 0.05], ddof=1))


@pytest.mark.parametrize("how", ["missing", "failed"])
def test_a_clip_without_labels_is_fully_wrong_and_listed(tmp_path, how):
    folder = perfect(tmp_path / "s")
    (folder / "example_two.csv").unlink()
    if how == "failed":
        write_failure(folder, CLIPS["example_two"], "too hard")
    scores = score_submission(folder, CLIPS)
    assert scores.error == pytest.approx(0.5)
    assert not scores.complete
    (failure,) = scores.failures
    assert failure.clip == "example_two"
    assert failure.reason == {"missing": "missing", "failed": "failed: too hard"}[how]
    for metric in scores.metrics:
        assert np.isfinite(scores.matrix(metric)).all()
    assert failure.values["nmi"] == failure.values["f_measure"] == failure.values["objects"] == 0
    assert failure.values["count_error"] == 2


def test_missing_in_one_seed_only(tmp_path):
    folder = perfect(tmp_path / "s", seeds=2)
    (folder / "seed-1" / "example_two.csv").unlink()
    assert score_submission(folder, CLIPS).matrix().tolist() == [[0, 0], [0, 1]]


def test_invalid_is_rejected_with_every_problem_or_forced(tmp_path):
    folder = perfect(tmp_path / "s")
    (folder / "example_two.csv").write_text("track,label\n1,nan\n")
    (folder / "odd.xyz").write_text("")
    with pytest.raises(RejectedSubmissionError, match=r"2 problem.*1\. \[.*2\. \["):
        score_submission(folder, CLIPS)
    scores = score_submission(folder, CLIPS, force=True)
    assert scores.error == pytest.approx(0.5)
    assert scores.failures[0].reason.startswith("invalid: NaN")


def test_one_label_is_no_valid_submission_but_is_scored_as_it_is(tmp_path):
    constant = {name: np.full(len(label), 4) for name, label in truth().items()}
    folder = write_submission(tmp_path / "s", CLIPS.values(), constant, META)
    scores = score_submission(folder, CLIPS)
    assert [p.code for p in scores.problems] == ["one-label", "one-label"]
    assert scores.per_clip().tolist() == pytest.approx([40 / 60, 20 / 40])


def test_true_label_zero_is_not_scored(tmp_path):
    clip = CLIPS["example_two"]
    holes = clip.labels.label.copy()
    holes[:5] = 0
    clips = {"example_two": clip.with_labels(Labels(holes))}
    wrong_there = clip.labels.label.copy()
    wrong_there[:5] = 77
    folder = write_submission(tmp_path / "s", clips.values(), {"example_two": wrong_there}, META)
    scores = score_submission(folder, clips)
    assert scores.error == 0
    assert scores.clips[0].n == 35
    assert scores.clips[0].n_found == 2


def test_provenance_names_data_and_submission(tmp_path):
    folder = perfect(tmp_path / "s")
    one = score_submission(folder, CLIPS).provenance
    assert one == score_submission(zip_folder(folder, tmp_path / "s.zip"), CLIPS).provenance
    clip = CLIPS["example_two"]
    relabelled = {**CLIPS, "example_two": clip.with_labels(Labels(clip.labels.label[::-1].copy()))}
    other = score_submission(folder, relabelled).provenance
    assert other.dataset_sha256 != one.dataset_sha256
    assert other.submission_sha256 == one.submission_sha256


@pytest.mark.data
def test_prevalence_baseline_is_that_of_the_data(data_root, tmp_path):
    """1 - share of the largest motion; over all 22 clips that is 27.96 %, here are 14 of them."""
    clips = kt3dmoseg.load_dataset(data_root / "kt3dmoseg" / "release")
    ones = {name: np.ones(len(clip.evaluated), dtype=int) for name, clip in clips.items()}
    folder = write_submission(tmp_path / "s", clips.values(), ones, SubmissionMeta("p", baseline=True))
    scores = score_submission(folder, clips)
    expected = [1 - np.bincount(c.labels.label).max() / len(c.labels) for c in clips.values()]
    np.testing.assert_allclose(scores.per_clip(), expected)
    assert 100 * scores.error == pytest.approx(27.80, abs=0.005)
    assert scores.benchmark.coverage(scores.names) == "14 of 22 clips"
    assert not scores.complete
    assert scores.provenance.dataset_version == "2018"


def test_command(tmp_path, capsys):
    for name, clip in CLIPS.items():
        kt3dmoseg.save(clip, tmp_path / "data" / f"{name}.h5")
    folder, data = str(perfect(tmp_path / "s")), str(tmp_path / "data")
    assert mseg.cli.main(["score", folder, data]) == 0
    out = capsys.readouterr().out
    assert "Scored: all 2 clips." in out
    assert "example_three" in out
    assert mseg.cli.main(["score", folder, data, "--json", "-o", str(tmp_path / "scores.json")]) == 0
    written = json.loads((tmp_path / "scores.json").read_text())
    assert written["groups"]["all"]["metrics"]["error"]["mean"] == 0
    assert [m["n"] for m in written["clips"][0]["motions"]] == [20, 20, 20]
    assert written["clips"][1]["motions"][0]["confusion"] == {"1": 20, "2": 0}
    for flag, sign in (("--latex", r"\toprule"), ("--markdown", "| --- |"), ("--csv", "clip,n,motions")):
        assert mseg.cli.main(["score", folder, data, flag]) == 0
        assert sign in capsys.readouterr().out
    (tmp_path / "s" / "example_two.csv").write_text("track,label\n1,1.5\n")
    assert mseg.cli.main(["score", folder, data]) == 1
    assert "1. [float]" in capsys.readouterr().err
    assert mseg.cli.main(["score", folder, data, "--force"]) == 0
    assert "Counted as fully wrong: example_two" in capsys.readouterr().out


HEAVY = ("sklearn", "cv2", "matplotlib", "pandas", "scipy", "h5py", "torch", "numba")


@pytest.mark.parametrize("command", [["--help"], ["validate", "--help"], ["score", "--help"]])
def test_nothing_heavy_is_imported_to_start(command):
    code = (
        "import sys, mseg.cli\n"
        f"try: mseg.cli.main({command!r})\nexcept SystemExit: pass\n"
        f"print([m for m in {HEAVY!r} if m in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"


def test_scoring_itself_imports_nothing_heavier_than_the_assignment(tmp_path):
    folder = perfect(tmp_path / "s")
    code = (
        "import sys\n"
        "from mseg.evaluation import score_submission\nfrom mseg.evaluation.example import made_up_clips\n"
        f"score_submission({str(folder)!r}, made_up_clips())\n"
        "print([m for m in ('sklearn', 'cv2', 'matplotlib', 'pandas', 'scipy.stats') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("wrong", ["checksum", "two files", "failed too"])
def test_forced_clips_with_problems_count_as_fully_wrong_even_with_readable_labels(tmp_path, wrong):
    name = "example_two"
    given = {"fingerprints": {name: "0" * 16}} if wrong == "checksum" else {}
    folder = perfect(tmp_path / "s", meta=replace(META, **given))
    if wrong == "two files":
        np.savez(folder / f"{name}.npz", track=np.arange(3), label=np.arange(3))
    if wrong == "failed too":
        (folder / f"{name}.failed").write_text("no")
    scores = score_submission(folder, CLIPS, force=True)
    assert {c.clip: c.values["error"] for c in scores.clips} == {"example_three": 0, name: 1}
    [failure] = scores.failures
    assert failure.clip == name
    assert failure.reason.startswith("invalid: ")


def test_a_forced_seed_with_a_problem_leaves_the_others_alone(tmp_path):
    folder = perfect(tmp_path / "s", seeds=2)
    (folder / "seed-1" / "example_two.csv").write_text("track,label\n1,nan\n")
    assert score_submission(folder, CLIPS, force=True).matrix().tolist() == [[0, 0], [0, 1]]


def test_scores_of_bare_labels_know_their_trajectories_and_predictions():
    clip = CLIPS["example_two"]
    moved = replace(clip, dense=replace(clip.dense, xy=clip.dense.xy + 0.01))
    tables = [
        mseg.score(each, label) for each in (clip, moved) for label in (clip.labels, truth()[clip.name])
    ]
    sources = [table.provenance for table in tables]
    assert sources[0] == sources[1] != sources[2]
    assert sources[0].dataset_sha256 != sources[2].dataset_sha256
    other = mseg.score(clip, 3 - clip.labels.label).provenance
    assert other.dataset_sha256 == sources[0].dataset_sha256
    assert other.submission_sha256 != sources[0].submission_sha256
    assert mseg.score({clip.name: clip}, truth()[clip.name]).provenance == sources[0]


def test_a_clip_of_another_benchmark_is_said_to_be_one(tmp_path):
    names = "Seq005_Clip01", "Seq013_Clip01", "mydrive01"
    clips = [replace(CLIPS["example_two"], name=name) for name in names]
    label = CLIPS["example_two"].labels.label
    folder = write_submission(tmp_path / "s", clips, dict.fromkeys(names, label), META)
    [note] = validate_submission(folder, clips).notes
    assert note.found == "it is no clip of KT3DMoSeg"


def test_two_files_of_one_seed_leave_the_other_seeds_alone(tmp_path):
    folder = perfect(tmp_path / "s", seeds=2)
    (folder / "seed-1" / "example_two.failed").write_text("no")
    assert score_submission(folder, CLIPS, force=True).matrix().tolist() == [[0, 0], [0, 1]]
