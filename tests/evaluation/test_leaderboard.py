import json
import re
import sqlite3
import subprocess
import sys
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from evaluation_helpers import CLIPS, perfect, truth

import kt3dmoseg
import mseg
import mseg.cli
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError, UnknownNameError
from kt3dmoseg.types import Labels
from mseg.evaluation import SubmissionMeta, leaderboard, score, score_submission, write_submission
from mseg.evaluation.leaderboard import Leaderboard, export
from mseg.evaluation.scoring import Provenance, from_json, to_json


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


@pytest.mark.browser
def test_the_page_ranks_boards_of_one_benchmark_apart(board, tmp_path, browser):
    small = {"example_two": CLIPS["example_two"]}
    for method, wrong in (("a0", 0), ("a3", 3)):
        board.add(scored(tmp_path, method, wrong))
    for method, wrong in (("p5", 5), ("p7", 7)):
        folder = write_submission(
            tmp_path / method, small.values(), {"example_two": wronged(wrong)}, SubmissionMeta(method)
        )
        board.add(score_submission(folder, small))
    export(board, tmp_path / "board.html")
    page = browser.new_page()
    page.goto((tmp_path / "board.html").as_uri())
    rows = page.locator("table.board tbody tr").all_inner_texts()
    assert [row.split()[:2] for row in rows] == [["1", "a0"], ["2", "a3"], ["1", "p5"], ["2", "p7"]]
    page.close()


def wronged(wrong):
    label = truth()["example_two"]
    label[:wrong] = 3 - label[:wrong]
    return label


def test_a_clip_without_labels_among_the_data_changes_nothing(board, tmp_path):
    clip = CLIPS["example_two"]
    bare = replace(clip, name="bare", labels=Labels(0 * clip.labels.label))
    folder = write_submission(tmp_path / "m", CLIPS.values(), truth(), SubmissionMeta("m"))
    scores = score_submission(folder, {**CLIPS, "bare": bare})
    board.add(scores)
    assert [entry.method for _, entry in board.boards()[0].ranked] == ["m"]
    assert from_json(json.dumps(to_json(scores))).names == scores.names


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
    assert "1 of 22 clips, a part" in board.boards("kt3dmoseg")[0].rows.about
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
    assert mseg.cli.main(["leaderboard", "rank", "--db", db, "--benchmark", "hopkins12"]) == 0
    assert capsys.readouterr().out == "no entries of hopkins12\n"
    assert mseg.cli.main(["leaderboard", "export", "--db", db, "-o", str(tmp_path / "b.html")]) == 0
    assert mseg.cli.main(["leaderboard", "rank", "--db", str(tmp_path / "no")]) == 2
    assert mseg.cli.main(["leaderboard", "add", folder, "--db", db]) == 2


def claim(scores, change=lambda s: None):
    content = to_json(scores)
    change(content)
    return from_json(json.dumps(content))


def test_claimed_scores_are_marked_until_they_are_computed_here(board, tmp_path):
    scores = scored(tmp_path, "one", 1)
    assert board.add(claim(scores), claimed=True) == (1, True)
    assert board.boards()[0].table().rows[0][6] == "claimed"
    assert board.add(scores) == (1, True)
    assert [e.claimed for e in board.entries()] == [0]
    assert board.boards()[0].table().rows[0][6] == "here"
    assert board.add(claim(scores), claimed=True) == (1, False)


def better(content):
    for clip in content["clips"]:
        clip["values"]["error"] = 0.0
    for group in content["groups"].values():
        group["metrics"]["error"].update(mean=0.0, median=0.0, pooled=0.0)


def fewer(content):
    del content["clips"][0]
    del content["groups"], content["coverage"]
    content["provenance"]["submission_sha256"] = "0" * 64


@pytest.mark.parametrize(("change", "word"), [(better, "other errors"), (fewer, "other clips")])
def test_a_claim_that_an_entry_contradicts_is_refused(board, tmp_path, change, word):
    scores = scored(tmp_path, "one", 3)
    board.add(scores)
    with pytest.raises(InvalidValueError, match=f"entry 1.*{word}"):
        board.add(claim(scores, change), claimed=True)


def test_a_claim_on_fewer_clips_has_no_rank_beside_a_complete_one(board, tmp_path):
    scores = scored(tmp_path, "one", 3)
    board.add(claim(scores, fewer), claimed=True)
    board.add(scores)
    assert [(rank, e.clips) for rank, e in board.boards()[0].ranked] == [(1, 2), (None, 1)]


