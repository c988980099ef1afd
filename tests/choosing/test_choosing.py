"""Clips chosen from recordings: what is measured, what is ranked first, what is kept and written."""

from __future__ import annotations

import html
import re
import shlex
import shutil
from itertools import pairwise

import cv2
import numpy as np
import pytest

from kt3dmoseg import catalog
from kt3dmoseg.choosing import ChooseOptions, Window, choose, measure_windows, ranking, select
from kt3dmoseg.choosing.windows import parallax, windows_of
from kt3dmoseg.cli import main
from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.frames import Cut, FrameFolder, choose_sources, find_clips
from kt3dmoseg.synthetic import SceneOptions, make_scene
from kt3dmoseg.synthetic.kitti_export import write_drive

FRAMES, SPEED = 26, 8.0
NO_TRACKLETS = "<boost_serialization><tracklets><count>0</count></tracklets></boost_serialization>"
OPTIONS = {"shortest": 10, "longest": 12, "stride": 6, "apart": 0, "movers": "tracklets"}


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """A KITTI raw root: a drive with movers all along it, and one without."""
    folder = tmp_path_factory.mktemp("kitti")
    for drive, objects in ((1, 3), (2, 0)):
        options = {"width": 310, "height": 94, "frames": FRAMES, "speed": SPEED, "samples": 1, "seed": 3}
        write_drive(make_scene(SceneOptions(objects=objects, **options)), folder, drive=drive)
    return folder


@pytest.fixture(scope="module")
def chosen(root, tmp_path_factory):
    output = tmp_path_factory.mktemp("chosen")
    return choose(root, output, count=4, **OPTIONS), output


def test_movers_rank_first_and_metres_are_those_of_the_drive(chosen):
    windows, _ = chosen
    assert [window.recording[-4:] for window in windows[:2]] == ["0001", "0001"]
    assert windows[0].motions >= 1
    assert min(w.score for w in windows if w.motions) > max(w.score for w in windows if not w.motions)
    for window in windows:
        assert window.unit == "m"
        assert window.translation == pytest.approx(SPEED * (window.last - window.first) / 10, rel=0.02)
        assert 0 < window.clutter < 1
        assert window.depth > 0.5


def test_the_page_shows_every_chosen_window_and_loads_nothing(chosen):
    windows, output = chosen
    page = (output / "index.html").read_text()
    assert all(window.name in page for window in windows)
    assert page.count("data:image/jpeg;base64,") == 5 * len(windows)
    assert not re.search(r"(src|href)=.?https?:", page)
    listed = [line.partition(",")[0] for line in (output / "candidates.csv").read_text().splitlines()[1:]]
    assert f"{len(set(listed))} windows of 2 recordings" in page
    assert listed[0] == windows[0].name


def test_the_catalog_is_taken_by_build_and_label(root, chosen, tmp_path, capsys):
    windows, output = chosen
    file = output / "candidates.toml"
    entries = catalog.load(file, built_in=False)
    assert {(e.name, e.numbers[0], e.numbers[-1]) for e in entries.values()} == {
        (w.name, w.first, w.last) for w in windows
    }
    assert [source.name for source in choose_sources(root, catalogs=[file])] == list(entries)
    found = find_clips(root, annotations=tmp_path, catalogs=[file])
    assert [len(clip.frames) for clip in found.values()] == [e.length for _, e in sorted(entries.items())]
    command = ["build", str(root), "--catalog", str(file), "-o", str(tmp_path), "--flow", "dis_medium"]
    assert main([*command, "--workers", "1"]) == 0
    assert f"{len(windows)} built" in capsys.readouterr().out


def test_what_is_measured_is_kept_and_other_numbers_of_choices_cost_nothing(root, chosen, monkeypatch):
    windows, output = chosen

    def fail(*_: object) -> None:
        raise AssertionError("measured again")

    monkeypatch.setattr(ranking, "measure_windows", fail)
    assert choose(root, output, count=2, **OPTIONS) == windows[:2]
    with pytest.raises(AssertionError, match="measured again"):
        choose(root, output, **OPTIONS | {"stride": 4})


