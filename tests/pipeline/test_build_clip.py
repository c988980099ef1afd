"""One clip: labels, evaluated rows, sources, masks."""

from __future__ import annotations

import shutil
import weakref
from dataclasses import replace

import cv2
import numpy as np
import pytest
from build_scenes import FRAMES, HEIGHT, WIDTH, on_patch, scene, write_clip, write_masks

from kt3dmoseg import catalog
from kt3dmoseg.annotate import AnnotatedObject, Annotation, KeyFrame, save_annotation
from kt3dmoseg.catalog import Drive, Entry
from kt3dmoseg.cli import main
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError, UnknownNameError
from kt3dmoseg.frames import FrameInfo, find_clips, frame_folder, frames_of
from kt3dmoseg.io import load_dataset, save
from kt3dmoseg.io.images import read_frame
from kt3dmoseg.pipeline import build_clip, build_dataset, find_sources, kitti_sources, label_by_masks
from kt3dmoseg.pipeline.inputs import by_frame
from kt3dmoseg.types import Trajectories


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_clip(tmp_path_factory.mktemp("frames") / "clip")


def test_without_labels_everything_is_evaluated(folder):
    clip = build_clip(folder)
    assert clip.name == "clip"
    assert clip.dense.image_size == (WIDTH, HEIGHT)
    assert clip.frame_numbers.tolist() == list(range(1, FRAMES + 1))
    assert len(clip.evaluated) == len(clip.dense) > 20
    assert clip.n_motions == 0
    inputs = clip.provenance["inputs"]
    assert {"source", "labels", "options", "flow", "versions", "algorithms"} <= set(inputs)
    assert inputs["options"]["spacing"] == 8
    assert set(inputs["versions"]) == {"kt3dmoseg", "numpy", "scipy", "h5py", "opencv"}


def test_no_path_of_this_machine_gets_into_the_file(folder):
    assert str(folder.parent) not in str(build_clip(folder).provenance)


def test_progress_counts_frames(folder):
    seen = []
    build_clip(folder, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(k, FRAMES) for k in range(1, FRAMES + 1)]


@pytest.mark.parametrize("identity", [1, 2001])
def test_masks_label(identity, folder, tmp_path):
    write_masks(tmp_path / "masks/clip", identity=identity)
    clip = build_clip(folder, masks=tmp_path / "masks", fraction=1.0)
    tracks, truth = clip.evaluated_trajectories, on_patch(clip.evaluated_trajectories)
    assert (clip.labels.label[truth == 1] == 2).all()
    assert (clip.labels.label[truth == 0] == 1).all()
    assert (truth == 1).sum() >= 4
    assert clip.labels.background == 1
    assert clip.labels.names[2] == ("object 1" if identity == 1 else "class 2 instance 1")
    assert len(tracks) < len(clip.dense)  # drawn with replacement


def _annotation(path):
    square = [(20.0, 20.0), (43.0, 20.0), (43.0, 43.0), (20.0, 43.0)]
    last = [(x + 2 * (FRAMES - 1), y) for x, y in square]
    keys = tuple(
        KeyFrame(frame, polygons=(tuple(polygon),)) for frame, polygon in ((0, square), (FRAMES - 1, last))
    )
    patch = AnnotatedObject(1, "patch", "car", 1, keys)
    size = (WIDTH, HEIGHT)
    save_annotation(path, Annotation("clip", size, FRAMES, (patch,), annotator="a test"))


def test_an_annotation_labels_and_takes_precedence_over_masks(folder, tmp_path):
    _annotation(tmp_path / "clip.json")
    write_masks(tmp_path / "masks", identity=7)
    clip = build_clip(folder, annotation=tmp_path, masks=tmp_path / "masks", fraction=1.0)
    truth = on_patch(clip.evaluated_trajectories)
    assert (clip.labels.label[truth == 1] == 2).mean() > 0.9
    assert clip.labels.names[2] == "patch"
    assert set(clip.provenance["inputs"]["labels"]) == {"annotation"}


