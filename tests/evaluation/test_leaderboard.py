import json
import re
import sqlite3
import subprocess
import sys

import pytest
from evaluation_helpers import CLIPS, perfect, truth

import kt3dmoseg
import mseg.cli
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.types import Labels
from mseg.evaluation import SubmissionMeta, score_submission, write_submission
from mseg.evaluation.leaderboard import Leaderboard, export


def scored(folder, method, wrong, clips=CLIPS):
    """Score a submission with `wrong` wrong labels in one clip."""
    pred = truth()
    pred["example_two"][:wrong] = 3 - pred["example_two"][:wrong]
    return score_submission(
        write_submission(folder / method, clips.values(), pred, SubmissionMeta(method)), clips
    )


@pytest.fixture
def board(tmp_path):
    return Leaderboard(tmp_path / "board.sqlite")


def test_best_first_with_provenance(board, tmp_path):
    for method, wrong in (("worse", 6), ("best", 0), ("middle", 3), ("as middle", 3)):
        assert board.add(scored(tmp_path, method, wrong))[1]
    (only,) = board.boards()
    assert [(rank, e.method) for rank, e in only.ranked] == [
        (1, "best"),
        (2, "middle"),
        (2, "as middle"),
        (4, "worse"),
    ]
    entry = only.ranked[0][1]
    assert (entry.clips, entry.failed, entry.seeds) == (2, 0, 1)
    assert all(re.fullmatch("[0-9a-f]{64}", h) for h in (entry.dataset_sha256, entry.submission_sha256))
    assert entry.toolkit_version == kt3dmoseg.__version__
    assert board.scores(entry.id).error == 0


def test_the_same_submission_is_kept_once(board, tmp_path):
    scores = scored(tmp_path, "one", 1)
    assert board.add(scores) == (1, True)
    assert board.add(scores) == (1, False)
    assert len(board.entries()) == 1


def test_partial_or_failed_never_ranks_above_complete(board, tmp_path):
    folder = perfect(tmp_path / "partial", meta=SubmissionMeta("partial"))
    (folder / "example_two.csv").unlink()
    partial = score_submission(folder, CLIPS)
    board.add(partial)
    poor = scored(tmp_path, "poor", 40)  # with both motions of one clip exchanged it is perfect, so:
    terrible = scored(tmp_path, "terrible", 20)
    board.add(terrible)
    board.add(poor)
    ranked = board.boards()[0].ranked
    assert partial.error > terrible.error or ranked[-1][1].method == "partial"
    assert ranked[-1] == (None, ranked[-1][1])
    assert [rank for rank, e in ranked if e.method != "partial"] == [1, 2]


def test_different_data_are_ranked_apart(board, tmp_path):
    clip = CLIPS["example_two"]
    other = {**CLIPS, "example_two": clip.with_labels(Labels(clip.labels.label[::-1].copy()))}
    board.add(scored(tmp_path, "a", 0))
    board.add(scored(tmp_path / "o", "b", 0, other))
    assert [len(b.ranked) for b in board.boards()] == [1, 1]
    part = {"Seq005_Clip01": kt3dmoseg.Clip("Seq005_Clip01", clip.dense, clip.evaluated, clip.labels)}
    labels = {"Seq005_Clip01": clip.labels.label}
    folder = write_submission(tmp_path / "p", part.values(), labels, SubmissionMeta("p"))
    board.add(score_submission(folder, part))
    assert "1 of 22 clips, a part" in board.boards("kt3dmoseg")[0].about
    assert len(board.boards()) == 3