def test_a_window_of_two_parts_is_taken_from_the_first_whichever_is_measured_first(root, monkeypatch):
    [source] = choose_sources(root, drive=1)
    parts = [(source, "a"), (source, "b")]
    results = [[Window("r", 0, 9, metres, "m", 1, 1, (), "")] for metres in (1.0, 2.0)]
    done = list(zip(parts, results, strict=True))
    for order in (done, done[::-1]):
        monkeypatch.setattr(ranking, "run_tasks", lambda *_, order=order, **__: iter(order))
        assert ranking._measured(parts, ChooseOptions(), None, 2, "", None) == results[0]


def test_positions_that_come_later_are_measured(root, tmp_path):
    shutil.copytree(root, tmp_path / "kitti")
    packets = tmp_path / "kitti" / "2011_09_26/2011_09_26_drive_0002_sync/oxts"
    packets.rename(tmp_path / "oxts")
    sources = choose_sources(tmp_path / "kitti", drive=2, frames=(0, 11))
    options = OPTIONS | {"movers": "residual", "count": 1}
    assert [window.unit for window in choose(sources, tmp_path / "out", **options)] == ["px"]
    (tmp_path / "oxts").rename(packets)
    assert [window.unit for window in choose(sources, tmp_path / "out", **options)] == ["m"]


def test_only_the_given_part_of_a_drive_is_looked_at(root):
    sources = choose_sources(root, drive=1, frames=(5, 18))
    windows = choose(sources, count=9, **OPTIONS)
    assert windows
    assert all(5 <= window.first < window.last <= 18 for window in windows)


def test_positions_that_are_not_numbers_are_not_ranked(root, monkeypatch):
    [source] = choose_sources(root, drive=1, frames=(0, 11))
    monkeypatch.setattr(
        type(source.drive), "poses", lambda self, numbers: np.full((len(numbers), 4, 4), np.nan)
    )
    windows = measure_windows(source, ChooseOptions(**OPTIONS))
    assert {window.unit for window in windows} == {"px"}
    assert all(0 < window.score < 1 for window in windows)


def test_parts_are_no_longer_than_the_longest_window(root):
    settings = ChooseOptions(**OPTIONS)
    [source, _] = ranking._sources(root).values()
    parts = [part.numbers() for part, _ in ranking._parts(source, settings)]
    assert max(map(len, parts)) == settings.longest
    covered = {(numbers[a], numbers[b]) for numbers in parts for a, b in windows_of(len(numbers), settings)}
    assert len(covered) > FRAMES // settings.stride


