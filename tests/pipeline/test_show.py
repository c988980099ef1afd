"""Pictures of trajectories."""

from __future__ import annotations

import dataclasses
import subprocess
import sys

import cv2
import numpy as np
import pytest
from build_scenes import FRAMES, HEIGHT, WIDTH, write_clip

from kt3dmoseg.cli import main
from kt3dmoseg.draw import DrawOptions
from kt3dmoseg.draw.painting import by_label, by_length, by_prediction, draw_frame
from kt3dmoseg.draw.palette import PALETTE, UNLABELLED, css, css_palette, label_colour
from kt3dmoseg.io import save
from kt3dmoseg.io.images import write_moving
from kt3dmoseg.types import Clip, Labels, Trajectories


@pytest.fixture
def clip():
    x = np.array([[30.0, 32, 34, 36, 38, 40], [60, 60, 60, 60, np.nan, np.nan], [80, 80, np.nan, 80, 80, 80]])
    xy = np.stack([x, np.where(np.isnan(x), np.nan, 58.0)], axis=2)
    tracks = Trajectories(xy, ~np.isnan(x), image_size=(WIDTH, HEIGHT))
    return Clip("clip", tracks, np.arange(3), Labels(np.array([1, 2, 0]), 1, {2: "car"}))


@pytest.fixture
def file(clip, tmp_path):
    save(clip, tmp_path / "clip.h5")
    return tmp_path / "clip.h5"


def test_points_have_their_labels_colours(clip):
    picture = draw_frame(by_label(clip, Labels(clip.labels.label)), 0)
    assert picture.shape == (HEIGHT, WIDTH, 3)
    assert tuple(picture[58, 30]) == label_colour(1)
    assert tuple(picture[58, 60]) == label_colour(2)
    assert tuple(picture[58, 80]) == UNLABELLED


def test_a_trail_leads_back_but_not_over_a_gap(clip):
    painting = by_label(clip, Labels(clip.labels.label))
    picture = draw_frame(painting, 5, options=DrawOptions(trail=3))
    assert picture[58, 35].any()
    assert not picture[58, 32].any()
    assert not draw_frame(painting, 5, options=DrawOptions(trail=0))[58, 35].any()
    assert not picture[58, 60].any()


def test_frames_lie_beneath_dimmed_and_enlarged(clip):
    frame = np.full((HEIGHT, WIDTH), 100, np.uint8)
    picture = draw_frame(by_label(clip, Labels([0, 0, 0])), 0, frame, options=DrawOptions(scale=2, dim=0.5))
    assert picture.shape == (2 * HEIGHT, 2 * WIDTH, 3)
    assert picture[2 * 58, 2 * 10].tolist() == [50, 50, 50]
    assert tuple(picture[2 * 58 + 1, 2 * 30 + 1]) == UNLABELLED


def test_the_legend_names_and_counts(clip):
    assert [text for text, _ in by_label(clip).legend] == [
        "0 unlabelled: 1",
        "1 background: 1",
        "2 car: 1",
    ]


def test_a_prediction_has_the_colours_of_the_motions_it_matches_and_rings_what_is_wrong():
    xy = np.stack([np.tile(np.arange(10.0, 70, 10)[:, None], 2), np.full((6, 2), 30.0)], axis=2)
    tracks = Trajectories(xy, np.ones((6, 2), dtype=bool), image_size=(96, 64))
    clip = Clip("clip", tracks, np.arange(6), Labels(np.array([1, 1, 1, 2, 2, 0]), 1))
    painting = by_prediction(clip, [7, 7, 3, 3, 3, 9])
    expected = [label_colour(k, background=1) for k in (1, 1, 2, 2, 2, 3)]
    assert [tuple(colour) for colour in painting.colours.tolist()] == expected
    assert painting.ringed.tolist() == [False, False, True, False, False, False]
    assert [text for text, _ in painting.legend] == [
        "predicted 3: 3, 1 wrong",
        "predicted 7: 2, 0 wrong",
        "predicted 9: 1, 0 wrong",
        "ringed: labelled otherwise, 20.0%",
    ]
    picture = draw_frame(dataclasses.replace(painting, legend=[]), 0)
    assert picture[30, 30 - 4, 0] > picture[30, 30 - 4, 1] + 80  # red
    assert picture[30, 30 - 5].min() > 100  # within white
    assert not picture[30, 20 - 4].any()


def test_all_that_is_drawn_is_enlarged(clip):
    small = draw_frame(by_label(clip, Labels(clip.labels.label)), 0)
    large = draw_frame(by_label(clip, Labels(clip.labels.label)), 0, options=DrawOptions(scale=3))
    coloured = [(p == np.array(label_colour(2))).all(axis=2).sum() for p in (small[50:], large[150:])]
    assert 5 * coloured[0] < coloured[1] < 13 * coloured[0]


def test_lengths_go_from_dark_to_bright(clip):
    colours = by_length(clip.dense).colours.astype(int).sum(axis=1)
    assert colours[1] < colours[2] < colours[0]


