"""The command `video` on small rendered drives: shots, motions, files, and inputs of every kind."""

from __future__ import annotations

import numpy as np
import pytest

import kt3dmoseg
import mseg
from kt3dmoseg.errors import InputFileError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.frames import frames_of
from kt3dmoseg.io.images import (
    davis_palette,
    decode_indices,
    read_picture,
    read_video,
    write_moving,
    write_png,
)
from kt3dmoseg.synthetic import SceneOptions, make_scene
from kt3dmoseg.tracking import find_cuts
from kt3dmoseg.types import Clip, Labels, Trajectories
from mseg import shots as parts
from mseg.cli import main
from mseg.types import Segmentation

SMALL = {"width": 320, "height": 120, "frames": 8, "objects": 1, "noise": 1.0, "samples": 1}


@pytest.fixture(scope="session")
def scene():
    """A drive with one moving car; rendered once."""
    return rendered()


def rendered(**options):
    scene = make_scene(SceneOptions(**SMALL | options))
    return scene, scene.frames()


def write(folder, frames):
    for number, frame in enumerate(frames, start=1):
        write_png(folder / f"{number:06d}.png", frame)
    return folder


@pytest.fixture(scope="session")
def found(scene, tmp_path_factory):
    """What is found in a folder of frames, the number of motions not given."""
    root = tmp_path_factory.mktemp("video")
    lines = []
    shots = mseg.video(write(root / "drive", scene[1]), output=root / "out", report=lines.append, quiet=True)
    return shots, lines, root / "out"


def test_the_motions_of_a_drive(scene, found):
    [shot], [line], _ = found
    assert line == str(shot)
    assert line.startswith(
        f"drive: 8 frames, {len(shot.clip.dense)} trajectories, 2 motions (the next best number costs "
    )
    rows, xy = shot.clip.dense.at(4)
    truth = scene[0].ids(4)[tuple(np.rint(xy[:, ::-1]).astype(int).T)]
    assert mseg.score(truth=np.maximum(truth, 1), pred=shot.clip.labels.label[rows])["error"] < 0.05


def test_what_is_written(found):
    [shot], _, folder = found
    assert sorted(path.name for path in folder.iterdir()) == ["drive.h5", "drive.mp4", "masks"]
    saved = kt3dmoseg.load(folder / "drive.h5")
    assert saved.frame_numbers.tolist() == list(range(1, 9))
    assert len(saved.evaluated) == len(saved.dense)
    assert np.array_equal(saved.labels.label, shot.clip.labels.label)
    assert saved.labels.background == 1
    assert saved.provenance["labels"]["method"] == "multibody"
    pictures = list(read_video(folder / "drive.mp4"))
    assert [picture.shape for picture in pictures] == [(120, 320, 3)] * 8


def test_masks_have_the_palette_of_davis_and_the_shape_of_the_car(scene, found):
    folder = found[2] / "masks" / "drive"
    assert [path.name for path in sorted(folder.iterdir())] == [f"{k:05d}.png" for k in range(1, 9)]
    mask, bits = decode_indices((folder / "00005.png").read_bytes(), "mask")
    assert bits == 8
    car, painted = scene[0].ids(4) == 2, mask == 1
    assert (car & painted).sum() > 0.5 * (car | painted).sum()
    assert np.array_equal(read_picture(folder / "00005.png"), davis_palette()[mask])


def test_masks_go_back_into_a_dataset(found, scene, tmp_path):
    frames = write(tmp_path / "drive", scene[1])
    [outcome] = kt3dmoseg.pipeline.build_dataset(frames, tmp_path / "o", masks=found[2] / "masks", workers=1)
    assert outcome.status == "built"
    assert kt3dmoseg.load(outcome.path).n_motions == 2


