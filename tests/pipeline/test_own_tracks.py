"""Clips built from the trajectories of another tracker."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from build_scenes import FRAMES, write_clip, write_masks

from kt3dmoseg import load, track
from kt3dmoseg.cli import main
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.io import save
from kt3dmoseg.io.point_tracks import write_layout
from kt3dmoseg.pipeline import build_clip, build_dataset
from kt3dmoseg.types import Clip, Labels, Trajectories


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A clip's frames and masks, and its trajectories as our tracker finds them."""
    root = tmp_path_factory.mktemp("scene")
    frames, masks = write_clip(root / "frames" / "a"), write_masks(root / "masks" / "a")
    return frames, masks, track(frames, flow="dis_medium")


def _write(path, tracks, layout="cotracker"):
    path.parent.mkdir(parents=True, exist_ok=True)
    write_layout(Clip("a", tracks, np.arange(len(tracks)), Labels(np.zeros(len(tracks), int))), path, layout)
    return path


@pytest.mark.parametrize("layout", ["cotracker", "tapir"])
def test_tracks_of_another_tracker_are_labelled_and_drawn_as_our_own(scene, tmp_path, layout):
    frames, masks, tracks = scene
    _write(tmp_path / "theirs" / "a" / "anno.npz", tracks, layout)
    out = tmp_path / "out"
    assert [o.status for o in build_dataset(frames, out, masks=masks, tracks=tmp_path / "theirs")] == [
        "built"
    ]
    theirs, ours = load(out / "a.h5"), build_clip(frames, masks=masks, flow="dis_medium")
    np.testing.assert_allclose(theirs.dense.xy, ours.dense.xy, atol=1e-9)
    np.testing.assert_array_equal(theirs.labels.label, ours.labels.label)
    np.testing.assert_array_equal(theirs.evaluated, ours.evaluated)
    assert ours.n_motions == 2
    [again] = build_dataset(frames, out, masks=masks, tracks=tmp_path / "theirs")
    assert again.status == "up to date"
    _write(tmp_path / "theirs" / "a" / "anno.npz", tracks.select(np.arange(len(tracks) - 1)), layout)
    [changed] = build_dataset(frames, out, masks=masks, tracks=tmp_path / "theirs")
    assert changed.reason == "tracks sha256 changed"


def test_points_outside_and_short_tracks_are_left_out_and_counted(scene, tmp_path, capsys):
    frames, _, tracks = scene
    xy, visible = tracks.xy.copy(), tracks.visible.copy()
    xy[0], visible[0] = (30, 20), True
    xy[0, :3] = -9, 20  # leaves three frames of six
    path = _write(tmp_path / "a.npz", Trajectories(xy, visible))
    assert main(["build", str(frames), "-o", str(tmp_path / "out"), "--tracks", str(path)]) == 0
    assert "3 points outside of the image, 1 tracks too short" in capsys.readouterr().out
    assert len(load(tmp_path / "out" / "a.h5").dense) == len(tracks) - 1


def test_tracks_that_do_not_fit_the_frames_are_refused(scene, tmp_path):
    frames, _, tracks = scene
    short = Trajectories(tracks.xy[:, 1:], tracks.visible[:, 1:])
    with pytest.raises(FileFormatError, match=f"expected {FRAMES} frames, found {FRAMES - 1}"):
        build_clip(frames, tracks=_write(tmp_path / "a.npz", short))
    sized = Trajectories(tracks.xy, tracks.visible, image_size=(200, 100))
    with pytest.raises(FileFormatError, match="tracks in 96x64 px, as the frames, found"):
        build_clip(frames, tracks=_write(tmp_path / "a.npz", sized, "tap-vid"))
    back = Trajectories(tracks.xy[:, ::-1], tracks.visible[:, ::-1])
    with pytest.raises(FileFormatError, match="in pixels of 96x64, found points that follow them no better"):
        build_clip(frames, tracks=_write(tmp_path / "a.npz", back))
    later = np.arange(11, 11 + FRAMES)  # as many frames, but others
    clip = Clip("a", tracks, np.arange(len(tracks)), Labels(np.zeros(len(tracks), int)), later)
    save(clip, tmp_path / "a.h5")
    with pytest.raises(
        FileFormatError, match=rf"expected frames 1-{FRAMES}, found frames 11-{10 + FRAMES}; give"
    ):
        build_clip(frames, tracks=tmp_path / "a.h5")
    turned = Trajectories(tracks.xy[..., ::-1], tracks.visible)
    with pytest.raises(FileFormatError, match=r"a\.npz: tracks: .* only as \(y, x\); give points"):
        build_clip(frames, tracks=_write(tmp_path / "a.npz", turned))


def test_options_of_our_tracker_are_refused_and_not_recorded(scene, tmp_path):
    frames, _, tracks = scene
    path = _write(tmp_path / "a.npz", tracks)
    for option in ({"spacing": 6}, {"flow": "farneback"}):
        with pytest.raises(InvalidValueError, match=f"but for min_length, found {next(iter(option))}"):
            build_clip(frames, tracks=path, **option)
    recorded = build_clip(frames, tracks=path, min_length=4).provenance["inputs"]
    assert recorded["options"]["min_length"] == 4
    assert not {"spacing", "flow"} & {*recorded["options"]}
    assert not recorded["flow"]


def test_every_frame_is_read(scene, tmp_path):
    frames, _, tracks = scene
    copy = tmp_path / "frames" / "a"
    shutil.copytree(frames, copy)
    last = sorted(copy.iterdir())[-1]
    last.write_bytes(last.read_bytes()[:100])
    with pytest.raises(KT3DMoSegError, match=last.name):
        build_clip(copy, tracks=_write(tmp_path / "a.npz", tracks))


def test_missing_tracks_are_named_and_the_other_clips_are_built(scene, tmp_path):
    frames, _, tracks = scene
    write_clip(frames.parent / "b", seed=1)
    with pytest.raises(InputFileError, match=r"expected a\.npz or a/FILE\.npz, found c\.npz"):
        build_dataset(frames.parent, tmp_path / "out", tracks=_write(tmp_path / "none/c.npz", tracks).parent)
    _write(tmp_path / "some" / "a.npz", tracks)
    outcomes = build_dataset(frames.parent, tmp_path / "out", tracks=tmp_path / "some", workers=1)
    assert [o.status for o in outcomes] == ["built", "failed"]
    assert "b.npz: No such file" in outcomes[1].reason