def test_the_seed_draws_the_background(folder, tmp_path):
    masks = write_masks(tmp_path / "masks")
    rows = [build_clip(folder, masks=masks, fraction=0.5, seed=s).evaluated.tolist() for s in (0, 0, 1)]
    assert rows[0] == rows[1] != rows[2]


def test_a_folder_without_the_clips_annotation_is_refused(folder, tmp_path):
    (tmp_path / "annotations").mkdir()
    with pytest.raises(InputFileError, match=r"annotations: expected \w+\.json, found no annotation; give"):
        build_clip(folder, annotation=tmp_path / "annotations")


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"spacign": 4}, UnknownNameError, "did you mean 'spacing'"),
        ({"flow": "disc"}, UnknownNameError, "unknown flow"),
        ({"fraction": 2}, InvalidValueError, "fraction"),
        ({"annotation": "nowhere"}, InputFileError, "nowhere: expected annotations"),
        ({"masks": "nowhere"}, InputFileError, "nowhere: expected masks"),
        ({"flow_parameters": {"alhpa": 3}}, UnknownNameError, "alpha"),
    ],
)
def test_bad_options(options, error, words, folder):
    with pytest.raises(error, match=words):
        build_clip(folder, **options)


def test_one_clip_is_built_at_a_time(tmp_path):
    for name in "ab":
        write_clip(tmp_path / name)
    with pytest.raises(InvalidValueError, match="expected one clip, found 2: a, b; give one of them"):
        build_clip(tmp_path)
    with pytest.raises(InputFileError, match="nowhere: expected frames, a video or a KITTI raw root"):
        build_clip(tmp_path / "nowhere")


def _video(path, pictures):
    code = int.from_bytes(b"MJPG", "little")
    writer = cv2.VideoWriter(str(path), code, 10, (WIDTH, HEIGHT))
    for picture in pictures:
        writer.write(np.dstack([picture] * 3))
    writer.release()
    return path


def test_a_video_is_a_clip(tmp_path):
    clip = build_clip(_video(tmp_path / "drive.avi", scene()))
    assert (clip.name, clip.n_frames) == ("drive", FRAMES)
    assert len(clip.dense) > 20


def test_what_is_no_video(tmp_path, capfd):
    (tmp_path / "a.mp4").write_bytes(b"not a video at all")
    with pytest.raises(FileFormatError, match=r"a\.mp4: expected a video that OpenCV decodes"):
        build_clip(tmp_path / "a.mp4")
    assert capfd.readouterr().err == ""


def _drive(root, numbers, drive="2011_09_26/2011_09_26_drive_0005_sync"):
    camera = root / drive / "image_00"
    write_clip(camera / "data", frames=len(numbers))
    for path, number in zip(sorted((camera / "data").iterdir()), numbers, strict=True):
        path.rename(path.with_name(f"{number:010d}.png.new"))
    for path in (camera / "data").iterdir():
        path.rename(path.with_suffix(""))
    times = [f"2011-09-26 13:02:{25 + k / 10:012.9f}" for k in range(max(numbers) + 1)]
    (camera / "timestamps.txt").write_text("\n".join(times) + "\n")
    rect = f"S_rect_00: {WIDTH} {HEIGHT}\nP_rect_00: 700 0 48 0 0 700 32 0 0 0 1 0\n"
    (root / "2011_09_26/calib_cam_to_cam.txt").write_text(rect + "R_rect_00: 1 0 0 0 1 0 0 0 1\n")
    rigid = "R: 1 0 0 0 1 0 0 0 1\nT: 0 0 0\n"
    (root / "2011_09_26/calib_velo_to_cam.txt").write_text(rigid)
    (root / "2011_09_26/calib_imu_to_velo.txt").write_text(rigid)
    return root


def test_a_range_of_a_kitti_drive_is_taken_by_frame_number(tmp_path):
    root = _drive(tmp_path, range(40, 50))
    source = kitti_sources(root, date="2011_09_26", drive=5, frames="42-47")[0]
    clip = build_clip(source)
    assert clip.name == "2011_09_26_drive_0005_000042-000047"
    assert clip.frame_numbers.tolist() == [42, 43, 44, 45, 46, 47]
    np.testing.assert_allclose(clip.timestamps, np.arange(42, 48) / 10, atol=1e-9)
    assert clip.camera.K[0, 2] == 48
    # The third to the eighth of the frames on disk, whatever their positions in the folder.
    (tmp_path / "cut").mkdir()
    for number in range(42, 48):
        shutil.copy(source.drive.frame_path(number), tmp_path / "cut" / f"{number}.png")
    np.testing.assert_array_equal(clip.dense.xy, build_clip(tmp_path / "cut").dense.xy)


