"""What the commands print in addition to what their functions do."""

import shlex
from dataclasses import replace

import pytest
from evaluation_helpers import CLIPS, perfect

import kt3dmoseg
import mseg.cli
from mseg.benchmark import runner
from mseg.evaluation import SubmissionMeta
from mseg.evaluation.metrics import all_metrics


@pytest.fixture
def data(tmp_path):
    for name, clip in CLIPS.items():
        kt3dmoseg.save(clip, tmp_path / "data" / f"{name}.h5")
    return str(tmp_path / "data")


def usage_error(capsys, *words):
    """Exit with 2 and one line; return the line."""
    code = mseg.cli.main(list(words))
    printed = capsys.readouterr()
    assert code == 2
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    return printed.err


def test_run_names_the_clips_that_failed_and_the_next_step(data, tmp_path, capsys):
    out = str(tmp_path / "p")
    assert mseg.cli.main(["run", data, "-o", out, "--method", "affine", "--n-motions", "50"]) == 0
    printed = capsys.readouterr()
    [line] = [line for line in printed.err.splitlines() if "example_two" in line]
    assert line.startswith("failed: example_two.failed: expected at least 50 ")
    # The file does not name the clip: whoever shows it does.
    assert "example_two" not in (tmp_path / "p" / "example_two.failed").read_text()
    assert f"check it: mseg validate {out} {data}" in printed.err
    assert "(1 run failed)" in printed.err
    assert printed.out == ""


def test_the_next_step_can_be_pasted_whatever_the_names(tmp_path, capsys):
    assert mseg.cli.main(["example-submission", "-o", str(tmp_path / "my own")]) == 0
    [line] = [line for line in capsys.readouterr().err.splitlines() if line.startswith("check it: mseg ")]
    assert mseg.cli.main(shlex.split(line)[3:]) == 0


@pytest.mark.parametrize("flag", ["--seeds", "--workers", "--n-motions"])
@pytest.mark.parametrize("value", ["0", "-1", "two", "1.5"])
def test_counts_are_whole_numbers_from_1_up(flag, value, data, tmp_path, capsys):
    printed = usage_error(capsys, "run", data, "-o", str(tmp_path / "p"), flag, value)
    assert f"argument {flag}: expected a whole number >= 1, found '{value}'" in printed


def test_seed_is_not_taken_for_seeds(data, tmp_path, capsys):
    printed = usage_error(capsys, "run", data, "-o", str(tmp_path / "p"), "--seed", "3")
    assert "did you mean '--seeds'?" in printed


def test_scores_have_one_form(data, tmp_path, capsys):
    printed = usage_error(capsys, "score", str(perfect(tmp_path / "s")), data, "--json", "--csv")
    assert "Mutually exclusive arguments: {--json, --csv}" in printed


METRIC = "from mseg.evaluation.metrics import Metric\nmetric = Metric({}, 'theirs', 'higher', {})"


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("", "an importable their_metric:metric, found AttributeError: module 'their_metric' has no"),
        ("import no_such_package", "found ModuleNotFoundError: No module named 'no_such_package'; repair or"),
        (
            "metric = len",
            "expected a mseg.evaluation.metrics.Metric, found <built-in function len>; repair or",
        ),
        (
            METRIC.format("lambda table: 1 / 0", "float"),
            "a number, found ZeroDivisionError: division by zero",
        ),
        (
            METRIC.format("lambda table: None", "float"),
            "expected a number, found TypeError: float() argument",
        ),
        (METRIC.format("lambda table: table.n", "float"), ""),
    ],
)
def test_a_broken_metric_of_another_package_is_one_line(data, tmp_path, capsys, plugin, source, found):
    plugin("mseg.metrics", "extra", "their_metric:metric", source)
    all_metrics.cache_clear()
    try:
        if found:
            printed = usage_error(capsys, "score", str(perfect(tmp_path / "s")), data)
            assert "metric 'extra' of the package their-extra: expected " in printed
            assert found in printed
        else:
            scores = mseg.score(data, perfect(tmp_path / "s"))
            assert all(clip.values["extra"] == clip.n for clip in scores.clips)
    finally:
        all_metrics.cache_clear()


