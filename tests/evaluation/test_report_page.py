import base64
import csv
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest
from evaluation_helpers import CLIPS, META, NAMES, perfect, truth

import kt3dmoseg
import mseg.cli
from kt3dmoseg.errors import InputFileError, InvalidValueError
from kt3dmoseg.types import Clip, Labels
from mseg.errors import RejectedSubmissionError
from mseg.evaluation import SubmissionMeta, report, score_submission, write_failure, write_submission
from mseg.evaluation.report import write_report
from mseg.evaluation.results import ResultsTable, headline, per_clip, rendered, unique_names


@pytest.fixture
def submission(tmp_path):
    """Two seeds, one clip partly wrong."""
    worse = truth()
    worse["example_two"][:10] = 9
    return write_submission(
        tmp_path / "s",
        CLIPS.values(),
        {0: truth(), 1: worse},
        SubmissionMeta("<b>mine</b>", link="https://x.org/<a>"),
    )


def frames(folder: Path, *, lacking: int = 0) -> Path:
    for name, clip in CLIPS.items():
        (folder / name).mkdir(parents=True)
        for i in range(clip.n_frames - lacking):
            cv2.imwrite(str(folder / name / f"{i + 1:06}.png"), np.full((240, 320), 20 * i, np.uint8))
    return folder