def test_missing_frames_and_cuts_are_in_no_clip_and_the_page_builds_a_name_with_spaces(rng, tmp_path):
    folder = tmp_path / "Bob's drive, 1732828415"
    folder.mkdir()
    assert catalog.runs([3, 4, 5, 9, 10]) == [[3, 4, 5], [9, 10]]
    scenes = [cv2.GaussianBlur(rng.integers(0, 255, (96, 160)).astype(np.uint8), (0, 0), 2) for _ in range(2)]
    for frame in range(20):
        picture = cv2.equalizeHist(np.roll(scenes[frame // 10], frame, axis=1))
        cv2.imwrite(str(folder / f"{frame:06d}.png"), picture)
    options = ChooseOptions(shortest=6, longest=8, stride=2, movers="residual")
    source = FrameFolder(folder, Cut(0, 19, name=folder.name))
    windows = measure_windows(source, options)
    assert {w.cut for w in windows if w.first < 10 <= w.last} == {True}
    assert {w.cut for w in windows if not w.first < 10 <= w.last} == {False}
    selected = select(windows, options)
    assert not any(window.cut for window in selected)
    page = ranking._page(selected[:1], 1, {source.name: source}, options)
    command = html.unescape(re.search(r"<code>(.*?)</code>", page)[1])
    words = shlex.split(command)
    assert (words[2], words[words.index("--name") + 1]) == (str(folder), selected[0].name)
    assert words[-2:] == ["--colour", "luma"]  # as was measured
    with pytest.raises(InvalidValueError, match="step: expected 1, found 2"):
        choose(choose_sources(folder, step=2), shortest=6, longest=8)


def test_a_recording_that_was_renamed_or_copied_keeps_its_measures(rng, tmp_path):
    first = tmp_path / "first"
    first.mkdir()
    scene = cv2.GaussianBlur(rng.integers(0, 255, (96, 160)).astype(np.uint8), (0, 0), 2)
    for frame in range(8):
        cv2.imwrite(str(first / f"{frame:06d}.png"), np.roll(scene, frame, axis=1))
    options = {"shortest": 6, "longest": 8, "stride": 2, "movers": "residual", "output": tmp_path / "chosen"}
    choose(first, **options)
    shutil.copytree(first, tmp_path / "second")
    assert {w.recording for w in choose(tmp_path / "second", **options)} == {"second"}
    both = choose([first, tmp_path / "second"], **options)
    assert {w.recording for w in both} == {"first", "second"}


def test_what_changed_or_was_damaged_is_measured_again(root, tmp_path):
    shutil.copytree(root, tmp_path / "kitti")
    sources = choose_sources(tmp_path / "kitti", drive=1, frames=(0, 11))
    options = OPTIONS | {"count": 1, "output": tmp_path / "out"}
    [first] = choose(sources, **options)
    assert first.motions
    [kept] = (tmp_path / "out" / "measured").iterdir()
    for damaged in ("{}", "[]", '[{"a": 1}]', kept.read_text()[:40]):
        kept.write_text(damaged)
        assert choose(sources, **options) == [first]
    sources[0].drive.tracklet_file.write_text(NO_TRACKLETS)
    assert [window.motions for window in choose(sources, **options)] == [0]


def test_a_drive_that_is_on_disk_in_parts_has_windows_in_each(root, tmp_path):
    shutil.copytree(root, tmp_path / "kitti", ignore=shutil.ignore_patterns("*_drive_0001_sync"))
    name = "2011_09_26/2011_09_26_drive_0002_sync/image_00/data/0000000012.png"
    (tmp_path / "kitti" / name).unlink()
    windows = choose(tmp_path / "kitti", count=9, **OPTIONS)
    spans = {(w.first, w.last) for w in windows if w.recording.endswith("0002")}
    assert {last < 12 for _, last in spans} == {True, False}
    assert not any(first <= 12 <= last for first, last in spans)


@pytest.mark.parametrize("translation", [(0.0, 0.0, 1.0), (0.8, 0.1, 0.2), (0.0, 0.0, 0.0)])
def test_parallax_is_that_of_the_translation_alone(rng, translation):
    x, pixel = rng.uniform((-0.8, -0.25), (0.8, 0.25), (400, 2)), 1 / 720
    before = np.column_stack([x, np.ones(400)]) * rng.uniform(5, 40, (400, 1))
    after = before - translation
    seen = after @ cv2.Rodrigues(np.array([0.01, 0.04, -0.02]))[0].T
    x2 = seen[:, :2] / seen[:, 2:] + rng.normal(0, 0.1 * pixel, (400, 2))
    x2[:60] += rng.uniform(-30, 30, (60, 2)) * pixel  # movers
    length, inverse = parallax(x, x2, pixel)
    exact = np.hypot(*(after[:, :2] / after[:, 2:] - x).T)[60:]
    assert np.quantile(np.abs(length[60:] - exact), 0.9) < 0.7 * pixel + 0.05 * np.median(exact)
    if any(translation):
        spread = [np.diff(np.quantile(np.log2(v), (0.05, 0.95))) for v in (inverse, 1 / before[60:, 2])]
        assert spread[0] == pytest.approx(spread[1], abs=0.25)


def test_a_camera_that_stands_still_has_no_parallax(rng):
    x = rng.uniform(-0.5, 0.5, (50, 2))
    assert parallax(x, x.copy(), 1 / 720)[0].max() < 1e-3


def test_choices_are_apart_and_of_more_than_one_recording():
    def window(recording, first, motions):
        return Window(recording, first, first + 9, 10.0, "m", 3.0, 0.5, (20,) * motions, "mseg")

    many = [window("a", first, 2) for first in range(0, 100, 5)] + [window("b", 0, 1)]
    found = select(many, ChooseOptions(count=4, apart=10))
    spans = sorted((w.first, w.last) for w in found if w.recording == "a")
    assert all(later[0] - earlier[1] > 10 for earlier, later in pairwise(spans))
    assert "b" in {w.recording for w in found}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"shortest": 15}, "shortest: expected at most longest, 12, found 15"),
        (
            {"shortest": 50, "longest": 60},
            r"recordings: expected a drive, .* of 50 frames or more .* found 2011_09_26_drive_0001",
        ),
    ],
)
def test_bad_options_are_named(root, options, message):
    with pytest.raises(InvalidValueError, match=message):
        choose(root, **OPTIONS | options)
