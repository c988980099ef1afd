"""Point trackers of others instead of optical flow: adapters, the table of their names, and where they start.

An adapter is called with the frames (F, H, W) uint8 of a whole clip and queries (Q, 3), x, y and frame in
our pixels. It returns what the tracker emits, as arrays that `kt3dmoseg.io.point_tracks` reads by their
names: so every convention of a tracker stands in that one table.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, TypeAlias

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.networks import TorchNetwork, network
from kt3dmoseg.options import from_mapping, option, option_names
from kt3dmoseg.registry import Registry
from kt3dmoseg.tracking import TrackOptions
from kt3dmoseg.tracking.linking import inside, new_seeds
from kt3dmoseg.types import ByteArray, Float32Array, FloatArray, Trajectories

ALGORITHM_VERSION = 1
"""Raised when an adapter asks its tracker for something else."""

_TABLE = {"cotracker": f"{__name__}:CoTracker", "tapir": f"{__name__}:Tapir"}
TRACKERS = Registry("tracker", _TABLE, group="kt3dmoseg.trackers")
_EVERY = 5  # frames from one start of new trajectories to the next
APART = 4  # frames between the two pictures that the tracks are compared with
_OURS = "consistency", "boundary", "anchor", "patch", "appearance"  # as options begin that others do not take

PointTracker: TypeAlias = Callable[[ByteArray, FloatArray], Mapping[str, npt.NDArray[Any]]]


def create_tracker(name: str | PointTracker, **parameters: Any) -> PointTracker:  # noqa: ANN401
    """Make a point tracker from its name in `TRACKERS` and its parameters; see `kt3dmoseg.flow.create`."""
    if not isinstance(name, str):
        return name
    made: PointTracker = from_mapping(TRACKERS.load(name), parameters, where=f"tracker {name}")
    return made


@dataclass(frozen=True)
class CoTracker(TorchNetwork):
    """CoTracker3, offline (Karaev et al., "CoTracker3: Simpler and Better Point Tracking", ICCV 2025)."""

    called: ClassVar[str] = "tracker cotracker"
    packages: ClassVar[tuple[str, ...]] = ("torch", "cotracker")
    install: ClassVar[str] = "pip install git+https://github.com/facebookresearch/co-tracker"

    points: int = option(1000, "points that are followed at a time: more need more memory", low=1)

    def __call__(self, frames: ByteArray, queries: FloatArray) -> dict[str, npt.NDArray[Any]]:
        """Follow points; see `PointTracker`.

        It takes (B, F, 3, H, W) in 0..255 and (B, Q, 3): frame, x, y.
        """
        torch, predictor = network(self)
        video = torch.from_numpy(np.repeat(frames[None, :, None].astype(np.float32), 3, axis=2))
        asked = torch.from_numpy(queries[None, :, [2, 0, 1]].astype(np.float32)).to(self.device)
        parts = []
        for first in range(0, len(queries), self.points):
            part = predictor(video.to(self.device), queries=asked[:, first : first + self.points])
            parts.append([values.cpu().numpy() for values in part])
        tracks, seen = (np.concatenate(values, axis=2) for values in zip(*parts, strict=True))
        return {"pred_tracks": tracks, "pred_visibility": seen}

    def make(self, state: Any) -> Any:  # noqa: ANN401
        """Return its predictor; checkpoints of training hold the state as `model`."""
        from cotracker.predictor import CoTrackerPredictor

        made = CoTrackerPredictor(checkpoint=None, offline=True, v2=False, window_len=60)
        made.model.load_state_dict(state.get("model", state))
        return made


@dataclass(frozen=True)
class Tapir(TorchNetwork):
    """TAPIR or BootsTAPIR, as the weights are (Doersch et al., ICCV 2023, ACCV 2024)."""

    called: ClassVar[str] = "tracker tapir"
    packages: ClassVar[tuple[str, ...]] = ("torch", "tapnet")
    install: ClassVar[str] = "pip install 'tapnet[torch] @ git+https://github.com/google-deepmind/tapnet'"

    causal: bool = option(False, "whether the weights are of a causal model, which they do not show")

    def __post_init__(self) -> None:
        if "causal" in Path(self.weights).name and not self.causal:
            raise InvalidValueError("causal", expected="true, by the name of the weights", found="false")

    def __call__(self, frames: ByteArray, queries: FloatArray) -> dict[str, npt.NDArray[Any]]:
        """Follow points; see `PointTracker`.

        It takes (B, F, H, W, 3) in -1..1 and (B, Q, 3): frame, y, x from the outer corner of the image.
        """
        torch, tapir = network(self)
        video = np.repeat(frames[None, ..., None].astype(np.float32) / 127.5 - 1, 3, axis=4)
        asked: Float32Array = (queries[None, :, [2, 1, 0]] + (0, 0.5, 0.5)).astype(np.float32)
        with torch.inference_mode():
            found = tapir(*(torch.from_numpy(values).to(self.device) for values in (video, asked)))
        return {name: found[name].cpu().numpy() for name in ("tracks", "occlusion", "expected_dist")}

    def make(self, state: Any) -> Any:  # noqa: ANN401
        """Return its model; only BootsTAPIR's has further convolutions and one more level of features."""
        from tapnet.torch.tapir_model import TAPIR

        boots = any(name.startswith("extra_convs") for name in state)
        made = TAPIR(pyramid_level=int(boots), extra_convs=boots, use_casual_conv=self.causal)
        made.load_state_dict(state)
        return made


