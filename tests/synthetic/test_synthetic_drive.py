"""A written drive must be read back by pykitti and by this package, number for number."""

import warnings

import cv2
import numpy as np
import pytest

from kt3dmoseg.errors import InputFileError, InvalidValueError
from kt3dmoseg.kitti import RawDrive
from kt3dmoseg.synthetic import Scene, SceneOptions, make_scene, write_drive
from kt3dmoseg.synthetic.kitti_export import T_CAM_VELO, T_VELO_IMU

DATE = "2011_09_26"


@pytest.fixture(scope="module")
def small() -> Scene:
    return make_scene(SceneOptions(width=124, height=48, frames=5, objects=2, seed=9))


@pytest.fixture(scope="module")
def root(small, tmp_path_factory):
    folder = tmp_path_factory.mktemp("kitti")
    written = write_drive(small, folder, drive=7)
    assert written == folder / DATE / f"{DATE}_drive_0007_sync"
    return folder


def test_pykitti_reads_the_drive(small, root):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pykitti's own imports
        import pykitti

        data = pykitti.raw(str(root), DATE, "0007")
    assert len(data) == 5
    assert [t.microsecond for t in data.timestamps] == [0, 100000, 200000, 300000, 400000]
    for i, picture in enumerate(data.cam0):
        assert np.array_equal(np.asarray(picture), small.frame(i))
    assert np.allclose(data.calib.K_cam0, small.K)
    assert np.allclose(data.calib.T_cam0_velo, T_CAM_VELO)
    assert data.calib.b_gray == pytest.approx(0.54)
    world = np.stack([small.camera_pose(i) for i in range(5)])
    imu = np.stack([packet.T_w_imu for packet in data.oxts])
    cameras = imu @ np.linalg.inv(T_CAM_VELO @ T_VELO_IMU)
    expected = np.linalg.inv(world[0]) @ world
    assert np.allclose(np.linalg.inv(cameras[0]) @ cameras, expected, atol=1e-6)
    packet = data.oxts[2].packet
    assert packet.vf == pytest.approx(small.options.speed, rel=0.05)
    assert np.degrees(-packet.wu) == pytest.approx(small.options.turn, rel=0.1)


def test_our_reader_agrees(small, root):
    drive = RawDrive(root, DATE, 7)
    assert drive.numbers.tolist() == [0, 1, 2, 3, 4]
    assert np.array_equal(drive.frame(3), small.frame(3))
    assert np.allclose(drive.timestamps(drive.numbers), np.arange(5) / 10)
    assert drive.image_size == small.image_size


def test_tracklets_cover_the_vehicles(small, root):
    drive = RawDrive(root, DATE, 7)
    tracklets = drive.tracklets()
    assert [t.kind.lower() for t in tracklets] == [v.kind for v in small.vehicles]
    for body, tracklet in enumerate(tracklets, start=2):
        for frame in (0, 4):
            rows, columns = np.nonzero(small.ids(frame) == body)
            corners = np.hstack([tracklet.corners(frame), np.ones((8, 1))]) @ (drive.T_cam_velo.T)
            image = corners[:, :3] @ small.K.T
            image = image[:, :2] / image[:, 2:]
            low, high = image.min(axis=0), image.max(axis=0)
            # Wheels are a centimetre proud and the camera nods: a pixel of tolerance.
            assert (low - 1 <= (columns.min(), rows.min())).all()
            assert (high + 1 >= (columns.max(), rows.max())).all()


def test_an_existing_drive_is_not_replaced(small, root):
    before = sorted(root.rglob("*"))
    with pytest.raises(InputFileError, match="exists already"):
        write_drive(small, root, drive=7)
    assert sorted(root.rglob("*")) == before


def test_a_day_keeps_its_calibration(small, root):
    before = {path: path.read_text() for path in (root / DATE).glob("calib_*.txt")}
    other = make_scene(SceneOptions(width=160, height=48, frames=2, objects=0))
    with pytest.raises(InputFileError, match=r"calib_cam_to_cam\.txt: expected the calibration"):
        write_drive(other, root, drive=8)
    assert {path: path.read_text() for path in (root / DATE).glob("calib_*.txt")} == before
    assert not list(root.rglob("*_0008_sync"))


def test_a_failure_leaves_no_drive(small, tmp_path, monkeypatch):
    real = cv2.imencode
    calls = []

    def full(*arguments):
        calls.append(arguments)
        if len(calls) == 3:
            raise OSError(28, "No space left on device")
        return real(*arguments)

    monkeypatch.setattr(cv2, "imencode", full)
    with pytest.raises(OSError, match="No space"):
        write_drive(small, tmp_path)
    assert not list(tmp_path.rglob("*_sync*"))


@pytest.mark.parametrize(
    "wrong", [{"date": "2011-09-26"}, {"date": "../../x"}, {"drive": 10000}, {"drive": -1}]
)
def test_malformed_names_are_refused(small, tmp_path, wrong):
    with pytest.raises(InvalidValueError):
        write_drive(small, tmp_path, **wrong)
    assert not list(tmp_path.iterdir())
