"""Reading a submission: its meta data and which file holds which clip of which seed."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import PurePosixPath

from kt3dmoseg.errors import KT3DMoSegError
from mseg.evaluation.archive import Contents, open_contents
from mseg.evaluation.meta import parse_meta
from mseg.evaluation.prediction import SUFFIXES, Prediction, parse_prediction
from mseg.evaluation.problems import Problem
from mseg.evaluation.submission import FAILED, META, SEED_FOLDER, SubmissionMeta

_LABEL_FILES = (".mat", ".dat", ".txt", ".npy", ".pkl", ".pickle", ".tsv", ".xlsx")
_CONVERT = (
    "make it a csv 'track,label'; for label files (.mat, .txt, .dat) "
    "'mseg example-submission DATA --from FILES -o OUT' does it"
)
_WRAPPED_FIX = "zip the content, not the folder: cd {0} && zip -r ../{0}.zip ."


@dataclass(frozen=True, eq=False)
class Submission:
    """What a submission holds, before it is compared with the data.

    Parameters
    ----------
    meta : SubmissionMeta
        Who, how, on which data.
    predictions : mapping of (seed, clip) to Prediction
        Seed 0 when the files lie in no seed folder.
    failures : mapping of (seed, clip) to str
        Clips on which the method failed, and why.
    files : mapping of (seed, clip) to str
        The file of each.
    problems : list of Problem
        Everything that is wrong so far.
    sha256 : str
        Hash over names and contents, the same for a folder and its zip.
    """

    meta: SubmissionMeta
    predictions: Mapping[tuple[int, str], Prediction] = field(default_factory=dict)
    failures: Mapping[tuple[int, str], str] = field(default_factory=dict)
    files: Mapping[tuple[int, str], str] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)
    sha256: str = ""

    @property
    def seeds(self) -> list[int]:
        """The seeds, ascending."""
        return sorted({seed for seed, _ in (*self.predictions, *self.failures)})

    @property
    def clips(self) -> list[str]:
        """Names of the clips, of any seed, sorted."""
        return sorted({clip for _, clip in (*self.predictions, *self.failures)})


def read_submission(path: str | os.PathLike[str]) -> Submission:
    """Read a submission from a folder or a zip; what is wrong with it is told, not raised.

    Raises
    ------
    InputFileError
        When there is nothing at `path`.
    """
    contents = open_contents(path)
    if contents.problems and not contents.names:  # no zip, or too large: that says it all
        return Submission(SubmissionMeta("unnamed"), problems=contents.problems)
    prefix = _find_root(contents)
    reader = _Reader(contents, prefix)
    reader.read_meta()
    for name in contents.names:
        if name.startswith(prefix) and name != prefix + META:
            reader.read_file(name, PurePosixPath(name[len(prefix) :]))
    reader.check_layout()
    return Submission(
        reader.meta,
        reader.predictions,
        reader.failures,
        reader.files,
        contents.problems,
        reader.digest.hexdigest(),
    )


def _find_root(contents: Contents) -> str:
    """Find where meta.toml lies: at the top, or one folder down when the folder itself was zipped."""
    if META in contents.names:
        return ""
    below = [n for n in contents.names if PurePosixPath(n).name == META]
    tops = {PurePosixPath(n).parts[0] for n in contents.names}
    if len(below) == 1 and len(tops) == 1:
        prefix = below[0].removesuffix(META)
        contents.add(
            "wrapped-folder",
            below[0],
            expected=f"{META} at the top",
            found=f"everything inside the folder {prefix}",
            fix=_WRAPPED_FIX.format(prefix.rstrip("/")),
        )
        return prefix
    near = next((n for n in contents.names if n.lower() == META), "")
    contents.add(
        "no-meta",
        META,
        expected=f"{META} at the top",
        found=f"{near} (lower case is needed)" if near else "none",
        fix="see docs/submit.md, or let 'mseg example-submission' write one",
    )
    return ""


class _Reader:
    def __init__(self, contents: Contents, prefix: str) -> None:
        self.contents, self.prefix = contents, prefix
        self.meta = SubmissionMeta("unnamed")
        self.predictions: dict[tuple[int, str], Prediction] = {}
        self.failures: dict[tuple[int, str], str] = {}
        self.files: dict[tuple[int, str], str] = {}
        self.digest = hashlib.sha256()
        self.loose = self.seeded = 0

    def content(self, name: str) -> bytes | None:
        try:
            content = self.contents.read(name)
        except KT3DMoSegError as error:
            self.contents.add(
                "unreadable", name, expected="a readable file", found=str(error), fix="make the archive again"
            )
            return None
        relative = name[len(self.prefix) :]
        self.digest.update(f"{relative}\0{len(content)}\0".encode())
        self.digest.update(content)
        return content

    def read_meta(self) -> None:
        name = self.prefix + META
        if name in self.contents.names and (content := self.content(name)) is not None:
            self.meta, problems = parse_meta(content)
            self.contents.problems.extend(problems)

    def read_file(self, name: str, place: PurePosixPath) -> None:
        seed = self._seed(name, place)
        if seed is None:
            return
        suffix = place.suffix.lower()
        if suffix not in (*SUFFIXES, FAILED):
            self._odd_file(name, place)
            return
        key = (seed, place.name[: -len(suffix)])
        content = self.content(name)
        if content is None:
            return
        if key in self.files:
            self.contents.add(
                "duplicate-clip",
                name,
                expected="one file per clip and seed",
                found=f"also {self.files[key]}",
                fix="keep one of them",
            )
            return
        self.files[key] = name
        if suffix == FAILED:
            self.failures[key] = (
                " ".join(content.decode("utf-8", "replace").split())[:300] or "no reason given"
            )
            return
        prediction = parse_prediction(content, name[: -len(suffix)] + suffix, key[1])
        self.contents.problems.extend(prediction.problems)
        self.predictions[key] = prediction

    def check_layout(self) -> None:
        if self.loose and self.seeded:
            self.contents.add(
                "mixed-seeds",
                "",
                expected="all predictions at the top, or all in seed-<number> folders",
                found=f"{self.loose} at the top and {self.seeded} in seed folders",
                fix="move the files at the top into a seed folder of their own",
            )
        if not self.loose and not self.seeded:
            self.contents.add(
                "no-predictions",
                "",
                expected=f"one file per clip ({', '.join(SUFFIXES)})",
                found="none",
                fix="see docs/submit.md, or let 'mseg example-submission' write one",
            )

    def _seed(self, name: str, place: PurePosixPath) -> int | None:
        if len(place.parts) == 1:
            self.loose += place.suffix.lower() in (*SUFFIXES, FAILED)
            return 0
        folder = SEED_FOLDER.fullmatch(place.parts[0])
        if folder and len(place.parts) == 2:
            self.seeded += 1
            return int(folder[1])
        self.contents.add(
            "unknown-folder",
            name,
            expected="files at the top, or in folders seed-0, seed-1, ...",
            found=f"the folder {place.parent}",
            fix="name the folders seed-<number>, or move the files to the top",
        )
        return None

    def _odd_file(self, name: str, place: PurePosixPath) -> None:
        if place.suffix.lower() in (".txt", ".md", "") and place.name.lower().startswith(("readme", "licen")):
            return
        labels = place.suffix.lower() in _LABEL_FILES
        self.contents.add(
            "unknown-file",
            name,
            expected=f"{META} and files ending in {', '.join(SUFFIXES)} or {FAILED}",
            found=place.suffix or "no ending",
            fix=_CONVERT if labels else "remove it",
        )