def follow(
    tracker: PointTracker,
    frames: Sequence[ByteArray],
    seeds: FloatArray | None,
    options: TrackOptions,
    report: Callable[[int, int], None],
) -> Trajectories:
    """Trajectories of a tracker's points, from `seeds` (S, 3) or the structured cells that none covers.

    Every fifth frame starts new ones. Points count from their start on, and inside of the image; without
    seeds those that are visible in fewer than `min_length` frames are dropped. The whole clip is in memory.

    Raises
    ------
    InvalidValueError, FileFormatError
        For options of our own tracker, and results that are of other points or follow the frames only when
        read in another way.
    """
    own = [name for name in option_names(TrackOptions) if name.startswith(_OURS)]
    own = [name for name in own if getattr(options, name) != getattr(TrackOptions, name)]
    if own:
        expected = "only options of starts and of the least length with a tracker"
        raise InvalidValueError("track", expected=expected, found=", ".join(own))
    pictures = np.stack(frames)
    xy, visible = np.zeros((0, len(frames), 2)), np.zeros((0, len(frames)), dtype=np.bool_)
    starts = [0] if seeds is not None else range(0, max(1, len(frames) - options.min_length + 1), _EVERY)
    for start in starts:
        queries = seeds
        if queries is None:
            new = new_seeds(frames[start], xy[visible[:, start], start], options)
            queries = np.column_stack([new, np.full(len(new), start)])
        if len(queries):
            more = _followed(tracker, pictures, queries)
            xy, visible = np.concatenate([xy, more.xy]), np.concatenate([visible, more.visible])
        report(start + 1, len(frames))
    least = options.min_length if seeds is None else 0
    kept = fitted(Trajectories(xy, visible), pictures[: APART + 1], least)[0]
    return replace(kept, track_id=np.arange(len(kept)))


def _followed(tracker: PointTracker, pictures: ByteArray, queries: FloatArray) -> Trajectories:
    from kt3dmoseg.io.point_tracks import tracks_from

    where, wanted = f"tracker {type(tracker).__name__}", (len(queries), len(pictures))
    tracks = tracks_from(tracker(pictures, queries), where)
    if tracks.visible.shape != wanted:
        expected, found = ("{} tracks over {} frames".format(*n) for n in (wanted, tracks.visible.shape))
        raise InvalidValueError(where, expected=expected, found=found)
    visible = tracks.visible & (np.arange(len(pictures)) >= queries[:, 2:])
    return Trajectories(np.where(visible[..., None], tracks.xy, np.nan), visible)


def fitted(tracks: Trajectories, pictures: ByteArray, min_length: int) -> tuple[Trajectories, dict[str, int]]:
    """Leave out points outside of the image, then tracks visible in fewer frames; how many, in words.

    `pictures` are the first frames, up to `APART` after the first; InvalidValueError when the tracks follow
    them only with x and y exchanged, or scaled.
    """
    from kt3dmoseg.io.point_tracks import check_on_pictures

    check_on_pictures("tracks", tracks, pictures[[0, -1]].astype(np.float64), len(pictures) - 1)
    shape = pictures.shape[1:]
    with np.errstate(invalid="ignore"):
        within = inside(tracks.xy.reshape(-1, 2), shape).reshape(tracks.visible.shape)
    visible = tracks.visible & within
    kept = visible.sum(axis=1) >= min_length
    xy = np.where(visible[..., None], tracks.xy, np.nan)[kept]
    left_out = {"points outside of the image": int((tracks.visible & ~within).sum())}
    left_out["tracks too short"] = int((~kept).sum())
    found = Trajectories(xy, visible[kept], tracks.track_id[kept], (shape[1], shape[0]))
    return found, {what: count for what, count in left_out.items() if count}