def test_colours_repeat_only_after_the_palette_ends():
    assert len({label_colour(k) for k in range(len(PALETTE) + 1)}) == len(PALETTE) + 1
    assert label_colour(1 + len(PALETTE)) == label_colour(1)


# Machado, Oliveira and Fernandes (2009), severity 1, for linear RGB.
_VISION = {
    "normal": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritanopia": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}


def _seen_in_lab(colours, vision):
    linear = np.array(colours) / 255
    linear = np.where(linear <= 0.04045, linear / 12.92, ((linear + 0.055) / 1.055) ** 2.4)
    seen = np.clip(linear @ np.array(_VISION[vision]).T, 0, 1)
    srgb = np.where(seen <= 0.0031308, 12.92 * seen, 1.055 * seen ** (1 / 2.4) - 0.055)
    return cv2.cvtColor(srgb[None].astype(np.float32), cv2.COLOR_RGB2Lab)[0]


@pytest.mark.parametrize("vision", _VISION)
def test_twelve_labels_are_distinct_from_each_other_and_from_gray_in_every_colour_vision(vision):
    assert len(PALETTE) >= 9
    lab = _seen_in_lab([*PALETTE, label_colour(1, background=1), label_colour(0)], vision)
    apart = np.linalg.norm(lab[:, None] - lab[None], axis=2)[np.triu_indices(len(lab), 1)]
    assert apart.min() > 12


def test_the_background_is_gray_where_the_labels_are_the_clips_own(clip):
    own = by_label(clip).colours
    assert tuple(own[0]) == label_colour(1, background=1)
    assert np.ptp(own[0].astype(int)) < 40
    assert np.ptp(own[1].astype(int)) > 100
    assert tuple(by_label(clip, Labels(clip.labels.label)).colours[0]) == label_colour(1)


def test_pictures_reports_and_the_page_share_one_palette():
    page = css_palette()
    assert page["labels"][1] == css(label_colour(2))
    assert page["background"] == css(label_colour(1, background=1))


def test_a_folder_of_pictures(file, tmp_path, capsys):
    frames = write_clip(tmp_path / "frames/clip").parent
    assert main(["show", str(file), "--frames", str(frames), "-o", str(tmp_path / "shown")]) == 0
    names = sorted(path.name for path in (tmp_path / "shown").iterdir())
    assert names == [f"clip_{k:06d}.png" for k in range(1, FRAMES + 1)]
    assert cv2.imread(str(tmp_path / "shown" / names[0])).shape == (HEIGHT, WIDTH, 3)
    assert "6 pictures" in capsys.readouterr().err


@pytest.mark.parametrize("suffix", [".mp4", ".avi"])
def test_a_video(suffix, file, tmp_path):
    path = tmp_path / f"clip{suffix}"
    assert main(["show", str(file), "-o", str(path), "--by", "length"]) == 0
    video = cv2.VideoCapture(str(path))
    assert int(video.get(cv2.CAP_PROP_FRAME_COUNT)) == FRAMES


@pytest.mark.parametrize("suffix", [".mp4", ".avi"])
def test_a_video_of_an_odd_size_keeps_its_last_row_and_column(suffix, tmp_path):
    picture = np.zeros((HEIGHT - 1, WIDTH - 1, 3), dtype=np.uint8)
    picture[-8:], picture[:, -8:] = 200, 200
    write_moving(tmp_path / f"clip{suffix}", [picture] * 3, rate=5)
    written = cv2.VideoCapture(str(tmp_path / f"clip{suffix}")).read()[1]
    assert written.shape == (HEIGHT, WIDTH, 3)
    assert written[-1].min() > 150
    assert written[:, -1].min() > 150


@pytest.mark.parametrize(("suffix", "start"), [(".gif", b"GIF8"), (".apng", b"\x89PNG"), (".webp", b"RIFF")])
def test_an_animation(suffix, start, file, tmp_path):
    path = tmp_path / f"clip{suffix}"
    assert main(["show", str(file), "-o", str(path)]) == 0
    assert path.read_bytes()[:4] == start
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(["clip.h5", path.name])


_FULL_DISK = """
import resource, signal, sys
from kt3dmoseg.cli import main
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (500, 500))
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.parametrize("name", ["c.mp4", "c.avi", "c.gif", "c.png"])
def test_a_full_disk_leaves_no_half_video(name, file, tmp_path):
    command = ["show", str(file), "-o", str(tmp_path / name)]
    code = [sys.executable, "-c", _FULL_DISK, *command]
    done = subprocess.run(code, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert name in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["clip.h5"]


def test_a_prediction_that_would_not_be_shown_is_refused(file, tmp_path, capsys):
    line = ["show", str(file), "-o", str(tmp_path / "a.png"), "--by", "length", "--pred", "none.csv"]
    assert main(line) == 2
    assert "--pred: expected --by prediction, found --by length" in capsys.readouterr().err


def test_a_prediction_in_one_picture(file, tmp_path, capsys):
    (tmp_path / "pred.csv").write_text("track,label\n0,3\n1,3\n2,3\n")
    out = tmp_path / "one.png"
    assert main(["show", str(file), "--pred", str(tmp_path / "pred.csv"), "--at", "0", "-o", str(out)]) == 0
    assert tuple(cv2.imread(str(out))[58, 60, ::-1]) == label_colour(1, background=1)
    assert capsys.readouterr().err == f"{out}: clip, 1 picture\n"


@pytest.mark.parametrize("name", ["c.mp4", "c.gif", "shown"])
def test_frames_of_another_size_are_one_line_and_nothing_is_drawn(name, file, tmp_path, capfd):
    frames = write_clip(tmp_path / "frames/clip").parent
    third = sorted((frames / "clip").iterdir())[2]
    cv2.imwrite(str(third), np.zeros((HEIGHT - 4, WIDTH), np.uint8))
    command = ["show", str(file), "--frames", str(frames), "-o", str(tmp_path / name)]
    assert main(command) == 2
    printed = capfd.readouterr().err
    assert f"{third}: expected {WIDTH}x{HEIGHT} px" in printed
    assert printed.count("\n") == 1
    for path in (frames / "clip").iterdir():
        cv2.imwrite(str(path), np.zeros((HEIGHT - 4, WIDTH), np.uint8))
    assert main(command) == 2
    assert f"expected frames of {WIDTH}x{HEIGHT} px, as in clip" in capfd.readouterr().err
    assert not (tmp_path / name).exists()


def test_a_folder_of_clips_names_one_of_them(clip, file, tmp_path, capsys):
    save(clip, tmp_path / "two.h5")
    assert main(["show", str(tmp_path)]) == 2
    assert f"found a folder with 2 of them; give one, e.g. {file}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--by", "prediction"], "--pred FILE"),
        (["--at", "6"], "expected 0..5, found 6"),
        (["-o", "clip.xyz"], "a suffix of .mp4"),
        (["--frames", "nowhere"], "No such file"),
        (["-o", "clip.jpg"], ".webp, .png, or none for a folder"),
        (["--rate", "0"], "above 0"),
        (["--rate", "nan"], "from 0.1 to 240, found nan"),
        (["--rate", "1e-300", "-o", "a.gif"], "from 0.1 to 240"),
        (["--rate", "inf", "-o", "a.mp4"], "from 0.1 to 240, found inf"),
        (["--scale", "99"], "scale"),
        (
            ["--pred", "other.csv"],
            "clip clip: expected the 3 evaluated trajectories, found 1 that are not evaluated (track 7)",
        ),
    ],
)
def test_what_cannot_be_shown(arguments, words, file, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "other.csv").write_text("track,label\n0,3\n1,3\n2,3\n7,3\n")
    assert main(["show", str(file), *arguments]) == 2
    printed = capsys.readouterr().err
    assert words in printed
    assert printed.count("\n") == 1


def test_the_size_of_a_hostile_clip_is_not_trusted(clip, tmp_path, capsys):
    dense = Trajectories(clip.dense.xy, clip.dense.visible, image_size=(1_000_000, 1_000_000))
    save(dataclasses.replace(clip, dense=dense), tmp_path / "a.h5")
    assert main(["show", str(tmp_path / "a.h5"), "-o", str(tmp_path / "out")]) == 2
    printed = capsys.readouterr().err
    assert "at most 134217728 pixels, found 1000000x1000000" in printed
    assert printed.count("\n") == 1


def test_far_points_of_a_clip_without_an_image_size_fit_the_picture():
    far = Trajectories(np.full((1, 2, 2), 1e300), np.ones((1, 2), bool))
    assert draw_frame(by_length(far), 1).shape == (4096, 4096, 3)


def test_a_suffix_in_capitals_and_a_folder_with_a_dot(file, tmp_path):
    (tmp_path / "shown.v2").mkdir()
    assert main(["show", str(file), "-o", str(tmp_path / "shown.v2")]) == 0
    assert len(list((tmp_path / "shown.v2").glob("*.png"))) == 6
    assert main(["show", str(file), "-o", str(tmp_path / "ONE.PNG")]) == 0
    assert (tmp_path / "ONE.PNG").read_bytes().startswith(b"\x89PNG")


def test_a_clip_whose_name_has_a_dot_is_shown_in_a_folder_of_that_name(clip, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save(dataclasses.replace(clip, name="clip.v2"), "clip.v2.h5")
    assert main(["show", "clip.v2.h5"]) == 0
    assert len(list((tmp_path / "clip.v2").glob("clip.v2_*.png"))) == 6


def test_frames_of_another_clip(file, tmp_path, capsys):
    write_clip(tmp_path / "other", frames=3)
    assert main(["show", str(file), "--frames", str(tmp_path / "other")]) == 2
    assert "expected the 6 frames of clip, found 3" in capsys.readouterr().err