@pytest.mark.parametrize("frames", [8, 2])
def test_one_motion_is_one(frames, tmp_path, capsys):
    _, pictures = rendered(objects=0, frames=frames)
    assert main(["video", str(write(tmp_path / "street", pictures)), "-o", str(tmp_path / "out")]) == 0
    out, _ = capsys.readouterr()
    assert f"street: {frames} frames, " in out
    assert " 1 motion (the next" in out
    assert not any(decode_indices(p.read_bytes(), "")[0].any() for p in tmp_path.glob("out/masks/*/*.png"))


def test_nothing_moves_before_a_static_camera(tmp_path):
    _, pictures = rendered(objects=0, speed=0.0, turn=0.0)
    [shot] = mseg.video(write(tmp_path / "a", pictures), output=tmp_path / "out", report=id, quiet=True)
    assert shot.clip.n_motions == 1


def test_each_shot_by_itself(scene, tmp_path):
    _, other = rendered(seed=5, frames=6)
    frames = [*scene[1], *other, 255 - scene[1][0]]
    assert find_cuts(iter(frames)) == ([0, 8, 14], 15)
    write_moving(tmp_path / "trip.avi", (np.repeat(frame[..., None], 3, axis=2) for frame in frames), 10)
    lines = []
    shots = mseg.video(
        tmp_path / "trip.avi", output=tmp_path / "out", method="one_motion", report=lines.append, quiet=True
    )
    assert [(shot.name, shot.frames) for shot in shots] == [("trip_1", 8), ("trip_2", 6), ("trip_3", 1)]
    assert lines[2] == "trip_3: 1 frame, not segmented: frames: expected at least 2 frames, found 1"
    assert shots[2].clip is None
    assert shots[1].clip.frame_numbers.tolist() == list(range(8, 14))
    names = sorted(path.name for path in (tmp_path / "out" / "masks" / "trip_2").iterdir())
    assert names[0] == "00008.png"
    assert {path.name for path in (tmp_path / "out").glob("*.*")} == {
        "trip_1.h5",
        "trip_1.mp4",
        "trip_2.h5",
        "trip_2.mp4",
    }


def test_a_shot_that_cannot_be_tracked_leaves_its_frames_to_no_other(scene, tmp_path, monkeypatch):
    _, other = rendered(seed=5, frames=6)
    folder, seen = write(tmp_path / "trip", [*scene[1], *other]), []

    def tracked(frames, *_, **options):
        if not seen:
            seen.append([])
            raise InvalidValueError("frames", expected="light", found="none")
        seen.append(list(frames))
        return kt3dmoseg.track(seen[-1], **options)

    monkeypatch.setattr(parts, "track", tracked)
    shots = mseg.video(folder, output=tmp_path / "out", method="one_motion", report=id, quiet=True)
    assert [shot.clip is None for shot in shots] == [True, False]
    assert np.array_equal(seen[1], other)


def test_what_no_trajectory_joins_has_one_background(scene, tmp_path):
    """Black frames between two scenes are no cut; each scene is static, and no object of the other."""
    _, other = rendered(seed=5, frames=8, objects=0)
    _, first = rendered(seed=4, frames=8, objects=0)
    folder = write(tmp_path / "dark", [*first, *[np.zeros_like(first[0])] * 3, *other])
    lines = []
    [shot] = mseg.video(folder, output=tmp_path / "out", report=lines.append, quiet=True)
    assert "parts of the clip have no trajectory in common" in lines[0]
    for frames in (range(8), range(11, 19)):
        seen = shot.clip.labels.label[shot.clip.dense.visible[:, frames].any(axis=1)]
        assert np.bincount(seen).argmax() == 1


def test_a_disk_that_is_full_before_the_masks_are_there_is_a_failure(scene, tmp_path, monkeypatch):
    wrote = []

    def write_bytes(path, content):
        wrote.append(path)
        if len(wrote) == 4:
            raise InputFileError(f"{path}", expected="a file", found="No space left on device")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)

    monkeypatch.setattr(parts, "write_bytes", write_bytes)
    folder = write(tmp_path / "drive", scene[1])
    options = {"output": tmp_path / "out", "method": "one_motion", "report": id, "quiet": True}
    with pytest.raises(InputFileError, match=r"00004\.png.*No space left"):
        mseg.video(folder, **options)
    assert not list((tmp_path / "out").glob("*.h5"))  # it comes last: what it stands for is complete


