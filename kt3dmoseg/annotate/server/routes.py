"""The requests that the labelling server answers; `Routes.table` lists them.

Saves and frames have threads of their own; what computes waits for its turn in others.
"""

import asyncio
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import cv2
import numpy as np
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from kt3dmoseg.annotate import formats, model, proposals
from kt3dmoseg.annotate.agreement import compare
from kt3dmoseg.annotate.model import KINDS, Annotation
from kt3dmoseg.annotate.one_click import painted
from kt3dmoseg.annotate.propagation import Region
from kt3dmoseg.annotate.server.clip_session import WORK_STATES, ClipSession, NotTrackedError
from kt3dmoseg.app import typed
from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.files import one_line, read_bytes
from kt3dmoseg.io.images import read_frame
from kt3dmoseg.parallel import run_apart

Answer: TypeAlias = Response | dict[str, Any]
Work: TypeAlias = Callable[[Request, ClipSession, bytes], Answer]

# What every browser shows as it is; other pictures are sent as PNG.
_SHOWN = {f".{kind}": f"image/{kind}" for kind in ("png", "jpeg", "webp", "bmp")} | {".jpg": "image/jpeg"}
_MAX_PICTURE = 1 << 28
_WORKERS = 4
_POLL = 0.25  # seconds between two looks whether somebody still waits for an answer
_NOT_BUILT = "run 'kt3dmoseg build --propose'"


