"""A small drive tracked end to end: figures pinned with the tolerance that OpenCV's versions need."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import kt3dmoseg
from kt3dmoseg import cli
from kt3dmoseg import tracking as tracks
from kt3dmoseg.io.images import frame_paths, read_frame, write_png
from kt3dmoseg.synthetic import SceneOptions, make_scene, write_drive
from kt3dmoseg.tracking import RELIABLE

OPTIONS = SceneOptions(width=320, height=128, frames=6, objects=1, seed=3, speed=6.0, turn=2.0, noise=1.0)


@pytest.fixture(scope="module")
def scene():
    return make_scene(OPTIONS)


@pytest.fixture(scope="module")
def folder(scene, tmp_path_factory):
    return write_drive(scene, tmp_path_factory.mktemp("drive")) / "image_00" / "data"


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    """Three drives: on one, a single track is more than half a percent."""
    scenes = [make_scene(replace(OPTIONS, seed=seed)) for seed in (3, 4, 5)]
    return [(scene, scene.frames()) for scene in scenes], tmp_path_factory.mktemp("flow")


def errors_at_five(drives, **options):
    scenes, cache = drives
    return np.concatenate(
        [_errors(scene, kt3dmoseg.track(frames, cache=cache, **options)) for scene, frames in scenes]
    )


def _errors(scene, tracks):
    first = tracks.visible.argmax(axis=1)
    seeds = np.c_[tracks.xy[np.arange(len(tracks)), first], first]
    exact = scene.trajectories(seeds)
    rows = np.flatnonzero((first == 0) & tracks.visible[:, 5] & exact.visible[:, 5])
    return np.linalg.norm(tracks.xy[rows, 5] - exact.xy[rows, 5], axis=1)


def test_tracks_follow_the_truth(drives):
    errors = errors_at_five(drives)
    assert len(errors) > 400
    assert np.median(errors) < 0.5
    assert (errors < 2).mean() > 0.82


def test_tracks_to_rely_on_follow_it_more_closely(drives):
    errors = errors_at_five(drives, **RELIABLE)
    assert len(errors) > 250
    assert np.median(errors) < 0.15
    assert (errors < 1).mean() > 0.9


def test_translation_is_exact_to_a_few_hundredths():
    scene = make_scene(SceneOptions(width=320, height=128, frames=2, objects=0, noise=0.0))
    still = scene.frame(0)
    frames = [np.ascontiguousarray(still[:, k : k + 280]) for k in (0, 2, 4, 6, 8)]
    tracks = kt3dmoseg.track(frames, seeds=[[140, 100, 0], [200, 60, 0], [80, 90, 0]])
    np.testing.assert_allclose(tracks.xy[:, 4] - tracks.xy[:, 0], [[-8, 0]] * 3, atol=0.06)


@pytest.mark.parametrize("suffix", ["h5", "mat", "npz", "dat"])
def test_the_command_writes_what_track_returns(folder, tmp_path, capsys, suffix):
    out = tmp_path / f"clip.{suffix}"
    command = ["track", str(folder), "-o", str(out), "--flow", "dis_medium", "--min-length", "3"]
    assert cli.main([*command, "-p", "preset=fast", "--cache", str(tmp_path / "cache")]) == 0
    wanted = kt3dmoseg.track(folder, kt3dmoseg.flow.create("dis_medium", preset="fast"), min_length=3)
    assert f"{len(wanted)} trajectories in 6 frames" in capsys.readouterr().err
    clip = kt3dmoseg.load(out)
    np.testing.assert_allclose(clip.dense.xy, wanted.xy, atol=1e-4)
    assert len(clip.evaluated) == len(wanted)
    assert clip.n_motions == 0


def test_the_clip_records_its_source(folder, tmp_path):
    out = tmp_path / "clip.h5"
    assert cli.main(["track", str(folder), "-o", str(out), "--flow", "farneback"]) == 0
    provenance = kt3dmoseg.load(out).provenance
    assert provenance["source"]["count"] == 6
    assert provenance["flow"] == "Farneback"
    assert provenance["flow_options"]["window"] == 15
    assert provenance["track_options"]["spacing"] == 8


def test_reliable_selects_tracks_to_rely_on(folder, tmp_path):
    flow = kt3dmoseg.flow.create("dis_medium")
    command = ["track", str(folder), "--flow", "dis_medium", "--reliable"]
    assert cli.main([*command, "-o", str(tmp_path / "a.h5")]) == 0
    assert cli.main([*command, "-o", str(tmp_path / "b.h5"), "--anchor", "0", "--min-length", "3"]) == 0
    first, second = (kt3dmoseg.load(tmp_path / name) for name in ("a.h5", "b.h5"))
    np.testing.assert_allclose(first.dense.xy, kt3dmoseg.track(folder, flow, reliable=True).xy, atol=1e-4)
    options = first.provenance["track_options"]
    assert {name: options[name] for name in RELIABLE} == dict(RELIABLE)
    assert second.provenance["track_options"] == {**options, "anchor": 0, "min_length": 3}


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--flow", "flownet"], "unknown flow 'flownet'"),
        (["-p", "presett=fast"], "unknown option"),
        (["-p", "contrast"], "expected name=value"),
        (["--spacing", "0"], "spacing: expected a number >= 1"),
        (["-p", "scales=0.5"], "the last 1"),
    ],
)
def test_bad_arguments_are_one_line_and_write_nothing(folder, tmp_path, capsys, arguments, expected):
    out = tmp_path / "clip.h5"
    assert cli.main(["track", str(folder), "-o", str(out), *arguments]) == 2
    message = capsys.readouterr().err
    assert expected in message
    assert message.count("\n") == 1
    assert not out.exists()


def test_colour_frames_are_tracked_by_their_luma_when_asked_for(folder, tmp_path, capsys):
    coloured = tmp_path / "coloured"
    coloured.mkdir()
    for path in frame_paths(folder):
        gray = read_frame(path)
        write_png(coloured / path.name, np.dstack([gray, gray, gray // 2]))
    command = ["track", str(coloured), "-o", str(tmp_path / "clip.h5"), "--flow", "dis_medium"]
    assert cli.main(command) == 2
    assert "--colour luma" in capsys.readouterr().err
    assert cli.main([*command, "--colour", "luma"]) == 0
    tracks = kt3dmoseg.load(tmp_path / "clip.h5").dense
    assert len(tracks) > 100
    for frames in (coloured, frame_paths(coloured)):
        again = kt3dmoseg.track(frames, "dis_medium", colour="luma")
        np.testing.assert_array_equal(again.xy, tracks.xy)


def test_an_output_that_cannot_be_written_is_reported_before_the_work(folder, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(tracks, "track_clip", None)
    (tmp_path / "file").write_text("")
    assert cli.main(["track", str(folder), "-o", str(tmp_path / "file" / "clip.h5")]) == 2
    assert "a file is where a folder should be" in capsys.readouterr().err
    assert cli.main(["track", str(folder), "-o", str(tmp_path / "new" / "clip.foo")]) == 2
    assert "a suffix of .h5" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