def test_options_that_would_do_nothing_are_refused(scene, found, tmp_path):
    folder = write(tmp_path / "drive", scene[1])
    with pytest.raises(InvalidValueError, match="frames: expected a clip file"):
        mseg.video(folder, folder, output=tmp_path / "out", quiet=True)
    with pytest.raises(InvalidValueError, match="flow: expected frames or a video"):
        mseg.video(found[2] / "drive.h5", output=tmp_path / "out", flow="farneback", quiet=True)


def test_a_number_of_motions_that_is_given_has_no_margin_and_one_not_reached_a_note(monkeypatch):
    tracks = Trajectories(np.zeros((6, 6, 2)) + np.arange(6)[:, None, None], np.ones((6, 6), dtype=bool))
    clip = Clip("shot", tracks, np.arange(6), Labels(np.zeros(6, dtype=np.int64)))
    labels = np.array([1, 1, 1, 2, 2, 2])
    monkeypatch.setattr(parts, "segment", lambda *_, **__: Segmentation(labels, {"margin": -3.0}))
    shot = parts.segmented(parts.Shot("shot", 6, clip), {"method": "any", "n_motions": 3}, lambda *_: None)
    assert f"{shot}" == "shot: 6 frames, 6 trajectories, 2 motions; groups found: 2, asked for: 3"
    many = np.arange(1, 301)
    tracks = Trajectories(np.zeros((300, 6, 2)), np.ones((300, 6), dtype=bool))
    clip = Clip("shot", tracks, np.arange(300), Labels(np.zeros(300, dtype=np.int64)))
    monkeypatch.setattr(parts, "segment", lambda *_, **__: Segmentation(many))
    shot = parts.segmented(parts.Shot("shot", 6, clip), {"method": "any"}, lambda *_: None)
    assert shot.reason == "300 motions, more than a mask can hold"