def test_the_page_ranks_as_the_table_where_a_claim_is_of_other_clips(board, tmp_path):
    scores = scored(tmp_path, "one", 3)
    board.add(claim(scores), claimed=True)
    board.add(claim(scores, fewer))
    export(board, tmp_path / "b.html")
    page = (tmp_path / "b.html").read_text()
    assert [(rank, e.claimed) for rank, e in board.boards()[0].ranked] == [(1, 0), (None, 1)]
    assert re.findall(r"<td>(1|-)</td><th scope='row'>.*?(claimed|</th>)", page, re.DOTALL) == [
        ("1", "</th>"),
        ("-", "claimed"),
    ]


def test_equal_to_two_decimals_is_equal_in_rank(board, tmp_path):
    for i, mean in enumerate((0.10001, 0.1, 0.2)):
        table = score([1, 1, 2, 2, 2], [1, 1, 2, 2, 2])
        source = Provenance("v", "0" * 64, str(i) * 64, "1")
        board.add(replace(table, provenance=source, clips=(shifted(table.clips[0], mean),)))
    assert [rank for rank, _ in board.boards()[0].ranked] == [1, 1, 3]


def shifted(clip, error):
    return replace(clip, n=100_000, values={**clip.values, "error": error})


def test_methods_that_found_the_number_are_ranked_apart_and_notes_are_shown(board, tmp_path):
    board.add(scored(tmp_path, "given", 3))
    meta = SubmissionMeta("finder", n_motions_given=False, notes={"example_two": "it did not converge"})
    board.add(score_submission(perfect(tmp_path / "f", meta=meta), CLIPS))
    [only] = board.boards()
    assert [(rank, e.method) for rank, e in only.ranked] == [(1, "given"), (1, "finder")]
    note = "The method reports on example_two: it did not converge."
    assert f"finder: {note}" in only.table().text()
    export(board, tmp_path / "b.html")
    assert note in (tmp_path / "b.html").read_text()


def test_entries_are_replaced_and_removed(board, tmp_path):
    one, two, three = (scored(tmp_path, name, i) for i, name in enumerate(("one", "two", "three")))
    board.add(one)
    board.add(two)
    assert board.add(three, replace=1) == (1, True)
    assert [e.method for e in board.entries()] == ["three", "two"]
    assert board.add(two, replace=1) == (1, True)  # it is kept once
    assert [e.method for e in board.entries()] == ["two"]
    board.remove(1)
    assert board.entries() == []
    for call in (lambda: board.remove(1), lambda: board.add(one, replace=7)):
        with pytest.raises(InputFileError, match="none of that number"):
            call()


def truncated(path):
    path.write_bytes(path.read_bytes()[:5000])


def zeroed(path):
    content = path.read_bytes()
    path.write_bytes(content[:4096] + bytes(len(content) - 4096))


def headless(path):
    path.write_bytes(bytes(16) + path.read_bytes()[16:])


def emptied(path):
    path.write_bytes(b"")


def another_number(path):
    content = path.read_bytes()
    path.write_bytes(content.replace(b'"error": 0.05', b'"error": 0.00', 1))


def no_text(path):
    content = path.read_bytes()
    path.write_bytes(content.replace(b"one", b"\xff\xfe\xfd", 1))


def no_column(path):
    with sqlite3.connect(path) as connection:
        connection.execute("ALTER TABLE entries DROP COLUMN median")
    connection.close()


def another_type(path):
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE entries SET mean = 'best'")
    connection.close()


def too_long(path):
    with sqlite3.connect(path) as connection:
        connection.execute(f"UPDATE entries SET sha256 = '', scores = zeroblob({17 << 20})")
    connection.close()


def no_table(path):
    with sqlite3.connect(path) as connection:
        connection.execute("DROP TABLE entries")
    connection.close()


@pytest.mark.parametrize(
    "damage",
    [truncated, zeroed, too_long, no_table, headless, another_number, another_type, no_text, no_column],
)
def test_a_damaged_leaderboard_is_called_damaged(board, tmp_path, damage):
    board.add(scored(tmp_path, "one", 2))
    before = board.path.read_bytes()
    damage(board.path)
    assert board.path.read_bytes() != before
    with pytest.raises(FileFormatError, match="damaged"):
        Leaderboard(board.path, create=False).boards()


def test_an_emptied_leaderboard_is_no_leaderboard(board):
    emptied(board.path)
    with pytest.raises(FileFormatError, match="leaderboard"):
        Leaderboard(board.path, create=False)


def test_reading_writes_nothing_and_waits_for_no_writer(board, tmp_path, monkeypatch):
    board.add(scored(tmp_path, "one", 2))
    monkeypatch.setattr(leaderboard, "_WAIT_SECONDS", 0.01)
    with closing(sqlite3.connect(board.path, isolation_level=None)) as writer:
        writer.execute("BEGIN IMMEDIATE")
        assert Leaderboard(board.path, create=False).boards()[0].ranked[0][1].method == "one"
        with pytest.raises(InputFileError, match="locked; another process"):
            board.remove(1)