def test_a_clip_is_built_again_when_calibration_or_times_of_its_drive_change(tmp_path):
    root = _drive(tmp_path / "raw", range(40, 46))
    calibration = root / "2011_09_26/calib_cam_to_cam.txt"
    times = next(root.glob("*/*/image_00/timestamps.txt"))
    built = []
    for file, old, new in (
        (times, "none", "none"),
        (calibration, "P_rect_00: 700", "P_rect_00: 650"),
        (times, "13:02:29.10", "13:02:29.16"),
    ):
        file.write_text(file.read_text().replace(old, new))
        build_dataset(root, tmp_path / "out")
        built += load_dataset(tmp_path / "out").values()
    assert [clip.camera.K[0, 0] for clip in built] == [700, 650, 650]
    assert len({clip.timestamps.tobytes() for clip in built}) == 2


def test_a_clip_of_a_kitti_drive_is_shown_on_its_frames(tmp_path, capsys):
    root = _drive(tmp_path / "kitti", range(40, 50))
    source = kitti_sources(root, drive=5, frames="42-47")[0]
    clip = build_clip(source)
    data = source.drive.frame_path(42).parent
    assert frame_folder(clip, root) == data
    for folder in (root, data):
        frames = frames_of(clip, folder)
        assert len(frames) == 6
        np.testing.assert_array_equal(frames[0], read_frame(source.drive.frame_path(42)))
    save(clip, tmp_path / "a.h5")
    for frames in (root, data):
        assert (
            main(["show", str(tmp_path / "a.h5"), "--frames", str(frames), "-o", str(tmp_path / "shown")])
            == 0
        )
    labelled = find_clips(tmp_path / "a.h5", annotations=tmp_path, frames=root)["a"]
    assert list(labelled.frames) == [source.drive.frame_path(number) for number in range(42, 48)]
    (data / f"{44:010d}.png").unlink()
    assert main(["show", str(tmp_path / "a.h5"), "--frames", str(root)]) == 2
    assert "expected frames numbered 40 to 49 without a gap" in capsys.readouterr().err
    # What a file states about its source is not trusted with the way to a folder.
    hostile = {"kind": "kitti", "drive": "2011_09_26_drive_0005", "camera": "0/../../secret"}
    (root / "2011_09_26/2011_09_26_drive_0005_sync/secret/data").mkdir(parents=True)
    for provenance in ({"inputs": {"source": hostile}}, {"inputs": [1]}):
        assert frame_folder(replace(clip, provenance=provenance), root) is None


def test_a_kitti_root_is_found_by_itself(tmp_path):
    root = _drive(tmp_path, range(40, 46))
    assert [s.name for s in find_sources(root)] == ["2011_09_26_drive_0005"]
    for wrong in ({"drive": 6}, {"date": "2011_09_28"}):
        with pytest.raises(InputFileError, match="no such drive"):
            kitti_sources(root, **wrong)
    with pytest.raises(InvalidValueError, match="FIRST-LAST"):
        kitti_sources(root, frames="42")
    with pytest.raises(InvalidValueError, match=r"drive_0005: range: expected at least two frames.*41-41"):
        build_clip(kitti_sources(root, frames=(41, 41))[0])
    missing = kitti_sources(root, frames="40-49")[0]
    with pytest.raises(InputFileError, match=r"40-45.*found 46"):
        build_clip(missing)


def test_a_range_belongs_to_one_drive(tmp_path):
    root = _drive(tmp_path, range(40, 46))
    (root / "2011_09_26/2011_09_26_drive_0006_sync").mkdir()
    with pytest.raises(
        InvalidValueError, match=r"range and name: expected one source, found 2; .* date=DATE"
    ):
        kitti_sources(root, frames="40-45")


