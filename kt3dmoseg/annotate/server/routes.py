"""The requests that the labelling server answers.

``GET  /api/clips``                          the clips and how far each is
``GET  /api/clips/C``                        size, annotation, names of kinds, formats, proposers
``GET  /api/clips/C/frames/K``               one frame as a picture
``GET  /api/clips/C/tracks``                 trajectories as float32 (N, F, 2); 202 while they are computed
``GET  /api/clips/C/moving``                 the group of each trajectory that moves by itself, else 1
``GET  /api/clips/C/trouble``                why saving would fail, or ""
``PUT  /api/clips/C/state``                  how far its annotator is: {"state", "by"}
``GET  /api/clips/C/annotation``             the saved annotation, its revision as ETag
``PUT  /api/clips/C/annotation``             save; If-Match names the revision it was made from
``POST /api/clips/C/regions``                where the objects of the body are in each frame, and why in doubt
``POST /api/clips/C/labels``                 label the trajectories by the annotation in the body
``POST /api/clips/C/proposals/P``            regions proposed by P
``POST /api/clips/C/compare``                the annotation in the body against the other annotator's
``POST /api/clips/C/export/F``               the annotation in the body as a file of format F
``POST /api/clips/C/import/F``               a file of format F as an annotation, not saved, and under "plan"
                                           what that does; ?shift=N&scale=X decide about frames and size

Saves and frames have threads of their own; what computes waits for its turn in others.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import Awaitable, Callable, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from kt3dmoseg.annotate import formats, proposals
from kt3dmoseg.annotate.agreement import agree
from kt3dmoseg.annotate.formats.foreign import Choices
from kt3dmoseg.annotate.labelling import LabelledTracks
from kt3dmoseg.annotate.model import (
    KINDS,
    Annotation,
    from_json,
    load_annotation,
    parse_document,
    save_revision,
    to_json,
)
from kt3dmoseg.annotate.propagation import Region
from kt3dmoseg.annotate.server.clip_session import WORK_STATES, ClipSession, Progress, Summaries
from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.files import read_bytes
from kt3dmoseg.io.images import read_frame
from kt3dmoseg.types import Trajectories

# What every browser shows as it is; other pictures are sent as PNG.
_SHOWN = {f".{kind}": f"image/{kind}" for kind in ("png", "jpeg", "webp", "bmp")} | {".jpg": "image/jpeg"}
_MAX_PICTURE = 1 << 28
_MOST_DIFFERENCES = 2_000
_WORKERS = 4
_ETAG = re.compile(r'"(\d{1,16})"')


class Routes:
    """The clips being labelled, by name, and the requests about them.

    `annotator` is written into what is saved, when not empty; `other` is the folder of the other annotator's
    annotations; proposals may find masks in `masks` and KITTI raw drives in `kitti`.
    """

    def __init__(
        self,
        sessions: Mapping[str, ClipSession],
        *,
        annotator: str = "",
        other: Path | None = None,
        masks: Path | None = None,
        kitti: Path | None = None,
    ) -> None:
        self.sessions, self.annotator = sessions, annotator
        self.other, self.masks, self.kitti = other, masks, kitti
        self.summaries = Summaries(sessions)
        self.quick, self.slow = ThreadPoolExecutor(_WORKERS), ThreadPoolExecutor(1)
        # Computed now, not while the first page waits for it.
        self.suffixes = {name: formats.load(name).suffix for name in formats.FORMATS.names()}
        lacking = {
            "tracklets": "" if kitti else "start with --kitti FOLDER",
            "masks": "" if masks else "start with --masks FOLDER",
        }
        self.proposers = {name: lacking.get(name, "") for name in proposals.PROPOSERS.names()}

    def table(self) -> list[Route]:
        """Return the routes for starlette, which runs plain functions in threads."""
        clip = "/api/clips/{clip}"
        edited = {
            "/regions": (self._regions, self.quick),
            "/labels": (self._labels, self.quick),
            "/proposals/{proposer}": (self._propose, self.slow),
            "/compare": (self._compare, self.quick),
            "/export/{format}": (self._export, self.quick),
        }
        return [
            Route("/api/clips", self._clips),
            Route(clip, self._clip),
            Route(clip + "/frames/{frame:int}", self._frame),
            Route(clip + "/tracks", self._tracks),
            Route(clip + "/moving", self._moving),
            Route(clip + "/trouble", self._trouble),
            Route(clip + "/state", self._set_state, methods=["PUT"]),
            Route(clip + "/annotation", self._annotation),
            Route(clip + "/annotation", self._with_annotation(self._save), methods=["PUT"]),
            Route(clip + "/import/{format}", self._import, methods=["POST"]),
            *(
                Route(clip + path, self._with_annotation(work, pool), methods=["POST"])
                for path, (work, pool) in edited.items()
            ),
        ]

    def _clips(self, _: Request) -> Response:
        return JSONResponse({"clips": self.summaries.clips()})

    def _clip(self, request: Request) -> Response:
        session = self._session(request)
        return JSONResponse(
            {
                "name": session.source.name,
                "image_size": session.image_size,
                "n_frames": len(session.source.frames),
                "frame_names": session.frame_names,
                "annotation": to_json(session.annotation()),
                "annotator": self.annotator,
                "work": session.work_state(),
                "states": WORK_STATES,
                "kinds": KINDS,
                "formats": self.suffixes,
                "proposers": self.proposers,
                "compare": self.other is not None,
            }
        )

    def _frame(self, request: Request) -> Response:
        frames, index = self._session(request).source.frames, request.path_params["frame"]
        if index >= len(frames):
            raise HTTPException(404, f"the clip has frames 0 to {len(frames) - 1}")
        content, kind = _picture(frames[index])
        return Response(content, media_type=kind, headers={"cache-control": "private, max-age=3600"})

    def _tracks(self, request: Request) -> Response:
        found = self._session(request).trajectories()
        if isinstance(found, Progress):
            return JSONResponse(vars(found), status_code=500 if found.error else 202)
        content = np.ascontiguousarray(found.xy, dtype="<f4").tobytes()
        shape = {"x-shape": f"{len(found)},{found.n_frames}"}
        return Response(content, media_type="application/octet-stream", headers=shape)

    def _moving(self, request: Request) -> Response:
        groups = self._session(request).moving
        return JSONResponse({"groups": None if groups is None else groups.tolist()})

    def _trouble(self, request: Request) -> Response:
        return JSONResponse({"trouble": self._session(request).trouble()})

    async def _set_state(self, request: Request) -> Response:
        session, given = self._session(request), parse_document(await request.body(), "body")
        if not isinstance(given, dict):
            raise InvalidValueError("body", expected="state and by", found=repr(given)[:80])
        by = self.annotator or given.get("by")
        entry = await run_in_threadpool(session.set_work_state, given.get("state"), by)
        return JSONResponse({"work": entry})

    def _annotation(self, request: Request) -> Response:
        found = self._session(request).annotation()
        return JSONResponse(to_json(found), headers=_etag(found))

    def _save(self, request: Request, session: ClipSession, given: Annotation) -> Response:
        mine = replace(given, revision=_if_match(request), annotator=self.annotator or given.annotator)
        saved = save_revision(session.source.annotation, mine)
        return JSONResponse({"revision": saved.revision}, headers=_etag(saved))

    def _regions(self, _: Request, session: ClipSession, given: Annotation) -> Response:
        def found() -> dict[str, Any]:
            return {"regions": _shown(session.regions(given)), "weak": session.weak(given)}

        return _once_tracked(session, found)

    def _labels(self, _: Request, session: ClipSession, given: Annotation) -> Response:
        return _once_tracked(session, lambda: _outcome(session.labelled(given)))

    def _propose(self, request: Request, session: ClipSession, given: Annotation) -> Response:
        name, frames = session.source.name, session.source.frames
        asked = proposals.Request(name, given, session.wait(), frames, self.masks, self.kitti)
        objects = proposals.propose(request.path_params["proposer"], asked)
        return JSONResponse({"objects": to_json(replace(given.emptied(), objects=tuple(objects)))["objects"]})

    def _compare(self, _: Request, session: ClipSession, mine: Annotation) -> Response:
        if self.other is None:
            raise HTTPException(404, "start with --compare FOLDER to compare two annotators")
        theirs = load_annotation(self.other / f"{session.source.name}.json")
        session.check(theirs)
        found = _comparison(session.wait(), session.labelled(mine), session.labelled(theirs))
        shown = {"theirs": to_json(theirs)["objects"], "regions": _shown(session.regions(theirs))}
        return JSONResponse(found | shown)

    def _export(self, request: Request, session: ClipSession, given: Annotation) -> Response:
        chosen, found = formats.load(request.path_params["format"]), session.trajectories()
        regions = formats.regions(given, found if isinstance(found, Trajectories) else None)
        return Response(chosen.dump(given, regions, session.frame_names), media_type=chosen.media_type)

    async def _import(self, request: Request) -> Response:
        session, content = self._session(request), await request.body()
        name, choices = request.path_params["format"], _choices(request)

        def work() -> dict[str, Any]:
            plan = formats.plan(name, content, session.annotation(), session.frame_names, choices)
            found = {"lines": plan.lines(), "skipped": plan.skipped, "doubts": plan.doubts}
            return to_json(plan.annotation) | {"plan": found}

        return JSONResponse(await asyncio.get_running_loop().run_in_executor(self.quick, work))

    def _session(self, request: Request) -> ClipSession:
        session = self.sessions.get(request.path_params["clip"])
        if session is None:
            raise HTTPException(404, "no such clip")
        return session

    def _with_annotation(
        self, work: Callable[[Request, ClipSession, Annotation], Response], pool: Executor | None = None
    ) -> Callable[[Request], Awaitable[Response]]:
        """Give `work` the clip of a request and the annotation in the body, which must be of that clip.

        It runs in `pool`, by default where what must not wait runs.
        """

        async def endpoint(request: Request) -> Response:
            session, body = self._session(request), await request.body()

            def call() -> Response:
                return work(request, session, _given(session, body))

            if pool is None:
                return await run_in_threadpool(call)
            return await asyncio.get_running_loop().run_in_executor(pool, call)

        return endpoint


def _choices(request: Request) -> Choices:
    shift, scale = (request.query_params.get(name) or None for name in ("shift", "scale"))
    try:
        numbers = None if shift is None else int(shift), None if scale is None else float(scale)
    except ValueError:
        found = f"shift={shift} scale={scale}"[:80]
        raise InvalidValueError("import", expected="shift=N and scale=X", found=found) from None
    return Choices(*numbers)


def _given(session: ClipSession, body: bytes) -> Annotation:
    annotation = from_json(parse_document(body, "body"))
    session.check(annotation)
    return annotation


def _once_tracked(session: ClipSession, work: Callable[[], dict[str, Any]]) -> Response:
    found = session.trajectories()
    if isinstance(found, Progress):
        return JSONResponse(vars(found), status_code=202)
    return JSONResponse(work())


def _picture(path: Path) -> tuple[bytes, str]:
    kind = _SHOWN.get(path.suffix.lower())
    if kind is not None:
        return read_bytes(path, _MAX_PICTURE), kind
    return cv2.imencode(".png", read_frame(path, "luma"))[1].tobytes(), "image/png"


def _if_match(request: Request) -> int:
    given = request.headers.get("if-match")
    if given is None:
        raise HTTPException(428, 'If-Match: "REVISION" is expected, the revision that was edited')
    matched = _ETAG.fullmatch(given.strip())
    if matched is None:
        raise HTTPException(400, 'If-Match: "REVISION" is expected, a number in quotes')
    return int(matched.group(1))


def _etag(annotation: Annotation) -> dict[str, str]:
    return {"etag": f'"{annotation.revision}"', "cache-control": "no-store"}


def _outcome(labelled: LabelledTracks) -> dict[str, Any]:
    """Return what the page shows of a labelling, JSON-able."""
    labels, counts = np.unique(labelled.labels.label, return_counts=True)
    per_label = {str(label): int(count) for label, count in zip(labels, counts, strict=True)}
    return {
        "label": labelled.labels.label.tolist(),
        "reason": labelled.reason.tolist(),
        "counts": labelled.counts() | {"motions": per_label},
    }


def _shown(regions: Mapping[int, list[Region]]) -> dict[str, Any]:
    """Return the regions as the page draws them, JSON-able."""
    return {
        str(number): [
            {
                "visibility": region.visibility,
                "key": region.key,
                "polygons": [np.round(polygon, 2).tolist() for polygon in region.polygons],
            }
            for region in of_object
        ]
        for number, of_object in regions.items()
    }


def _comparison(trajectories: Trajectories, mine: LabelledTracks, theirs: LabelledTracks) -> dict[str, Any]:
    """Agreement, kappa and the differing trajectories, alike ones together, with where to look."""
    result = agree(mine.labels.label, theirs.labels.label)
    rows = [int(row) for _, _, group in result.groups() for row in group]
    differences = []
    for row in rows[:_MOST_DIFFERENCES]:
        seen = np.flatnonzero(trajectories.visible[row])
        if len(seen):
            frame = int(seen[len(seen) // 2])
            xy = np.round(trajectories.xy[row, frame], 1).tolist()
            names = {"mine": _label_name(mine, row), "theirs": _label_name(theirs, row)}
            differences.append({"row": row, "frame": frame, "xy": xy, **names})
    return {
        "trajectories": len(trajectories),
        "agreement": result.agreement,
        "both": result.both,
        "kappa": result.kappa,
        "different": len(result.differences),
        "differences": differences,
    }


def _label_name(labelled: LabelledTracks, row: int) -> str:
    label = int(labelled.labels.label[row])
    return labelled.labels.names.get(label, f"motion {label - 1}") if label else "unlabelled"