def test_a_leaderboard_of_another_version_is_refused_with_what_to_do(board, tmp_path):
    board.add(scored(tmp_path, "one", 2))
    for version in (1, 3):
        with sqlite3.connect(board.path) as connection:
            connection.execute(f"PRAGMA user_version = {version}")
        connection.close()
        with pytest.raises(FileFormatError, match=f"found version {version}; add the submissions to a new"):
            Leaderboard(board.path)


def claims():
    """Ways in which a file of scores cannot be true, by name."""

    def first(**changes):
        return lambda s: s["clips"][0].update(changes)

    def value(**changes):
        return lambda s: s["clips"][0]["values"].update(changes)

    def summary(kind):
        return lambda s: s["groups"]["all"]["metrics"]["error"].update({kind: 0.125})

    return {
        "seed as text": first(seed="0"),
        "negative seed": first(seed=-1),
        "no trajectories": first(n=0),
        "400 digits": first(n=10**400),
        "NaN": value(error=float("nan")),
        "infinite": value(nmi=float("inf")),
        "text": value(error="0.1"),
        "missing metric": lambda s: s["clips"][0]["values"].pop("nmi"),
        "unknown metric": value(foo=0.5),
        "clip's name of two lines": first(clip="a\nb"),
        "clip's name that leads elsewhere": first(clip="../a"),
        "control characters": lambda s: s["meta"].update(method="a\x1b[31m"),
        "two lines": lambda s: s["meta"].update(authors=["a\nb"]),
        "other error than of whole trajectories": value(error=0.01),
        "count error": value(count_error=3.0),
        "groups found": first(n_found=7),
        "motions": first(n_motions=5),
        "prevalence": first(prevalence=0.111),
        "failed without error": first(reason="too hard"),
        "clip twice": lambda s: s["clips"].append(s["clips"][0]),
        "one clip in one seed more": lambda s: s["clips"].append(s["clips"][0] | {"seed": 7}),
        "unknown benchmark": lambda s: s.update(benchmark="foo"),
        "another benchmark": lambda s: s.update(benchmark="kt3dmoseg"),
        "a benchmark of any clips": lambda s: s.update(benchmark="hopkins155"),
        "seeds": lambda s: s.update(seeds=[0, 1, 2]),
        "coverage": lambda s: s.update(coverage="22 of 22 clips"),
        "complete": lambda s: s.update(complete=False),
        "mean": summary("mean"),
        "median": summary("median"),
        "hash": lambda s: s["provenance"].update(dataset_sha256="x"),
        "no provenance": lambda s: s.pop("provenance"),
        "no method": lambda s: s["meta"].update(method=""),
        "negative seconds": lambda s: s["meta"].update(seconds=-1.0),
    }


@pytest.mark.parametrize("kind", claims())
def test_scores_that_cannot_be_true_are_refused_in_one_line(tmp_path, kind):
    scores = scored(tmp_path, "one", 2)
    assert claim(scores).error == scores.error
    with pytest.raises(FileFormatError, match="scores that 'mseg score' wrote") as caught:
        claim(scores, claims()[kind])
    assert "\n" not in str(caught.value)


def test_a_claim_on_another_version_of_the_data_is_refused(tmp_path):
    clip = CLIPS["example_two"]
    named = kt3dmoseg.Clip("Seq005_Clip01", clip.dense, clip.evaluated, clip.labels)
    folder = write_submission(tmp_path / "s", [named], {named.name: clip.labels.label}, SubmissionMeta("m"))
    scores = score_submission(folder, [named])
    with pytest.raises(FileFormatError, match="dataset version '2018'"):
        claim(scores, lambda s: s["provenance"].update(dataset_version="2018"))


def test_a_misspelt_benchmark_is_refused(board, tmp_path):
    board.add(scored(tmp_path, "one", 1))
    assert board.boards("custom")
    with pytest.raises(UnknownNameError, match="did you mean 'kt3dmoseg'"):
        board.boards("kt3dmosegg")


def test_bare_scores_of_two_predictions_are_two_entries(board):
    clip = CLIPS["example_two"]
    wrong = np.where(np.arange(len(clip.labels)) < 3, 2, clip.labels.label)
    assert board.add(mseg.score(clip, clip.labels)) == (1, True)
    assert board.add(mseg.score(clip, wrong)) == (2, True)
    assert board.add(mseg.score(clip, wrong)) == (2, False)
