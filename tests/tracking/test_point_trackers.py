"""Point trackers of others: adapters around stand-ins for their packages, with torch where it is."""

from __future__ import annotations

import sys
from types import ModuleType

import cv2
import fake_torch
import numpy as np
import pytest

import kt3dmoseg
from kt3dmoseg.cli import main
from kt3dmoseg.errors import InvalidValueError, MissingDependencyError
from kt3dmoseg.tracking import create_tracker, track

MOTION, FRAMES, HEIGHT, WIDTH = np.array([3.0, 1.0]), 12, 64, 96


@pytest.fixture
def frames(rng):
    """A picture that moves by `MOTION` from frame to frame."""
    noise = rng.integers(0, 255, (HEIGHT + FRAMES, WIDTH + 3 * FRAMES), dtype=np.uint8)
    picture = cv2.equalizeHist(cv2.GaussianBlur(noise, (0, 0), 1.5))
    corners = [(FRAMES - t, 3 * (FRAMES - t)) for t in range(FRAMES)]
    return np.stack([picture[y : y + HEIGHT, x : x + WIDTH] for y, x in corners])


def _moved(x, y, frame):
    """Positions (Q, F, 2) of points that are at x, y in a frame."""
    return np.stack([x, y], 1)[:, None] + MOTION * (np.arange(FRAMES)[:, None] - frame[:, None, None])


def _packages(torch, module):
    """Stand-ins that check what they are given, and follow `MOTION` in their own conventions."""

    class CoTrackerPredictor(module):
        def __init__(self, checkpoint, offline, v2, window_len):
            assert (checkpoint, offline, v2, window_len) == (None, True, False, 60)
            super().__init__()
            self.model = Tiny()

        def __call__(self, video, queries):
            video, queries = video.cpu().numpy(), queries.cpu().numpy()
            assert (video.shape, video.dtype) == ((1, FRAMES, 3, HEIGHT, WIDTH), np.float32)
            assert 200 < video.max() <= 255
            frame, x, y = queries[0].T
            tracks = _moved(x, y, frame).swapaxes(0, 1)[None].astype(np.float32)
            return torch.from_numpy(tracks), torch.from_numpy(np.ones(tracks.shape[:3], bool))

    class TAPIR(module):
        def __init__(self, pyramid_level, extra_convs, use_casual_conv):
            assert (pyramid_level, extra_convs, use_casual_conv) == (0, False, False)
            super().__init__()
            Tiny.__init__(self)

        def __call__(self, video, query_points):
            video, queries = video.cpu().numpy(), query_points.cpu().numpy()
            assert (video.shape, video.dtype) == ((1, FRAMES, HEIGHT, WIDTH, 3), np.float32)
            assert -1 <= video.min() < -0.5
            frame, y, x = queries[0].T
            tracks = _moved(x, y, frame)[None].astype(np.float32)
            low = torch.from_numpy(np.full(tracks.shape[:3], -5, np.float32))
            return {"tracks": torch.from_numpy(tracks), "occlusion": low, "expected_dist": low}

    class Tiny(module):
        def __init__(self):
            module.__init__(self)
            if hasattr(torch, "nn"):
                self.linear = torch.nn.Linear(2, 2)

    return {"cotracker.predictor": CoTrackerPredictor, "tapnet.torch.tapir_model": TAPIR}


@pytest.fixture(params=["stand-in", "torch"])
def weights(request, monkeypatch, tmp_path):
    """A file of tiny random weights, for trackers whose packages are stand-ins."""
    file, names = tmp_path / "weights.pth", ("cotracker", "cotracker.predictor", "tapnet", "tapnet.torch")
    if request.param == "torch":
        torch = pytest.importorskip("torch")
        for name in names:
            monkeypatch.setitem(sys.modules, name, ModuleType(name))
        torch.save(torch.nn.ModuleDict({"linear": torch.nn.Linear(2, 2)}).state_dict(), file)
    else:
        torch = fake_torch.install(monkeypatch, *names)
        file.write_bytes(b"weights")
    module = torch.nn.Module if request.param == "torch" else fake_torch.Module
    for name, cls in _packages(torch, module).items():
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
        setattr(sys.modules[name], cls.__name__, cls)
    fake_torch.network.cache_clear()
    return str(file)