def test_the_located_clips_of_a_kitti_root_are_built_by_name(tmp_path):
    root, drive = _drive(tmp_path, range(40, 52)), Drive("2011_09_26", 5)
    away = Drive("2011_09_26", 9)
    clips = [
        Entry("First", drive, 0, 6, numbers=tuple(range(40, 46))),
        Entry("Second", drive, 0, 5, numbers=tuple(range(47, 52))),
        Entry("NotFetched", drive, 0, 6, numbers=tuple(range(60, 66))),
        Entry("NotEvenItsDrive", away, 0, 6, numbers=tuple(range(6))),
        Entry("InPart", drive, 0, 6, numbers=tuple(range(48, 54))),
    ]
    catalog.save(root / "located.toml", clips)
    sources = {source.name: source for source in find_sources(root)}
    assert sorted(sources) == ["First", "InPart", "Second"]
    assert build_clip(sources["Second"]).frame_numbers.tolist() == [47, 48, 49, 50, 51]
    with pytest.raises(InputFileError, match=r"40-51.*found 52; fetch it"):
        build_clip(sources["InPart"])
    gap = Entry("Gap", drive, 0, 3, numbers=(40, 41, 43))
    catalog.save(root / "located.toml", [gap, clips[0]])
    first, skips = find_sources(root)  # one that cannot be built does not stop the others
    assert build_clip(first).n_frames == 6
    with pytest.raises(
        FileFormatError, match=r"Gap: expected consecutive frames, found 40-41,43 in located\.toml"
    ):
        build_clip(skips)


def test_an_absurd_range_takes_no_memory(tmp_path):
    source = kitti_sources(_drive(tmp_path, range(4)), frames="0-999999999")[0]
    with pytest.raises(InputFileError, match=r"0-3.*found 4"):
        build_clip(source)


def named(numbers):
    return [f"{number:06d}.png" for number in numbers]


def test_masks_are_matched_by_number_else_from_zero(tmp_path):
    paths = sorted(write_masks(tmp_path / "m", first=0).iterdir())
    assert by_frame(paths, named(range(FRAMES)), "c")[2] == paths[2]
    assert by_frame(paths[2:4], named(range(FRAMES)), "c") == {2: paths[2], 3: paths[3]}
    notes = []
    assert by_frame(paths, named(range(100, 100 + FRAMES)), "c", notes=notes)[2] == paths[2]
    assert notes == ["masks: numbered from 0, where the clip starts with 000100.png"]
    with pytest.raises(
        InputFileError, match=r"masks of c: .*000100\.png to 000109\.png.*a shift of 100 begins"
    ):
        by_frame(paths, named(range(100, 110)), "c")


def test_masks_that_may_be_of_other_frames_are_refused(tmp_path):
    paths = sorted(write_masks(tmp_path / "m", first=0).iterdir())
    for given, numbers in [
        ([*paths[:2], *paths[3:]], range(100, 100 + FRAMES - 1)),  # a gap
        (paths, range(1, 1 + FRAMES)),  # from 0 on, or of the frame before?
        (paths[:-1], range(1, 1 + FRAMES)),
    ]:
        with pytest.raises(InputFileError, match=r"masks of c: .*found 0+\.png"):
            by_frame(given, named(numbers), "c")


def test_masks_are_shifted_on_request_and_their_names_count(folder, tmp_path):
    masks, same = tmp_path / "m" / "clip", tmp_path / "same" / "clip"
    write_masks(masks, first=100)
    write_masks(same)
    with pytest.raises(InputFileError, match=r"a shift of -99 begins with the first frame"):
        build_clip(folder, masks=masks)
    wanted, found = build_clip(folder, masks=same), build_clip(folder, masks=masks, shift=-99)
    assert np.array_equal(found.labels.label, wanted.labels.label)
    for path in sorted(same.iterdir()):
        path.rename(path.with_name(f"{int(path.stem) - 1:06d}.png"))
    moved = build_clip(folder, masks=same, shift=1)
    assert np.array_equal(moved.labels.label, wanted.labels.label)
    labels = [clip.provenance["inputs"]["labels"]["masks"] for clip in (wanted, found, moved)]
    assert len(set(labels)) == 3  # equal pictures of other frames are no clip that is up to date