def test_no_cut_where_brightness_changes_or_nothing_is_seen(scene):
    frames = scene[1]
    assert find_cuts([*frames[:4], *(frame // 2 + 20 for frame in frames[4:])])[0] == [0]
    flat = np.full((100, 200), 90, dtype=np.uint8)
    assert find_cuts([flat, flat + 1, flat])[0] == [0]
    assert find_cuts([flat, flat[:50], flat[:50]]) == ([0, 1], 3)


def test_a_part_of_the_frames_at_another_size(scene, tmp_path):
    frames, options = (
        write(tmp_path / "drive", scene[1]),
        {"method": "one_motion", "report": id, "quiet": True},
    )
    part = {"range_": "2-7", "step": 2, "size": "160x60"}
    [shot] = mseg.video(frames, output=tmp_path / "out", **part, **options)
    assert (shot.name, shot.clip.frame_numbers.tolist()) == ("drive_000002-000007", [2, 4, 6])
    assert [frame.shape for frame in frames_of(shot.clip, frames)] == [(60, 160)] * 3
    with pytest.raises(InvalidValueError, match="expected frames or a video"):
        mseg.video(tmp_path / "out" / f"{shot.name}.h5", output=tmp_path / "b", step=2, **options)


def test_a_clip_file_with_and_without_frames(scene, found, tmp_path):
    clip = found[0][0].clip
    kt3dmoseg.save(clip, tmp_path / "drive.h5")
    options = {"method": "subset", "n_motions": 2, "report": id, "quiet": True}
    [bare] = mseg.video(tmp_path / "drive.h5", output=tmp_path / "a", **options)
    assert {path.name for path in (tmp_path / "a").iterdir()} == {"drive.h5", "drive.mp4"}
    frames = write(tmp_path / "frames", scene[1])
    [shown] = mseg.video(tmp_path / "drive.h5", frames, output=tmp_path / "b", **options)
    assert len(list((tmp_path / "b" / "masks" / "drive").iterdir())) == 8
    assert np.array_equal(bare.clip.labels.label, shown.clip.labels.label)
    assert np.array_equal(bare.clip.dense.track_id, clip.dense.track_id)


def test_a_long_shot_in_parts(scene, found, tmp_path, monkeypatch):
    monkeypatch.setattr(parts, "_PART", 6)
    monkeypatch.setattr(parts, "_OVERLAP", 5)
    options = {"method": "subset", "n_motions": 2, "report": id, "quiet": True}
    frames = write(tmp_path / "drive", scene[1])
    [shot] = mseg.video(frames, output=tmp_path / "out", **options)
    assert mseg.score(found[0][0].clip, shot.clip.labels.label)["error"] < 0.05


def test_mistakes_are_one_line(scene, tmp_path, monkeypatch):
    frames = write(tmp_path / "frames", scene[1][:3])
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "a.txt").write_text("")
    with pytest.raises(InputFileError, match="a new or empty folder"):
        mseg.video(frames, output=tmp_path / "full")
    for options in ({"rate": 0.0}, {"method": "multybody"}, {"flow": "diss"}):
        with pytest.raises(KT3DMoSegError):
            mseg.video(frames, output=tmp_path / "new", quiet=True, **options)
    blank = write(tmp_path / "blank", [np.full((64, 64), 9, np.uint8)] * 3)
    with pytest.raises(InvalidValueError, match="expected motions in some shot"):
        mseg.video(blank, output=tmp_path / "none", report=id, quiet=True)
    single = write(tmp_path / "single", scene[1][:1])
    with pytest.raises(InputFileError, match="at least two numbered frames"):
        mseg.video(single, output=tmp_path / "none2", quiet=True)


def test_without_a_codec_the_masks_are_all_there(scene, tmp_path, monkeypatch):
    monkeypatch.setattr("cv2.VideoWriter.isOpened", lambda _: False)
    lines = []
    frames = write(tmp_path / "frames", scene[1])
    mseg.video(frames, output=tmp_path / "out", method="one_motion", report=lines.append, quiet=True)
    assert "no overlay: " in lines[0]
    assert len(list((tmp_path / "out" / "masks" / "frames").iterdir())) == 8
    assert not list((tmp_path / "out").glob("*.mp4"))


def test_the_largest_group_is_thinned_the_second_time(monkeypatch):
    rng = np.random.default_rng(0)
    start, speed = rng.uniform(0, 600, (1000, 1, 2)), np.repeat([0.0, 3.0], [950, 50])[:, None, None]
    tracks = Trajectories(start + speed * np.arange(6)[:, None], np.ones((1000, 6), dtype=bool))
    seen = []

    def halves(clip, *, rows, **_):
        evaluated = clip.evaluated if isinstance(clip, Clip) else np.arange(1000)
        seen.append(evaluated)
        return Segmentation(1 + (np.arange(1000) >= 950), {"margin": 20.0}, np.arange(1000))

    monkeypatch.setattr(parts, "segment", halves)
    steps = []
    labels, margin, _ = parts._segmented_twice(tracks, {"method": "any", "seed": 1}, steps.append)
    assert steps == [0, 1]
    assert (len(seen[0]), len(seen[1])) == (1000, 250)  # 200 of the background, and all others
    assert set(range(950, 1000)) <= set(seen[1].tolist())
    assert (np.bincount(labels).tolist(), margin) == ([0, 950, 50], 20.0)


def test_a_shot_of_outliers_only_is_not_segmented_and_the_others_are(monkeypatch):
    tracks = Trajectories(np.zeros((6, 6, 2)), np.ones((6, 6), dtype=bool))
    monkeypatch.setattr(parts, "segment", lambda *_, **__: Segmentation(np.zeros(6, dtype=np.int64)))
    clip = Clip("shot", tracks, np.arange(6), Labels(np.zeros(6, dtype=np.int64)))
    shot = parts.segmented(parts.Shot("shot", 6, clip), {"method": "any"}, lambda *_: None)
    assert shot.clip is None
    assert "expected a motion, found outliers only" in shot.reason