@pytest.mark.parametrize("name", ["cotracker", "tapir"])
def test_points_start_where_none_is_and_follow_the_frames(name, weights, frames):
    tracks = track(frames, tracker=create_tracker(name, weights=weights), min_length=4)
    first = tracks.visible.argmax(axis=1)
    assert set(first) == {0, 5}
    start = tracks.xy[np.arange(len(tracks)), first]
    assert not (start % 8 - 4).any()  # the cells
    exact = start[:, None] + MOTION * (np.arange(FRAMES)[:, None] - first[:, None, None])
    inside = ((exact >= -0.5) & (exact <= (WIDTH - 0.5, HEIGHT - 0.5))).all(axis=2)
    np.testing.assert_array_equal(tracks.visible, inside & (np.arange(FRAMES) >= first[:, None]))
    np.testing.assert_allclose(tracks.xy[tracks.visible], exact[tracks.visible], atol=1e-4)
    assert tracks.lengths.min() >= 4
    assert tracks.image_size == (WIDTH, HEIGHT)


def test_given_seeds_are_followed_in_their_order(weights, frames):
    seeds = [[50, 20, 3], [10, 30, 0], [90, 60, 11]]
    tracks = track(frames, tracker=create_tracker("tapir", weights=weights), seeds=seeds)
    assert tracks.visible.argmax(axis=1).tolist() == [3, 0, 11]
    for row, (x, y, frame) in enumerate(seeds):
        np.testing.assert_allclose(tracks.xy[row, frame], (x, y), atol=1e-5)
    with pytest.raises(InvalidValueError, match="seed 0: expected a frame number below 12"):
        track(frames, tracker=create_tracker("tapir", weights=weights), seeds=[[50, 20, 12]])


def test_the_command_writes_a_clip_that_knows_its_tracker(weights, frames, tmp_path, capsys):
    for number, frame in enumerate(frames):
        cv2.imwrite(str(tmp_path / f"{number:06d}.png"), frame)
    out, given = tmp_path / "out.h5", ["--parameter", f"weights={weights}", "--parameter", "points=7"]
    assert main(["track", str(tmp_path), "-o", str(out), "--tracker", "cotracker", *given]) == 0
    clip = kt3dmoseg.load(out)
    about = clip.provenance["tracker"]
    assert about["backend"].endswith("CoTracker")
    assert len(about["parameters"]["weights"]) == 64  # its checksum, not its path
    assert main(["track", str(tmp_path), "-o", str(out), "--tracker", "cotraker", *given]) == 2
    assert "unknown tracker 'cotraker'; did you mean 'cotracker'?" in capsys.readouterr().err


def test_what_is_missing_is_named(frames, tmp_path, monkeypatch):
    (tmp_path / "w.pt").write_bytes(b"no weights")
    tapir = create_tracker("tapir", weights=str(tmp_path / "w.pt"))
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(MissingDependencyError, match="torch and tapnet, found no torch; pip install 'tapnet"):
        track(frames, tracker=tapir)
    fake_torch.install(monkeypatch)
    monkeypatch.setitem(sys.modules, "cotracker", None)
    with pytest.raises(MissingDependencyError, match="found no cotracker; pip install git"):
        track(frames, tracker="cotracker")
    fake_torch.install(monkeypatch, "tapnet")
    with pytest.raises(MissingDependencyError, match=r"tapir: weights: .* found none; give .*weights=FILE"):
        track(frames, tracker="tapir")
    with pytest.raises(MissingDependencyError, match=r"weights .*w\.pt: .*No module named 'tapnet\.torch'"):
        track(frames, tracker=tapir)
    with pytest.raises(InvalidValueError, match="causal: expected true, by the name of the weights"):
        create_tracker("tapir", weights="causal_tapir.pt")


def test_what_does_not_fit_is_refused(frames):
    def tracker(frames, queries):
        return {"tracks": _moved(*queries.T)[..., ::-1], "visibles": np.ones((len(queries), FRAMES))}

    with pytest.raises(InvalidValueError, match=r"only as \(y, x\)"):
        track(frames, tracker=tracker)
    with pytest.raises(InvalidValueError, match="expected 1 tracks over 12 frames, found 2 tracks"):
        track(frames, tracker=lambda f, q: tracker(f, np.repeat(q, 2, axis=0)), seeds=[[50, 20, 3]])
    with pytest.raises(InvalidValueError, match="least length with a tracker, found anchor, appearance"):
        track(frames, tracker=tracker, anchor=1, appearance=0.2)