def test_adds_from_several_processes_lose_nothing(tmp_path):
    """Each process makes the file if it is first, and adds its own."""
    path, each, workers = tmp_path / "board.sqlite", 5, 3
    code = (
        "import sys, dataclasses as d\n"
        "from mseg.evaluation import score\n"
        "from mseg.evaluation.leaderboard import Leaderboard\n"
        "from mseg.evaluation.scoring import Provenance\n"
        "worker = int(sys.argv[1])\n"
        f"for i in range({each}):\n"
        "    table = score(truth=[1, 1, 2], pred=[1, 2, 2])\n"
        "    table = d.replace(table, provenance=Provenance('v', 'data', f'{worker}-{i}', '1'))\n"
        f"    assert Leaderboard({str(path)!r}).add(table)[1]\n"
    )
    running = [subprocess.Popen([sys.executable, "-c", code, str(w)]) for w in range(workers)]
    assert [p.wait(timeout=300) for p in running] == [0] * workers
    entries = Leaderboard(path, create=False).entries()
    assert len({e.submission_sha256 for e in entries}) == each * workers
    assert sorted(e.id for e in entries) == list(range(1, each * workers + 1))


def test_other_files_are_left_alone(tmp_path):
    text = tmp_path / "notes.txt"
    text.write_text("these are no scores, " * 100)
    with pytest.raises(FileFormatError, match="leaderboard"):
        Leaderboard(text)
    assert text.read_text().startswith("these are")
    with sqlite3.connect(tmp_path / "other.db") as other:
        other.execute("CREATE TABLE x (y)")
    other.close()
    with pytest.raises(FileFormatError, match="leaderboard"):
        Leaderboard(tmp_path / "other.db")
    with pytest.raises(InputFileError, match="no such file"):
        Leaderboard(tmp_path / "none.sqlite", create=False)
    with pytest.raises(InputFileError, match="entry 7"):
        Leaderboard(tmp_path / "new.sqlite").scores(7)


def test_export(board, tmp_path):
    board.add(scored(tmp_path, "<script>alert(1)", 2))
    export(board, tmp_path / "b.html")
    export(board, tmp_path / "b.md")
    page = (tmp_path / "b.html").read_text()
    assert "&lt;script&gt;alert(1)" in page
    assert "<script>alert" not in page
    assert "http" not in re.sub(r"http-equiv", "", page)
    assert "| 1 | <script>alert(1) | 2.50 |" in (tmp_path / "b.md").read_text()
    with pytest.raises(InvalidValueError, match=r"\.html or \.md"):
        export(board, tmp_path / "b.pdf")


def test_command(tmp_path, capsys):
    for name, clip in CLIPS.items():
        kt3dmoseg.save(clip, tmp_path / "data" / f"{name}.h5")
    folder, data, db = str(perfect(tmp_path / "s")), str(tmp_path / "data"), str(tmp_path / "b.sqlite")
    scores = str(tmp_path / "s.json")
    assert mseg.cli.main(["score", folder, data, "--json", "-o", scores]) == 0
    assert mseg.cli.main(["leaderboard", "add", folder, data, "--db", db]) == 0
    assert "added: entry 1, tested, complete" in capsys.readouterr().out
    assert mseg.cli.main(["leaderboard", "add", scores, "--db", db]) == 0
    assert "already there: entry 1" in capsys.readouterr().out
    for action in ("list", "rank"):
        assert mseg.cli.main(["leaderboard", action, "--db", db]) == 0
        assert "tested" in capsys.readouterr().out
    assert mseg.cli.main(["leaderboard", "list", "--db", db, "--json"]) == 0
    [entry] = json.loads(capsys.readouterr().out)
    assert (entry["method"], entry["clips"], entry["failed"]) == ("tested", 2, 0)
    assert mseg.cli.main(["leaderboard", "rank", "--db", db, "--json"]) == 0
    [board] = json.loads(capsys.readouterr().out)
    assert board["ranked"] == [[1, entry]]
    assert mseg.cli.main(["leaderboard", "export", "--db", db, "-o", str(tmp_path / "b.html")]) == 0
    assert mseg.cli.main(["leaderboard", "rank", "--db", str(tmp_path / "no")]) == 2
    assert mseg.cli.main(["leaderboard", "add", folder, "--db", db]) == 2
