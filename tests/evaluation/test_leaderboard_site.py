"""Published results as a page, and submissions among them."""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmark_result import benchmark_result

import mseg.cli
from kt3dmoseg.errors import InputFileError, InvalidValueError
from kt3dmoseg.io import save
from kt3dmoseg.types import Clip, Labels, Trajectories
from mseg.benchmark import Configuration
from mseg.benchmark.publishing import publish, read_results
from mseg.benchmark.site import check_submissions, submit, write_site
from mseg.evaluation import SubmissionMeta, load_protocol, write_submission
from mseg.evaluation.site import DataRows, Row

CLIPS = {"Seq005_Clip01": 3, "Seq013_Clip01": 2}


@pytest.fixture
def results(tmp_path):
    """Errors: coreg and subset alike to two decimals, keradd failed once, all lost by one_motion."""
    names = ("subset", "coreg", "keradd", "one_motion")
    errors = np.array([0.1, 0.10001, 0.02, 0.6])[:, None, None] * np.ones((1, 2, 2))
    made, failed = tuple(map(Configuration, names)), {("keradd", "Seq013_Clip01", 0): "no <luck>"}
    some = {"scored": (100_000, 100_000), "found": np.full((4, 2, 2), 2), "failed": failed}
    run = benchmark_result("kt3dmoseg", made, CLIPS, errors, **some)
    half = benchmark_result("kt3dmoseg", made, CLIPS, errors / 2, **some)
    folder = tmp_path / "results"
    publish(run, folder)
    publish(replace(half, number="found"), folder)
    return folder


@pytest.fixture
def data(tmp_path):
    """Clips of the benchmark's names with five trajectories each, and frames of one of them."""
    folder = tmp_path / "data"
    folder.mkdir()
    for name in CLIPS:
        xy = np.random.default_rng(0).uniform(0, 50, size=(5, 3, 2))
        tracks = Trajectories(xy, np.ones((5, 3), dtype=bool), image_size=(64, 60))
        save(Clip(name, tracks, np.arange(5), Labels(np.array([1, 1, 1, 2, 0]))), folder / f"{name}.h5")
    return folder


def submission(folder, data, method="mine", wrong=0):
    from kt3dmoseg.io import load_dataset

    label = np.array([1] * (3 - wrong) + [2] * (2 + wrong))
    meta = SubmissionMeta(method, ("A. <b>",), link="https://x.org/paper", seconds=4.0, supervised=True)
    clips = load_dataset(data)
    return write_submission(folder, clips.values(), dict.fromkeys(clips, label), meta)


def rows(page):
    cells = re.findall(r"<tr class='[^']*' data-row='[^']*'.*?</tr>", page, re.DOTALL)
    found = [re.search(r"<td>([\d-]+)</td><th scope='row'>(?:<a[^>]*>)?([\w-]+)", cell) for cell in cells]
    return [(match[1], match[2]) for match in found]


def test_ranks_are_per_protocol_and_shared_by_what_prints_alike(results, tmp_path):
    page = write_site(results, tmp_path / "site").read_text()
    ours = [("1", "coreg"), ("1", "subset"), ("3", "one_motion"), ("-", "keradd")]
    assert rows(page)[:8] == ours * 2
    assert ("-", "CoReg") in rows(page)[8:]  # printed in the paper, on all clips: no rank
    assert page.count("printed</span>") == len(load_protocol("kt3dmoseg").published)
    assert "2 of 22 clips" in page
    assert "no <luck>" not in page
    assert "http" not in page.replace("http-equiv", "")


def test_what_may_be_as_good_as_the_best():
    rng = np.random.default_rng(0)
    best = Row("best", rng.uniform(0.1, 0.2, (20, 1)))
    alike = Row("alike", best.errors + rng.normal(0.001, 0.02, (20, 1)))
    worse = Row("worse", best.errors + 0.01)
    board = DataRows("k", "", load_protocol("kt3dmoseg"), {}, [worse, alike, best])
    assert [(row.name, near) for _, row, near in board.ranked] == [
        ("best", True),
        ("alike", True),
        ("worse", False),
    ]


def test_pooled_means_weigh_clips_by_their_trajectories():
    assert Row("x", np.array([[0.1], [0.3]]), [100, 300]).summary.pooled == pytest.approx(0.25)


