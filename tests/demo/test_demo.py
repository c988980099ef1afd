"""The demo, small: every step must leave what a person would find, and replace nothing of theirs."""

import numpy as np
import pytest

import kt3dmoseg
from kt3dmoseg import cli
from kt3dmoseg.annotate import Annotation
from kt3dmoseg.demo import DemoOptions, annotation_of, outline, run_demo
from kt3dmoseg.errors import InputFileError, UnknownNameError
from kt3dmoseg.synthetic import SceneOptions, make_scene, track_errors
from mseg.evaluation import score_submission, validate_submission

SMALL = DemoOptions(width=414, height=125, frames=7, methods=("one_motion", "keradd"), runs=2)
CLIPS = ["2011_09_26_drive_0001", "2011_09_26_drive_0002"]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder, lines = tmp_path_factory.mktemp("demo") / "out", []
    reports = run_demo(folder, SMALL, report=lines.append)
    return folder, lines, reports


def test_it_leaves_drives_annotations_clips_submissions_and_reports(finished):
    folder, _, reports = finished
    for clip in CLIPS:
        frames = folder / "kitti" / "2011_09_26" / f"{clip}_sync" / "image_00" / "data"
        assert len(list(frames.glob("*.png"))) == 7
        annotation = kt3dmoseg.load_annotation(folder / "annotations" / f"{clip}.json")
        assert annotation.image_size == (414, 125)
    assert list(reports) == ["one_motion", "keradd"]
    for report in reports.values():
        page = report.read_text()
        assert all(clip in page for clip in CLIPS)
        assert "data:image/jpeg" in page  # the frames are in it


def test_the_clips_are_labelled_and_have_time_and_camera(finished):
    clips = kt3dmoseg.load_dataset(finished[0] / "dataset")
    assert sorted(clips) == CLIPS
    for clip in clips.values():
        assert clip.n_motions >= 2
        assert clip.labels.background == 1
        assert np.allclose(np.diff(clip.timestamps), 0.1)
        assert clip.camera is not None
        assert clip.camera.K is not None


def test_the_submissions_are_valid_and_the_method_beats_the_baseline(finished):
    folder = finished[0]
    means = {}
    for method in SMALL.methods:
        submission = folder / "submissions" / method
        assert validate_submission(submission, folder / "dataset").ok
        means[method] = score_submission(submission, folder / "dataset").per_clip().mean()
    assert means["keradd"] < means["one_motion"]


def test_it_announces_seven_steps_with_the_commands_of_real_data(finished):
    text = "\n".join(finished[1])
    assert [f"[{k}/7]" in text for k in range(1, 8)] == [True] * 7
    for command in ("pull", "label", "build", "info"):
        assert f"kt3dmoseg {command}" in text
        assert command in cli.COMMANDS
    for command in ("run", "validate", "score", "compare", "report"):
        assert f"mseg {command}" in text
    assert "one_motion: valid" in text


def test_a_folder_with_other_files_is_left_alone(tmp_path, capsys):
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / "mine.png").write_bytes(b"mine")
    assert cli.main(["demo", "-o", str(tmp_path)]) == 2
    assert "other files" in capsys.readouterr().err
    assert (tmp_path / "frames" / "mine.png").read_bytes() == b"mine"


def test_a_file_in_place_of_the_folder_is_one_line(tmp_path, capsys):
    (tmp_path / "file.txt").write_text("mine")
    assert cli.main(["demo", "-o", str(tmp_path / "file.txt")]) == 2
    message = capsys.readouterr().err
    expected = "an empty folder, or a former demo's"
    assert message == f"kt3dmoseg: {tmp_path}/file.txt: expected {expected}, found a file; choose another\n"
    assert (tmp_path / "file.txt").read_text() == "mine"


@pytest.mark.parametrize("given", ["one_motion keradd", "one_motion,keradd", "one_motion, keradd"])
def test_methods_are_words_or_have_commas(given, monkeypatch):
    runs = []
    monkeypatch.setattr("kt3dmoseg.demo.run_demo", lambda _, options, **__: runs.append(options.methods))
    assert cli.main(["demo", "--methods", *given.split(), "--runs", "1"]) == 0
    assert runs == [("one_motion", "keradd")]


def test_no_method_is_one_line(tmp_path, capsys):
    assert cli.main(["demo", "-o", str(tmp_path / "out"), "--methods", ","]) == 2
    assert capsys.readouterr().err == "kt3dmoseg: --methods: expected at least one name, found none\n"
    assert not (tmp_path / "out").exists()


def test_an_unknown_method_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(UnknownNameError, match="keradd"):
        run_demo(tmp_path / "out", DemoOptions(methods=("keradd2",)))
    assert not (tmp_path / "out").exists()


def test_a_read_only_place_is_one_line(tmp_path, capsys):
    (tmp_path / "file").write_text("not a folder")
    assert cli.main(["demo", "-o", str(tmp_path / "file" / "out")]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_outlines_follow_the_vehicles():
    scene = make_scene(SceneOptions(width=310, height=94, frames=7, objects=3, seed=2))
    annotation = annotation_of(scene, "clip")
    assert isinstance(annotation, Annotation)
    assert [item.motion for item in annotation.objects] == [1, 2, 3]
    for item in annotation.objects:
        assert [key.frame for key in item.key_frames] == [0, 3, 6]
    ids = scene.ids(3)
    rows, columns = np.nonzero(ids == 3)
    points = np.array([p for polygon in outline(scene, 3, 3).polygons for p in polygon])
    assert np.abs(points.min(axis=0) - (columns.min(), rows.min())).max() <= 1
    assert np.abs(points.max(axis=0) - (columns.max(), rows.max())).max() <= 1
    absent = make_scene(SceneOptions(width=96, height=48, frames=60, objects=2, speed=30.0))
    assert outline(absent, 2, 59).visibility in ("outside", "occluded")


def test_labels_of_exact_tracks_are_exact():
    scene = make_scene(SceneOptions(width=310, height=94, frames=7, objects=3, seed=2))
    x, y = np.meshgrid(np.arange(4, 310, 6.0), np.arange(4, 94, 6.0))
    seeds = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 3)])
    tracks = scene.trajectories(seeds)
    labels = kt3dmoseg.label_tracks(tracks, annotation_of(scene, "clip"))
    truth = scene.labels(seeds).label
    decided = labels.label > 0
    assert decided.mean() > 0.9
    assert (labels.label[decided] == truth[decided]).mean() > 0.97


def test_track_errors_are_zero_for_the_truth_and_grow_with_a_slip():
    scene = make_scene(SceneOptions(width=310, height=94, frames=6, objects=1))
    seeds = np.column_stack([np.linspace(20, 280, 40), np.full(40, 30.0), np.zeros(40)])
    tracks = scene.trajectories(seeds)
    complete = tracks.select(tracks.visible.all(axis=1))
    assert np.nanmax(track_errors(scene, complete)) < 1e-6
    moved = complete.xy.copy()
    moved[:, 3] += (0.3, 0.4)
    slipped = kt3dmoseg.Trajectories(moved, complete.visible)
    assert np.allclose(track_errors(scene, slipped, 3), 0.5, atol=1e-6)
    assert np.isnan(track_errors(scene, complete, 6)).all()
    with pytest.raises(InputFileError):
        run_demo("/proc/demo-out", SMALL, report=lambda _: None)
