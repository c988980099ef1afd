"""Inputs that users bring: the right result, or one line that names the cause; never a wrong number."""

import json
import os
import resource
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from evaluation_helpers import CLIPS, perfect, truth

import kt3dmoseg
import mseg
import mseg.cli
from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import Clip, Labels, Trajectories
from mseg.evaluation import SubmissionMeta, score_submission, validate_submission, write_submission

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


def test_a_data_frame_is_joined_by_track(data):
    table = pd.DataFrame({"track": IDS, "label": CLIP.labels.label}).sample(frac=1, random_state=0)
    assert mseg.score(truth=CLIP, pred=table).error == 0
    assert mseg.score(str(data / "example_two.h5"), table).error == 0


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
    """The bounds are the harness's: 300 MB of memory and 3 s of processor time kill the process."""
    (tmp_path / "a.csv").write_bytes(CELLS[kind])

    def limit():
        resource.setrlimit(resource.RLIMIT_CPU, (3, 4))

    done = subprocess.run(
        [sys.executable, "-c", BOUNDED + PEAK, str(tmp_path / "a.csv")],
        preexec_fn=limit,
        capture_output=True,
        text=True,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr


PEAK = """
peak = int(next(line for line in open("/proc/self/status") if line.startswith("VmHWM")).split()[1])
assert peak < 300_000, peak
"""


def test_a_deep_key_is_refused_in_one_line(tmp_path):
    folder = perfect(tmp_path / "s")
    (folder / "meta.toml").write_text("a" + ".a" * 20_000 + " = 1\n")
    [problem] = validate_submission(folder, CLIPS).problems
    assert problem.code == "meta-syntax"
    assert "levels" in problem.found