def test_earlier_versions_come_from_git(results, tmp_path):
    def git(*arguments):
        subprocess.run(
            ["git", "-C", tmp_path, "-c", "user.name=n", "-c", "user.email=e", *arguments], check=True
        )

    path = results / "kt3dmoseg" / "2018" / "subset.json"
    now = path.read_text()
    assert "No history" in write_site(results, tmp_path / "s").read_text()
    git("init", "-q")
    for text in ("{}", now.replace("10000, 10000", "40000, 40000"), now):
        path.write_text(text)
        git("add", "results")
        git("commit", "-qm", "x")
    page = write_site(results, tmp_path / "s").read_text()
    (table,) = re.findall(r"Earlier versions.*?</table>", page, re.DOTALL)
    assert re.findall(r"<td>([^<]*)</td>", table) == [
        "40.00",
        "-30.00",
        table.split("<td>")[3].split("<")[0],
        "-",
        "-",
        "in a former format",
    ]


def test_pictures_where_frames_are_at_hand(data, tmp_path):
    submit(submission(tmp_path / "m", data), data, tmp_path / "r")
    frames = tmp_path / "frames" / "Seq005_Clip01"
    frames.mkdir(parents=True)
    from PIL import Image

    for i in range(3):
        Image.new("L", (64, 60), 90).save(frames / f"{i + 1:06}.png")
    page = write_site(tmp_path / "r", tmp_path / "s", data=[data], frames=frames.parent).read_text()
    assert page.count("data:image/jpeg") == page.count("class='thumb'") == 1
    assert "class='thumb'" not in write_site(tmp_path / "r", tmp_path / "s", data=[data]).read_text()


def test_a_submission_is_listed_and_scored_again(data, tmp_path):
    paths = submit(submission(tmp_path / "m", data, wrong=1), data, tmp_path / "r")
    assert [path.suffix for path in paths] == [".json", ".zip"]
    (result,) = next(iter(read_results(tmp_path / "r").values()))
    assert (result.authors, result.supervised, result.seconds) == (["A. <b>"], True, 4.0)
    assert check_submissions(tmp_path / "r", [data]) == (1, [])
    page = write_site(tmp_path / "r", tmp_path / "s").read_text()
    assert "A. &lt;b&gt;" in page
    assert "href='https://x.org/paper'" in page
    again = submit(paths[1], data, tmp_path / "r2")  # the zip is a submission as well
    assert again[0].read_bytes() == paths[0].read_bytes()


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ('"wrong": [1]', '"wrong": [0]', r"clips.Seq005_Clip01.wrong: stated \[0\], scored again \[1\]"),
        ('"supervised": true', '"supervised": false', "supervised: stated False, scored again True"),
        ('"n_motions": "given"', '"n_motions": "found"', "n_motions: stated 'found', scored again 'given'"),
        ('"title": "mine"', '"title": "best"', "title: stated 'best', scored again 'mine'"),
    ],
)
def test_a_figure_that_the_predictions_do_not_give_is_found(data, tmp_path, capsys, old, new, field):
    path, _ = submit(submission(tmp_path / "m", data, wrong=1), data, tmp_path / "r")
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    assert mseg.cli.main(["leaderboard", "check", str(tmp_path / "r"), "--data", str(data)]) == 1
    out, err = capsys.readouterr()
    assert re.search(f"mine.json: {field}", out)
    assert err == "1 submission checked, 1 fault\n"


def test_scores_without_predictions_and_predictions_without_scores_are_found(data, tmp_path):
    path, packed = submit(submission(tmp_path / "m", data), data, tmp_path / "r")
    shutil.move(packed, tmp_path / "away.zip")
    assert "expected its predictions" in check_submissions(tmp_path / "r", [data])[1][0]
    shutil.move(tmp_path / "away.zip", packed)
    path.unlink()
    assert "expected the scores of mine.zip" in check_submissions(tmp_path / "r", [data])[1][0]
    with pytest.raises(InputFileError, match="expected results as BENCHMARK"):
        check_submissions(tmp_path / "none")