class Page(HTMLParser):
    def __init__(self, content: str) -> None:
        super().__init__()
        self.tags, self.open, self.links, self.text = [], [], [], ""
        self.feed(content)

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        self.tags.append((tag, values))
        self.links += [values[k] for k in ("src", "href") if values.get(k)]
        if tag not in ("meta", "link", "input", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def payloads(content: str) -> list[dict]:
    return [json.loads(t) for t in re.findall(r"<script type='application/json'>(.*?)</script>", content)]


def test_page_is_complete_and_needs_nothing_else(submission, tmp_path):
    (path,) = write_report(submission, CLIPS, tmp_path / "r.html", frames=frames(tmp_path / "f"))
    content = path.read_text()
    page = Page(content)
    assert page.open == []
    anchors = {v["id"] for _, v in page.tags if "id" in v}
    for link in page.links:
        assert link.startswith("data:") or link[1:].split("&")[0] in anchors, link
    assert "default-src 'none'" in content
    assert "<b>mine" not in content
    assert "&lt;b&gt;mine" in content


def test_worst_clip_first_with_its_errors(submission, tmp_path):
    (path,) = write_report(submission, CLIPS, tmp_path / "r.html")
    content = path.read_text()
    sections = re.findall(r"<section class='clip' id='clip-(\w+)'", content)
    assert sections == ["example_two", "example_three"]
    first = payloads(content)[0]
    assert [len(first[k]) for k in ("runs", "numbers", "frames")] == [2, 10, 0]
    import base64

    wrong = [sum(base64.b64decode(run["wrong"])) for run in first["runs"]]
    assert wrong == [0, 10]
    assert len(base64.b64decode(first["xy"])) == 40 * 10 * 2 * 2


def test_frames_are_inside(submission, tmp_path):
    (path,) = write_report(submission, CLIPS, tmp_path / "r.html", frames=frames(tmp_path / "f"))
    for payload in payloads(path.read_text()):
        assert len(payload["frames"]) == 10
        assert all(f.startswith("data:image/jpeg;base64,") for f in payload["frames"])
    clips = {
        name: replace(clip, dense=replace(clip.dense, image_size=None)) for name, clip in CLIPS.items()
    }  # as in the release of 2018: then the size is that of the pictures
    (path,) = write_report(submission, clips, tmp_path / "r.html", frames=tmp_path / "f")
    assert [(p["width"], p["height"]) for p in payloads(path.read_text())] == [(320, 240)] * 2
    with pytest.raises(InputFileError, match="a folder of pictures per clip"):
        write_report(submission, CLIPS, tmp_path / "r.html", frames=tmp_path / "nowhere")
    with pytest.raises(InputFileError, match="10 frames"):
        write_report(submission, CLIPS, tmp_path / "r.html", frames=frames(tmp_path / "g", lacking=1))


def test_frames_of_a_clip_from_kitti_are_found_in_the_drive(submission, tmp_path):
    folder = tmp_path / "kitti/2011_09_26/2011_09_26_drive_0005_sync/image_00/data"
    folder.mkdir(parents=True)
    for i in range(30):
        cv2.imwrite(str(folder / f"{i:010}.png"), np.full((240, 320), 8 * i, np.uint8))
    source = {"kind": "kitti", "drive": "2011_09_26_drive_0005", "camera": 0}
    clips = {
        name: replace(
            clip,
            frame_numbers=np.arange(clip.n_frames) + 12,
            provenance={"inputs": {"source": source}} if name == "example_two" else {},
        )
        for name, clip in CLIPS.items()
    }
    (path,) = write_report(submission, clips, tmp_path / "r.html", frames=tmp_path / "kitti")
    assert [len(p["frames"]) for p in payloads(path.read_text())] == [10, 0]


def test_failed_clip_is_shown(tmp_path):
    folder = perfect(tmp_path / "s")
    (folder / "example_two.csv").unlink()
    write_failure(folder, CLIPS["example_two"], "no <luck>")
    (path,) = write_report(folder, CLIPS, tmp_path / "r.html")
    text = Page(path.read_text()).text
    assert "Counted as fully wrong" in text
    assert "no <luck>" in text
    rows = list(csv.DictReader(rendered(score_submission(folder, CLIPS), "csv").splitlines()))
    assert {row["clip"]: row["failed"] for row in rows} == {name: str(int("two" in name)) for name in CLIPS}
    (folder / "example_three.csv").write_text("track,label\n1,1.5\n")
    with pytest.raises(RejectedSubmissionError):
        write_report(folder, CLIPS, tmp_path / "r.html")
    write_report(folder, CLIPS, tmp_path / "r.html", force=True)


def test_published_results_and_prevalence_are_shown_and_a_partial_submission_is_marked(tmp_path):
    clip = CLIPS["example_two"]
    clips = {"Seq005_Clip01": Clip("Seq005_Clip01", clip.dense, clip.evaluated, clip.labels)}
    folder = write_submission(tmp_path / "s", clips.values(), {"Seq005_Clip01": clip.labels.label}, META)
    (path,) = write_report(folder, clips, tmp_path / "r.html")
    text = Page(path.read_text()).text
    assert "CoReg" in text
    assert "7.92" in text
    assert "1 of 22 clips" in text
    notes = " ".join(headline(score_submission(folder, clips)).notes)
    assert "A part of the benchmark" in notes
    assert "not comparable" in notes  # neither is it the data of 2018
    assert "50.00" in text  # prevalence of this clip


def test_tables_next_to_the_page(submission, tmp_path):
    wrote = write_report(
        submission, CLIPS, tmp_path / "out" / "r.html", extras=["latex", "markdown", "csv", "json"]
    )
    names = {p.name for p in wrote}
    davis = {"global_results-custom-r.csv", "per-sequence_results-custom-r.csv"}
    assert names == davis | {f"r.{ending}" for ending in ("html", "tex", "md", "csv", "json")}
    folder = tmp_path / "out"
    rows = list(csv.DictReader((folder / "per-sequence_results-custom-r.csv").read_text().splitlines()))
    assert [row["Sequence"] for row in rows] == NAMES
    assert [float(row["error-Mean"]) for row in rows] == [0, 10 / 40 / 2]
    (mean,) = csv.DictReader((folder / "global_results-custom-r.csv").read_text().splitlines())
    assert float(mean["error-Mean"]) == pytest.approx(10 / 40 / 2 / 2)
    assert r"\textless" not in (folder / "r.tex").read_text()
    assert json.loads((folder / "r.json").read_text())["format"] == "mseg-scores"


def test_layouts_escape():
    table = ResultsTable("T", ["a_b", "x|y"], [["50 %", "c,d"]], ["note"])
    assert r"a\_b & x|y \\" in table.latex()
    assert r"50 \% & c,d \\" in table.latex()
    assert "| a_b | x\\|y |" in table.markdown()
    assert table.csv() == 'a_b,x|y\n50 %,"c,d"\n'
    assert table.text().splitlines() == ["T", "", "a_b   x|y", "50 %  c,d", "note"]
    assert ResultsTable("T", ["a", "b"], []).text().splitlines() == ["T", "", "a  b"]


def test_a_label_has_its_own_colour_number_also_where_labels_between_are_missing(tmp_path):
    name, clip = next(iter(CLIPS.items()))
    label = np.where(clip.labels.label > 1, clip.labels.label + 4, clip.labels.label)
    sparse = {name: replace(clip, labels=Labels(label, background=1))}
    folder = write_submission(tmp_path / "s", sparse.values(), {name: label}, META)
    (path,) = write_report(folder, sparse, tmp_path / "r.html")
    (payload,) = payloads(path.read_text())
    coloured = set(base64.b64decode(payload["truth"])) | set(base64.b64decode(payload["runs"][0]["shown"]))
    assert coloured == set(label.tolist())
    assert payload["background"] == 1
    numbers = {int(n) for n in re.findall(r"data-colour='(\d+)'", path.read_text())}
    assert numbers == set(label[label > 0].tolist())


def test_background_unknown_and_few_labels(tmp_path):
    clip = CLIPS["example_two"].with_labels(Labels(np.where(np.arange(40) < 20, 0, 3)))
    folder = write_submission(
        tmp_path / "s", [clip], {clip.name: np.arange(40) % 3}, SubmissionMeta("m", outliers=True)
    )
    (path,) = write_report(folder, [clip], tmp_path / "r.html")
    assert "outlier" in Page(path.read_text()).text
    assert per_clip(score_submission(folder, [clip])).rows[0][2] == "1"


def test_command(submission, tmp_path, capsys):
    for name, clip in CLIPS.items():
        kt3dmoseg.save(clip, tmp_path / "data" / f"{name}.h5")
    out = tmp_path / "r.html"
    assert (
        mseg.cli.main(["report", str(submission), str(tmp_path / "data"), "-o", str(out), "--latex", "--csv"])
        == 0
    )
    assert out.exists()
    assert (tmp_path / "r.tex").exists()
    assert mseg.cli.main(["report", str(tmp_path / "none"), str(tmp_path / "data"), "-o", str(out)]) == 2


@pytest.fixture
def three(tmp_path):
    """Three submissions: right, ten errors in one clip, and failed in the other."""
    right, worse = perfect(tmp_path / "right"), truth()
    worse["example_two"][:10] = 9
    second = write_submission(tmp_path / "worse", CLIPS.values(), worse, SubmissionMeta("worse"))
    failed = perfect(tmp_path / "failed", meta=SubmissionMeta("failed"))
    (failed / "example_three.csv").unlink()
    write_failure(failed, CLIPS["example_three"], "no luck")
    return [right, second, failed]


def test_several_side_by_side(three, tmp_path):
    paths = write_report(three, CLIPS, tmp_path / "r.html", extras=["csv", "json"])
    assert len({path.name for path in paths}) == len(paths) == 1 + 3 * 4
    page = Page(paths[0].read_text())
    assert page.open == []
    for text in ("Counted as fully wrong", "no luck", "lower is better", "by 12.50 points"):
        assert text in page.text
    by_clip = dict(zip(*sections(paths[0]), strict=True))
    assert [run["method"] for run in by_clip["example_two"]["runs"]] == [0, 1, 2]
    assert [run["method"] for run in by_clip["example_three"]["runs"]] == [0, 1]  # no labels of the last
    wrong = [sum(base64.b64decode(run["wrong"])) for run in by_clip["example_two"]["runs"]]
    assert wrong == [0, 10, 0]


def sections(path):
    content = path.read_text()
    return re.findall(r"<section class='clip' id='clip-(\w+)'", content), payloads(content)


def test_equal_methods_are_not_said_to_differ(tmp_path):
    same = [perfect(tmp_path / name, meta=SubmissionMeta(name)) for name in ("one", "other")]
    (path,) = write_report(same, CLIPS, tmp_path / "r.html")
    content = path.read_text()
    assert "one and other have the same mean." in content
    assert "is better than" not in content
    assert content.count("data-differ='no'") == len(CLIPS)


def test_a_failed_clip_counts_in_every_bin_of_the_properties_of_its_trajectories(three, tmp_path):
    (path,) = write_report(three, CLIPS, tmp_path / "r.html")
    rows = re.findall(r"<tr data-bin='position\.\d'.*?</tr>", path.read_text(), re.DOTALL)
    cells = np.array([re.findall(r"<td>([\d.]+)</td>", row) for row in rows], dtype=float)
    wrong = np.rint(cells[:, 1:] / 100 * cells[:, :1]).sum(axis=0)
    assert cells[:, 0].sum() == sum(len(clip.labels) for clip in CLIPS.values())
    assert wrong.tolist() == [0, 10, len(CLIPS["example_three"].labels)]


def test_of_very_many_trajectories_a_share_of_each_motion_is_drawn(submission, tmp_path, monkeypatch):
    monkeypatch.setattr(report, "_POSITION_CHARACTERS", 2000)
    (path,) = write_report(submission, CLIPS, tmp_path / "r.html")
    content = path.read_text()
    for payload, name in zip(payloads(content), ("example_two", "example_three"), strict=True):
        drawn = np.frombuffer(base64.b64decode(payload["truth"]), np.uint8)
        assert 10 < len(drawn) == len(payload["ids"]) < 40
        assert len(base64.b64decode(payload["xy"])) == len(drawn) * 10 * 4
        assert sum(len(payload[key]) for key in ("xy", "truth")) < 2000
        shares = np.bincount(drawn)[1:] / np.bincount(CLIPS[name].labels.label)[1:]
        assert np.ptp(shares) < 0.1
        assert f"{len(drawn)} of {len(CLIPS[name].labels)} trajectories" in content
    assert "12.50 %" in content  # errors are of all


def test_a_point_far_outside_leaves_the_picture_of_a_clip_without_a_size_moderate(tmp_path):
    name, clip = next(iter(CLIPS.items()))
    xy = clip.dense.xy.copy()
    xy[0, 0] = 1e7
    far = {name: replace(clip, dense=replace(clip.dense, xy=xy, image_size=None))}
    folder = write_submission(tmp_path / "s", far.values(), {name: clip.labels.label}, META)
    (path,) = write_report(folder, far, tmp_path / "r.html")
    (payload,) = payloads(path.read_text())
    assert max(payload["width"], payload["height"]) <= 4096


def test_pictures_of_a_clip_fit_into_its_share():
    from mseg.evaluation.report import jpegs

    many = [np.random.default_rng(i).integers(0, 255, (40, 60), dtype=np.uint8) for i in range(9)]
    few = jpegs(many, 6000)
    assert 0 < sum(map(bool, few)) < 9 == len(few)
    assert few[0]
    assert sum(map(len, few)) <= 6000
    noise = [np.random.default_rng(i).integers(0, 255, (400, 1200), dtype=np.uint8) for i in range(3)]
    assert sum(map(len, jpegs(noise, 1 << 30))) > 500_000
    assert sum(map(len, jpegs(noise, 200_000))) <= 200_000


@pytest.mark.browser
def test_in_chromium(submission, tmp_path, browser):
    from playwright.sync_api import expect

    (path,) = write_report(submission, CLIPS, tmp_path / "r.html", frames=frames(tmp_path / "f"))
    page = browser.new_context(viewport={"width": 1440, "height": 800}, offline=True).new_page()
    messages = []
    page.on("console", lambda message: messages.append(message.text))
    page.on("pageerror", lambda error: messages.append(str(error)))
    page.goto(path.as_uri())
    viewer = page.locator(".viewer").first
    viewer.scroll_into_view_if_needed()
    slider = viewer.locator("input[type=range]")
    expect(viewer.locator("output")).to_have_text("frame 5")
    slider.focus()
    page.keyboard.press("ArrowRight")
    expect(viewer.locator("output")).to_have_text("frame 6")
    canvas = viewer.locator("canvas").nth(1)
    before = canvas.evaluate("c => c.toDataURL()")
    viewer.locator("select").select_option("seed 1")
    assert canvas.evaluate("c => c.toDataURL()") != before  # other labels, errors ringed
    for width in (1440, 390):
        page.set_viewport_size({"width": width, "height": 800})
        page.wait_for_function("document.documentElement.scrollWidth <= innerWidth")
    page.set_viewport_size({"width": 390, "height": 200})
    page.goto(path.as_uri())
    unseen = page.locator("canvas").last
    before = unseen.evaluate("c => c.toDataURL()")
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert unseen.evaluate("c => c.toDataURL()") != before  # printed, though never in view
    assert messages == []
    page.context.close()


@pytest.mark.browser
def test_a_seed_that_failed_and_names_of_any_form(tmp_path, browser):
    """Where a seed failed another is shown and named; 1R2RC is sorted as a name; a long name fits."""
    from playwright.sync_api import expect

    clips = {new: replace(CLIPS[old], name=new) for new, old in zip(("1R2RC", "10R"), CLIPS, strict=True)}
    labels = dict(zip(clips, truth().values(), strict=True))
    meta = SubmissionMeta("a_name_without_any_place_to_break_it_" * 3)
    folder = write_submission(tmp_path / "s", clips.values(), {0: labels, 1: labels}, meta)
    [labelled] = folder.glob("*1/1R2RC.csv")
    labelled.unlink()
    write_failure(labelled.parent, clips["1R2RC"], "no luck")
    second = write_submission(tmp_path / "b", clips.values(), {0: labels, 1: labels}, SubmissionMeta("b"))
    (path,) = write_report([folder, second], clips, tmp_path / "r.html")
    page = browser.new_context(viewport={"width": 390, "height": 800}, offline=True).new_page()
    page.goto(path.as_uri())
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    names = page.locator("#per-clip tbody th")
    header = page.locator("#per-clip thead th").first
    for _ in range(2):
        header.locator("button").click()
        ordered = sorted(clips, reverse=header.get_attribute("aria-sort") == "descending")
        assert [name.split()[0] for name in names.all_inner_texts()] == ordered
    section = page.locator("#clip-1R2RC")
    section.locator("select").scroll_into_view_if_needed()
    section.locator("select").select_option("seed 1")
    captions = section.locator("figcaption")
    expect(captions.nth(1)).to_contain_text("(seed 0; none of seed 1)")
    expect(captions.nth(2)).not_to_contain_text("seed")
    page.context.close()


def test_the_tables_of_two_methods_lie_in_one_folder(tmp_path):
    folder, wrong = perfect(tmp_path / "s"), tmp_path / "wrong"
    one = {name: np.where(label == 1, 1, 2) for name, label in truth().items()}
    write_submission(wrong, CLIPS.values(), one, SubmissionMeta("wrong"))
    pages = [(folder, "a.html"), (wrong, "b.html"), (folder, "report.html")]
    wrote = [
        p for s, n in pages for p in write_report(s, CLIPS, tmp_path / "out" / n, extras=["csv", "json"])
    ]
    assert len(set(wrote)) == len(wrote) == 15


def test_tables_of_methods_with_names_alike_are_all_written(tmp_path):
    given = [perfect(tmp_path / n, meta=SubmissionMeta(n)) for n in ("a b", "a-b", "c")]
    names = [path.name for path in write_report(given, CLIPS, tmp_path / "r.html", extras=["latex"])]
    assert names == ["r.html", "r-a-b-A.tex", "r-a-b-B.tex", "r-c.tex"]


@pytest.mark.browser
def test_from_a_bar_to_a_clip_a_frame_a_trajectory_and_its_neighbours(three, tmp_path, browser):
    (path,) = write_report(three, CLIPS, tmp_path / "r.html")
    page = browser.new_context(viewport={"width": 1000, "height": 800}, offline=True).new_page()
    messages = []
    page.on("pageerror", lambda error: messages.append(str(error)))
    page.goto(path.as_uri())
    page.locator("input[name=differ]").check()  # both: one clip is wrong, in the other a method failed
    assert page.locator("#per-clip tbody tr:visible").count() == 2
    page.locator("input[name=clip]").fill("two")
    assert page.locator("section.clip:visible").count() == 1
    page.locator("#by-length tbody a").first.click()
    page.locator(".only:visible a", has_text="example_two").click()
    assert page.evaluate("only.axis") == "length"
    page.locator(".only:visible button").click()
    section = page.locator("#clip-example_two")
    box = section.locator("canvas").nth(2).bounding_box()
    x, y = (CLIPS["example_two"].evaluated_trajectories.xy[3, 5] + 0.5) * box["width"] / 320
    section.locator("canvas").nth(2).click(position={"x": float(x), "y": float(y)})
    picked = section.locator(".picked")
    assert re.match(r"Trajectory \d+ true motion 1; A ✓ B ✗ C ✓", picked.inner_text())
    assert picked.locator("button").count() == 8
    picked.locator("button").first.click()
    address = page.url
    assert re.search(r"#clip-example_two&.*frame=5&track=\d+", address)
    shown = picked.inner_text()
    page.goto("about:blank")
    page.goto(address)
    assert page.locator("#clip-example_two .picked").inner_text() == shown  # a link leads to the same place
    page.locator("#clip-example_two [data-zoom='1.5']").click()
    assert "part=1.50" in page.url
    assert messages == []
    page.context.close()


def test_large_labels_need_no_large_table(tmp_path):
    labels = {name: np.where(label == 1, 2**52, label) for name, label in truth().items()}
    folder = write_submission(tmp_path / "s", CLIPS.values(), labels, META)
    assert write_report(folder, CLIPS, tmp_path / "r.html")


def test_notes_are_one_line(tmp_path):
    folder = perfect(tmp_path / "s", meta=replace(META, notes={"example_two": "first\nsecond & line"}))
    assert "first second & line" in rendered(score_submission(folder, CLIPS), "latex")


def test_two_methods_of_one_name_never_get_that_of_a_third(tmp_path):
    names = ["A", "A", "A (1)"]
    folders = [perfect(tmp_path / f"{i}", meta=SubmissionMeta(name)) for i, name in enumerate(names)]
    tables = [score_submission(folder, CLIPS) for folder in folders]
    assert unique_names(tables) == ["A (2)", "A (3)", "A (1)"]


def test_a_page_replaces_no_file_of_another_kind(tmp_path):
    folder = perfect(tmp_path / "s")
    with pytest.raises(InvalidValueError, match=r"meta\.toml: expected a page, ending in \.html"):
        write_report(folder, CLIPS, folder / "meta.toml")
    assert score_submission(folder, CLIPS).error == 0