def test_masks_of_more_frames_than_the_clip_has(tmp_path):
    paths = sorted(write_masks(tmp_path / "m", first=0).iterdir())
    assert by_frame(paths, named([2, 3]), "c") == {0: paths[2], 1: paths[3]}


def test_255_alone_is_an_object_and_with_others_void(tmp_path):
    x = np.array([[12.0, 12], [25, 25], [50, 50]])
    tracks = Trajectories(np.stack([x, x * 0 + 9], axis=2), np.ones((3, 2), dtype=bool), image_size=(64, 48))

    def labels(*values):
        for number in range(2):
            mask = np.zeros((48, 64), np.uint8)
            for start, value in zip((10, 20), values, strict=True):
                mask[:, start : start + 10] = value
            cv2.imwrite(str(tmp_path / f"{number}.png"), mask)
        return label_by_masks(tracks, {k: tmp_path / f"{k}.png" for k in range(2)}).label.tolist()

    assert labels(255, 0) == [2, 1, 1]
    assert labels(255, 1) == [0, 2, 1]
    with pytest.raises(FileFormatError, match="255 and"):
        labels(255, 128)


@pytest.mark.parametrize("kept", [{1}, {0, FRAMES - 1}])
def test_some_frames_may_have_no_mask(kept, folder, tmp_path):
    for number, path in enumerate(sorted(write_masks(tmp_path / "masks").iterdir())):
        if number not in kept:
            path.unlink()
    clip = build_clip(folder, masks=tmp_path / "masks", fraction=1.0)
    truth = on_patch(clip.evaluated_trajectories)
    assert clip.n_motions == 2
    assert (clip.labels.label[truth == 1] == 2).all()


def test_void_abstains_and_ties_stay_unlabelled(tmp_path):
    mask = np.zeros((48, 64), np.uint8)
    mask[:, 10:20], mask[:, 20:30], mask[:, 30:40] = 255, 1, 2
    for number in range(4):
        cv2.imwrite(str(tmp_path / f"{number}.png"), mask)
    x = np.array([[12, 12, 12, 12], [12, 25, 25, 25], [25, 25, 35, 35], [5, 5, 5, 25], [35, 35, 35, 35.0]])
    xy = np.stack([x, np.full_like(x, 9)], axis=2)
    tracks = Trajectories(xy, np.ones((5, 4), dtype=bool), image_size=(64, 48))
    labels = label_by_masks(tracks, {k: tmp_path / f"{k}.png" for k in range(4)})
    assert labels.label.tolist() == [0, 2, 0, 1, 3]


def test_bad_masks(tmp_path):
    tracks = Trajectories(np.zeros((1, 2, 2)), np.ones((1, 2), dtype=bool), image_size=(64, 48))
    cv2.imwrite(str(tmp_path / "0.png"), np.zeros((10, 10), np.uint8))
    with pytest.raises(FileFormatError, match=r"0\.png: expected the frames' size \(64, 48\)"):
        label_by_masks(tracks, {0: tmp_path / "0.png"})
    (tmp_path / "1.png").write_bytes(b"text")
    with pytest.raises(FileFormatError, match="indexed or gray PNG"):
        label_by_masks(tracks, {1: tmp_path / "1.png"})


class _Stream:
    """A source that counts how many of its frames are still held when the next is requested."""

    name = where = "stream"

    def __init__(self, frames):
        self.length, self.held = frames, []

    def inspect(self):
        return FrameInfo({"kind": "stream", "sha256": "0" * 64})

    def numbers(self):
        return range(self.length)

    def frames(self, colour):
        given = []
        for picture in scene(frames=self.length):
            frame = picture.copy()
            given.append(weakref.ref(frame))
            yield frame
            del frame
            self.held.append(sum(ref() is not None for ref in given))


def test_two_frames_are_held_however_long_the_clip_is():
    stream = _Stream(60)
    assert build_clip(stream, flow="dis_medium").n_frames == 60
    assert len(stream.held) == 60
    assert max(stream.held) <= 2