def test_every_rejected_file_is_listed_and_the_others_are_checked(data, tmp_path, capsys):
    path, packed = submit(submission(tmp_path / "m", data, wrong=1), data, tmp_path / "r")
    path.with_name("a.json").write_text("{}")
    for name in ("b", "c"):
        path.with_name(f"{name}.json").write_bytes(path.read_bytes())
        packed.with_name(f"{name}.zip").write_bytes(b"no zip")
    path.write_text(path.read_text().replace('"wrong": [1]', '"wrong": [0]', 1))
    assert mseg.cli.main(["leaderboard", "check", str(tmp_path / "r"), "--data", str(data)]) == 1
    out, err = capsys.readouterr()
    assert [Path(line.split(":")[0]).stem for line in out.splitlines()] == ["a", "b", "c", "mine"]
    assert err == "3 submissions checked, 4 faults\n"


def test_a_submission_replaces_its_own_row_and_no_other(data, tmp_path):
    mine, results = submission(tmp_path / "m", data), tmp_path / "r"
    _, packed = submit(mine, data, results)
    submit(mine, data, results)
    packed.unlink()  # as rows of the toolkit have none
    with pytest.raises(InvalidValueError, match="choose another name"):
        submit(mine, data, results)
    submit(submission(tmp_path / "a", data, "the one"), data, results)
    with pytest.raises(InvalidValueError, match="that of the one"):  # its file has the same name
        submit(submission(tmp_path / "b", data, "the-one"), data, results)


def test_commands(data, tmp_path, capsys):
    line = [
        "leaderboard",
        "submit",
        str(submission(tmp_path / "m", data)),
        str(data),
        "-o",
        str(tmp_path / "r"),
    ]
    assert mseg.cli.main(line) == 0
    assert mseg.cli.main(["leaderboard", "site", str(tmp_path / "r"), "-o", str(tmp_path / "s")]) == 0
    assert (tmp_path / "s" / "index.html").is_file()
    assert mseg.cli.main(["leaderboard", "site", str(tmp_path / "s"), "-o", str(tmp_path / "t")]) == 2
    assert json.loads(next((tmp_path / "r").glob("*/*/*.json")).read_text())["authors"] == ["A. <b>"]


@pytest.mark.browser
def test_figures_belong_to_their_clips_in_whatever_order_a_file_has_them(results, tmp_path):
    [path] = results.glob("*/*/coreg-found.json")
    before = write_site(results, tmp_path / "before").read_text()
    turned = json.loads(path.read_text())
    turned["clips"] = dict(reversed(turned["clips"].items()))
    path.write_text(json.dumps(turned))
    assert write_site(results, tmp_path / "after").read_text() == before


def test_filters_ranks_and_links_in_chromium(results, tmp_path, browser):
    from playwright.sync_api import expect

    path = write_site(results, tmp_path / "site")
    page = browser.new_context(viewport={"width": 390, "height": 800}, offline=True).new_page()
    messages = []
    page.on("pageerror", lambda error: messages.append(str(error)))
    page.goto(path.as_uri())
    shown = page.locator("table.board tbody tr:visible")

    def listed():
        return [text.split()[:2] for text in shown.all_inner_texts()]

    page.locator("select[name=number]").select_option("found")
    assert listed() == [["1", "coreg"], ["1", "subset"], ["3", "one_motion"], ["-", "keradd"]]
    page.locator("select[name=kind]").select_option("measured")
    page.locator("input[name=name]").fill("sub")
    assert listed() == [["1", "subset"]]
    address = page.url
    page.goto("about:blank")
    page.goto(address)
    assert listed() == [["1", "subset"]]
    shown.locator("a").first.click()
    assert page.locator("details.row[open]").inner_text().startswith("subset, number found: 5.00 %")
    assert listed() == [["1", "subset"]]  # as the address still says
    assert "name=sub" in page.url
    page.goto(page.url.partition("#")[0] + "#board-1")
    expect(shown).to_have_count(8 + len(load_protocol("kt3dmoseg").published))
    page.goto(address)
    page.locator("button[type=reset]").click()
    page.locator("input[name=name]").fill("50% of")
    page.reload()
    assert page.locator("input[name=name]").input_value() == "50% of"
    page.locator("button[type=reset]").click()
    expect(shown).to_have_count(8 + len(load_protocol("kt3dmoseg").published))
    page.locator("select[name=unit]").select_option("trajectory")
    assert shown.nth(0).inner_text().split() == ["1", "coreg", "10.00"]
    expect(page.locator("table.board td.track:visible")).to_have_count(0)
    page.locator("select[name=unit]").select_option("")
    page.locator("table.board th button", has_text="mean").click()
    assert listed()[0][1] == "keradd"
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert messages == []
    page.context.close()