def test_the_command_line_chooses_another_form_than_the_file(data, tmp_path, capsys):
    (tmp_path / "run.toml").write_text("[score]\njson = true\n")
    command = ["score", str(perfect(tmp_path / "s")), data, "--config", str(tmp_path / "run.toml")]
    for flags, start in (([], "{"), (["--csv"], "clip,")):
        assert mseg.cli.main([*command, *flags]) == 0
        assert capsys.readouterr().out.startswith(start)


def test_data_come_last(data, tmp_path, capsys):
    submission, scores = str(perfect(tmp_path / "s")), str(tmp_path / "s.json")
    assert mseg.cli.main(["score", submission, data, "--json", "-o", scores]) == 0
    capsys.readouterr()
    assert "give the data last" in usage_error(capsys, "compare", submission, scores)
    assert "give the data last" in usage_error(capsys, "compare", scores, submission)
    assert mseg.cli.main(["compare", submission, scores, data]) == 0


def test_a_leaderboard_is_not_made_for_nothing(tmp_path, capsys):
    submission, board = str(perfect(tmp_path / "s")), tmp_path / "board.sqlite"
    printed = usage_error(capsys, "leaderboard", "add", submission, "--db", str(board))
    assert "give it after the submission" in printed
    assert not board.exists()


def test_an_output_that_cannot_be_written_is_reported_before_the_work(data, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(runner, "run_tasks", None)
    (tmp_path / "file").write_text("")
    printed = usage_error(capsys, "run", data, "-o", str(tmp_path / "file"))
    assert "cannot write" in printed
    assert "a file is where a folder should be" in printed


def test_a_leaderboard_that_cannot_be_written_is_one_line(data, tmp_path, capsys):
    assert mseg.cli.main(["example-submission", data, "-o", str(tmp_path / "s")]) == 0
    capsys.readouterr()
    (tmp_path / "board").mkdir()
    printed = usage_error(
        capsys, "leaderboard", "add", str(tmp_path / "s"), data, "--db", str(tmp_path / "board")
    )
    assert "board: cannot write" in printed


def test_clips_without_labels_need_a_number_for_a_method_that_cannot_find_it(tmp_path, capsys):
    name, clip = next(iter(CLIPS.items()))
    kt3dmoseg.save(clip.without_labels(), tmp_path / "data" / f"{name}.h5")
    command = ["run", str(tmp_path / "data"), "-o", str(tmp_path / "p"), "--method", "lsa"]
    assert mseg.cli.main(command) == 1
    assert "give --n-motions N" in capsys.readouterr().err
    assert mseg.cli.main([*command[:3], str(tmp_path / "q"), *command[4:], "--n-motions", "2"]) == 0
    assert "failed" not in capsys.readouterr().err


def test_places_that_cannot_be_written_are_reported_before_a_benchmark(tmp_path, capsys, monkeypatch):
    clips = str(tmp_path / "clips")
    kt3dmoseg.save(replace(CLIPS["example_two"], name="Seq005_Clip01"), f"{clips}/Seq005_Clip01.h5")
    monkeypatch.setattr(runner, "run_tasks", None)
    (tmp_path / "file").write_text("")
    line = ["benchmark", "kt3dmoseg", "--data", clips, "--methods", "one_motion"]
    for flag, value in (("--json", "file/a.json"), ("--cache", "file"), ("--kernels", "file")):
        assert "cannot write" in usage_error(capsys, *line, flag, str(tmp_path / value))


def test_data_next_to_files_of_scores_are_refused(data, tmp_path, capsys):
    scores = str(tmp_path / "scores.json")
    folder = perfect(tmp_path / "s")
    assert mseg.cli.main(["score", str(folder), data, "--json", "-o", scores]) == 0
    assert "--data: expected none for files of scores" in usage_error(capsys, "compare", scores, scores, data)


def test_it_is_noted_who_was_given_the_number_of_motions(data, tmp_path, capsys):
    for name, given in (("one", True), ("two", False)):
        perfect(tmp_path / name, meta=SubmissionMeta(name, n_motions_given=given))
    assert mseg.cli.main(["compare", str(tmp_path / "one"), str(tmp_path / "two"), data]) == 0
    assert "Number of motions found by two, given to the others." in capsys.readouterr().out