class Routes:
    """The clips being labelled, by name, and the requests about them.

    `annotator` is written into what is saved, when not empty; `other` is the folder of the other annotator's
    annotations; clips are assigned to those of the `team`; proposals may find masks in `masks` and KITTI raw
    drives in `kitti`.
    """

    def __init__(
        self,
        sessions: Mapping[str, ClipSession],
        *,
        annotator: str = "",
        other: Path | None = None,
        masks: Path | None = None,
        kitti: Path | None = None,
        team: Iterable[str] = (),
    ) -> None:
        self.sessions, self.annotator, self.team = sessions, annotator, sorted(team)
        self.other, self.masks, self.kitti = other, masks, kitti
        self.quick, self.slow, self.counting = map(ThreadPoolExecutor, (_WORKERS, 1, 1))
        # Computed now, not while the first page waits for it.
        self.suffixes = {name: formats.load(name).suffix for name in formats.FORMATS.names()}
        lacking = {
            "tracklets": "" if kitti else typed("start with kitti=FOLDER"),
            "masks": "" if masks else typed("start with masks=FOLDER"),
        }
        self.proposers = {name: lacking.get(name, "") for name in proposals.PROPOSERS.names()}

    def table(self) -> list[Route]:
        """Return the routes for starlette; what is posted is an annotation, not saved, unless told."""
        quick, slow = self.quick, self.slow
        return [
            Route("/api/clips", self._clips),  # all of them, and how far each is
            self._route("GET", "", self._clip),  # size, annotation, names of kinds, formats, proposers
            self._route("GET", "/frames/{frame:int}", self._frame),
            self._route("GET", "/tracks", self._tracks),  # float32 (N, F, 2); 202 while they are computed
            self._route("GET", "/moving", self._moving, quick),  # groups that move by themselves, else 1
            self._route("GET", "/trouble", self._trouble),  # why saving would fail, or ""
            self._route("PUT", "/state", self._set_state),  # {"state", "revision"} or {"assigned"}; {"by"}
            self._route("PUT", "/annotation", self._save),  # with the revision that was edited
            self._route("POST", "/regions", self._regions, quick),  # in each frame, and why in doubt
            self._route("POST", "/outline", self._outline, quick),  # `Clicks`
            self._route("POST", "/made", self._made, quick),  # key frames where regions are in doubt
            self._route("POST", "/paint", self._paint, quick),  # {"polygons", "stroke", "radius", "adds"}
            self._route("POST", "/labels", self._labels, quick),
            self._route("POST", "/proposals/{proposer}", self._propose, slow),
            self._route("POST", "/compare", self._compare, quick),  # with the other annotator's
            self._route("POST", "/export/{format}", self._export, quick),
            self._route("POST", "/import/{format}", self._import, quick),  # a file; ?shift=N&scale=X
        ]

    def _route(self, method: str, path: str, work: Work, pool: Executor | None = None) -> Route:
        """Let `work` answer the requests about a clip; it runs in `pool`, else where nothing waits."""

        async def endpoint(request: Request) -> Response:
            session = self.sessions.get(request.path_params["clip"])
            if session is None:
                raise HTTPException(404, "no such clip")
            request.state.stop, body = threading.Event(), await request.body()
            running = asyncio.get_running_loop().run_in_executor(pool, work, request, session, body)
            while pool and not (await asyncio.wait({running}, timeout=_POLL))[0]:
                if await request.is_disconnected():  # what waits for its turn is dropped, a proposer stopped
                    request.state.stop.set()
                    running.cancel()
                    return Response()
            answer = await running
            return answer if isinstance(answer, Response) else JSONResponse(answer)

        return Route("/api/clips/{clip}" + path, endpoint, methods=[method])

    def _clips(self, _: Request) -> Response:
        return JSONResponse({"clips": [session.summary(self.counting) for session in self.sessions.values()]})

    def _clip(self, request: Request, session: ClipSession, __: bytes) -> Answer:
        return {
            "name": session.source.name,
            "image_size": session.image_size,
            "n_frames": len(session.source.frames),
            "frame_names": session.frame_names,
            "numbers": session.numbers,
            "annotation": model.to_json(session.annotation()),
            "folder": session.folder,
            "annotator": self._annotator(request),
            "team": self.team,
            "work": session.work(),
            "states": WORK_STATES,
            "kinds": KINDS,
            "formats": self.suffixes,
            "proposers": self.proposers | {"built": "" if session.built.exists() else _NOT_BUILT},
            "compare": self.other is not None,
            "doubt": session.doubt,
        }

    def _frame(self, request: Request, session: ClipSession, _: bytes) -> Answer:
        frames, index = session.source.frames, request.path_params["frame"]
        if index >= len(frames):
            raise HTTPException(404, f"the clip has frames 0 to {len(frames) - 1}")
        path = frames[index]
        with one_line(path):
            found = path.stat()
        kept = {"cache-control": "private, no-cache", "etag": f'"{found.st_mtime_ns:x}-{found.st_size:x}"'}
        if request.headers.get("if-none-match") == kept["etag"]:
            return Response(status_code=304, headers=kept)
        if kind := _SHOWN.get(path.suffix.lower()):
            return Response(read_bytes(path, _MAX_PICTURE), media_type=kind, headers=kept)
        content = cv2.imencode(".png", read_frame(path, "luma"))[1].tobytes()
        return Response(content, media_type="image/png", headers=kept)

    def _tracks(self, _: Request, session: ClipSession, __: bytes) -> Answer:
        found = session.trajectories()
        content = np.ascontiguousarray(found.xy, dtype="<f4").tobytes()
        shape = {"x-shape": f"{len(found)},{found.n_frames}"}
        return Response(content, media_type="application/octet-stream", headers=shape)

    def _moving(self, _: Request, session: ClipSession, __: bytes) -> Answer:
        return {"groups": None if session.moving is None else session.moving.tolist()}

    def _trouble(self, _: Request, session: ClipSession, __: bytes) -> Answer:
        return {"trouble": session.trouble()}

    def _annotator(self, request: Request) -> str:
        """Who asks: of a team, who has the token; else whom the command line named."""
        return request.scope.get("annotator") or self.annotator

    def _set_state(self, request: Request, session: ClipSession, body: bytes) -> Answer:
        given = model.parse_document(body, "body")
        if not isinstance(given, dict):
            raise InvalidValueError("body", expected="state or assigned, and by", found=repr(given)[:80])
        return {"work": session.set_work(self._annotator(request) or given.get("by"), given)}

    def _save(self, request: Request, session: ClipSession, body: bytes) -> Answer:
        if request.headers.get("x-folder", session.folder) != session.folder:
            raise HTTPException(409, "the server now has another folder of annotations; load the page again")
        given = _given(session, body)
        by = self._annotator(request) or given.annotator
        return {"revision": session.save(replace(given, annotator=by), by).revision}

    def _regions(self, _: Request, session: ClipSession, body: bytes) -> Answer:
        given = _given(session, body)
        session.trajectories()  # refused until they are there
        return {"regions": _shown(session.regions(given)), "weak": session.weak(given)}

    def _outline(self, _: Request, session: ClipSession, body: bytes) -> Answer:
        with model.within("body"):
            asked = model.checked(model.Clicks, model.parse_document(body, "body"))
            return {"polygons": session.outline(asked)}

    def _made(self, _: Request, session: ClipSession, body: bytes) -> Answer:
        return {"made": [made for item in _given(session, body).objects for made in session.made(item)]}

    def _paint(self, _: Request, session: ClipSession, body: bytes) -> Answer:
        with model.within("body"):
            stroke = model.checked(model.Stroke, model.parse_document(body, "body"))
        return {"polygons": painted(stroke, session.image_size)}

    def _labels(self, _: Request, session: ClipSession, body: bytes) -> Answer:
        given = _given(session, body)
        session.trajectories()
        labelled = session.labelled(given)
        labels = labelled.labels.label.tolist()
        per_label = {str(label): count for label, count in sorted(Counter(labels).items())}
        counts = labelled.counts() | {"motions": per_label}
        return {"label": labels, "reason": labelled.reason.tolist(), "counts": counts}

    def _propose(self, request: Request, session: ClipSession, body: bytes) -> Answer:
        given, tracks = _given(session, body), session.trajectories(wait=True)
        name, frames = session.source.name, session.source.frames
        asked = proposals.Request(name, given, tracks, frames, self.masks, self.kitti, session.built)
        proposer, stop = request.path_params["proposer"], request.state.stop
        objects = run_apart(proposals.propose, proposer, asked, stop=stop)
        return {"objects": model.to_json(replace(given.emptied(), objects=tuple(objects)))["objects"]}

    def _compare(self, _: Request, session: ClipSession, body: bytes) -> Answer:
        given = _given(session, body)
        if self.other is None:
            raise HTTPException(404, "start with compare=FOLDER to compare two annotators")
        theirs = session.load(self.other / f"{session.source.name}.json")
        regions = session.regions(given), session.regions(theirs)
        labels = session.labelled(given).labels.label, session.labelled(theirs).labels.label
        found = compare((given, theirs), regions, labels).to_json("you", "the other")
        shown = {"theirs": model.to_json(theirs)["objects"], "regions": _shown(regions[1])}
        return found | shown

    def _export(self, request: Request, session: ClipSession, body: bytes) -> Answer:
        given, chosen = _given(session, body), formats.load(request.path_params["format"])
        try:
            tracks = session.trajectories()
        except NotTrackedError:
            tracks = None
        content = chosen.dump(given, formats.regions(given, tracks), session.frame_names)
        return Response(content, media_type=chosen.media_type)

    def _import(self, request: Request, session: ClipSession, body: bytes) -> Answer:
        name = request.path_params["format"]
        asked = {key: value for key, value in request.query_params.items() if value}
        choices = model.checked(model.Choices, asked)
        plan = formats.plan(name, body, session.annotation(), session.frame_names, choices)
        found = {"lines": plan.lines(), "skipped": plan.skipped, "doubts": plan.doubts}
        return model.to_json(plan.annotation) | {"plan": found}


def _given(session: ClipSession, body: bytes) -> Annotation:
    return session.checked(model.from_json(model.parse_document(body, "body")))


def _shown(regions: Mapping[int, list[Region]]) -> dict[str, Any]:
    """Return the regions as the page draws them, JSON-able."""

    def drawn(region: Region) -> dict[str, Any]:
        polygons = [np.round(polygon, 2).tolist() for polygon in region.polygons]
        return {"visibility": region.visibility, "key": region.key, "polygons": polygons}

    return {str(number): list(map(drawn, of_object)) for number, of_object in regions.items()}
