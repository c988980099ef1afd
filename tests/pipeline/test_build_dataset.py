"""A folder of clips: up to date or why not, failures, interruptions, bad input at the command line."""

from __future__ import annotations

import dataclasses
import errno
import importlib.util
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from build_scenes import FRAMES, HEIGHT, SIDE, WIDTH, on_patch, patch_corner, write_clip, write_masks

import kt3dmoseg
from kt3dmoseg import flow, pipeline, tracking
from kt3dmoseg.annotate import Annotation, load_annotation, proposals, save_annotation
from kt3dmoseg.annotate.model import PROPOSALS
from kt3dmoseg.cli import main
from kt3dmoseg.errors import (
    FileFormatError,
    InputFileError,
    InvalidValueError,
    KT3DMoSegError,
    MissingDependencyError,
)
from kt3dmoseg.files import hold_folder
from kt3dmoseg.frames import FrameFolder
from kt3dmoseg.io import hdf5, load
from kt3dmoseg.io.flow_files import write_flow
from kt3dmoseg.pipeline import build_dataset
from kt3dmoseg.tracking import RELIABLE
from kt3dmoseg.types import Labels

FLOW = ["--flow", "dis_medium"]


@pytest.fixture
def frames(tmp_path):
    for seed, name in enumerate(("a", "b", "c")):
        write_clip(tmp_path / "frames" / name, seed)
    return tmp_path / "frames"


def build(frames, output, **options):
    return build_dataset(frames, output, flow="dis_medium", workers=options.pop("workers", 1), **options)


def statuses(outcomes):
    return {outcome.name: outcome.status for outcome in outcomes}


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_one_file_per_clip_then_nothing_to_do(frames, tmp_path):
    assert statuses(build(frames, tmp_path / "out")) == dict.fromkeys("abc", "built")
    before = contents(tmp_path / "out")
    assert sorted(before) == ["a.h5", "b.h5", "c.h5"]
    assert statuses(build(frames, tmp_path / "out")) == dict.fromkeys("abc", "up to date")
    assert contents(tmp_path / "out") == before


def test_every_changed_byte_is_noticed_and_the_clip_built_again(frames, tmp_path):
    build(frames, tmp_path / "out")
    path = tmp_path / "out" / "a.h5"
    content = path.read_bytes()
    for at in range(50, len(content), 61):
        changed = bytearray(content)
        changed[at] ^= 16
        path.write_bytes(changed)
        with pytest.raises(KT3DMoSegError):
            load(path)
    assert statuses(build(frames, tmp_path / "out"))["a"] == "built"
    assert path.read_bytes() == content


def test_one_word_counts_as_the_options_it_means(frames, tmp_path, capsys):
    out = tmp_path / "out"
    build(frames, out)
    command = ["build", "--frames", str(frames), "-o", str(out), "--flow", "dis_medium", "--workers", "1"]
    assert main([*command, "--reliable"]) == 0
    assert "anchor was 0.0, now 1.0" in capsys.readouterr().out
    assert statuses(build(frames, out, **RELIABLE)) == dict.fromkeys("abc", "up to date")
    assert statuses(build(frames, out, reliable=True)) == dict.fromkeys("abc", "up to date")
    changed = build(frames, out, reliable=True, appearance=0.5)
    assert {outcome.reason for outcome in changed} == {
        f"options appearance was {RELIABLE['appearance']}, now 0.5"
    }


def test_any_number_of_workers_gives_the_same_bytes(frames, tmp_path):
    seen = []
    build(frames, tmp_path / "one")
    build(frames, tmp_path / "two", workers=2, progress=lambda *message: seen.append(message))
    assert contents(tmp_path / "one") == contents(tmp_path / "two")
    assert sorted(seen) == [(clip, k, FRAMES) for clip in "abc" for k in range(1, FRAMES + 1)]


def test_it_reports_why_it_rebuilds(frames, tmp_path, monkeypatch):
    out = tmp_path / "out"
    assert {o.reason for o in build(frames, out)} == {"new"}
    assert {o.reason for o in build(frames, out, spacing=6)} == {"options spacing was 8, now 6"}
    shutil.copy(frames / "b/000002.png", frames / "a/000003.png")
    outcomes = {o.name: o for o in build(frames, out, spacing=6)}
    assert outcomes["a"].reason == "source sha256 changed"
    assert outcomes["b"].status == "up to date"
    write_masks(tmp_path / "masks/b")
    outcomes = {o.name: o for o in build(frames, out, spacing=6, masks=tmp_path / "masks")}
    assert outcomes["b"].reason == "labels masks added"
    assert outcomes["b"].counts["motions"] == 2
    assert outcomes["a"].status == "up to date"
    (out / "c.h5").write_bytes(b"half a file")
    outcomes = {o.name: o for o in build(frames, out, spacing=6)}
    assert "no intact clip" in outcomes["c"].reason
    assert {o.reason for o in build(frames, out, spacing=6, force=True)} == {"forced"}
    monkeypatch.setattr(tracking, "ALGORITHM_VERSION", 0)
    assert {o.reason for o in build(frames, out, spacing=6)} == {"algorithms tracking was 1, now 0"}
    monkeypatch.setattr(pipeline, "ALGORITHM_VERSION", 0)
    assert {o.reason for o in build(frames, out, spacing=6)} == {"algorithms pipeline was 1, now 0"}
    monkeypatch.setattr(flow, "ALGORITHM_VERSION", 0)
    (reason,) = {o.reason for o in build(frames, out, spacing=6)}
    assert reason.startswith("flow algorithm was '1/")


def test_fields_from_files_are_read_every_time(frames, tmp_path):
    for folder in ("forward", "backward"):
        for number in range(FRAMES - 1):
            write_flow(tmp_path / folder / f"{number}.flo", np.zeros((HEIGHT, WIDTH, 2), np.float32))
    where = {name: str(tmp_path / name) for name in ("forward", "backward")} | {"frames": str(frames / "a")}
    for reason in ("new", "the fields of this flow backend may depend on more than its parameters"):
        (outcome,) = build_dataset(
            frames / "a", tmp_path / "out", flow="files", flow_parameters=where, workers=1
        )
        assert (outcome.status, outcome.reason) == ("built", reason)


def test_a_changed_comment_rebuilds_nothing(frames, tmp_path):
    packages = shutil.copytree(Path(kt3dmoseg.__file__).parent, tmp_path / "copy/kt3dmoseg")
    command = ["build", "--frames", str(frames), "-o", str(tmp_path / "out"), *FLOW, "--workers", "1"]
    for line in ("3 built, 0 up to date", "0 built, 3 up to date"):
        done = subprocess.run(
            [sys.executable, "-m", "kt3dmoseg", *command],
            cwd=packages.parent,  # first in the path of modules
            capture_output=True,
            text=True,
            check=True,
        )
        assert line in done.stdout
        for path in packages.rglob("*.py"):
            path.write_text(path.read_text() + "\n# a comment\n")


def test_a_clip_that_no_build_made_stays(frames, tmp_path):
    out = tmp_path / "out"
    build(frames / "a", out)
    clip = load(out / "a.h5")
    hdf5.write(dataclasses.replace(clip, provenance={"format": "by hand"}), out / "b.h5")
    before = contents(out)["b.h5"]
    outcomes = {o.name: o for o in build(frames, out)}
    assert (outcomes["a"].status, outcomes["b"].status, outcomes["c"].status) == (
        "up to date",
        "failed",
        "built",
    )
    assert "force=True" in outcomes["b"].reason
    assert contents(out)["b.h5"] == before
    assert {o.status for o in build(frames, out, force=True)} == {"built"}
    assert contents(out)["b.h5"] != before


def test_a_bad_clip_does_not_stop_the_others(frames, tmp_path, capsys):
    (frames / "b/000003.png").unlink()
    command = ["build", "--frames", str(frames), "-o", str(tmp_path / "out"), *FLOW]
    assert main([*command, "--workers", "1"]) == 2
    printed = capsys.readouterr()
    assert sorted(contents(tmp_path / "out")) == ["a.h5", "c.h5"]
    assert printed.err.count("\n") == 1
    assert "b failed" in printed.err
    assert "frame 3" in printed.err
    assert "2 built, 0 up to date, 1 failed" in printed.out


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (["--flow", "dsi"], "unknown flow 'dsi'"),
        (["--set", "alfa=3"], "alfa"),
        (["--annotations", "nowhere"], "nowhere: expected annotations"),
        (["--masks", "nowhere"], "nowhere: expected masks"),
    ],
)
def test_what_is_wrong_for_all_clips_is_reported_once_before_the_first(
    wrong, words, frames, tmp_path, capsys
):
    assert main(["build", "--frames", str(frames), "-o", str(tmp_path / "out"), *FLOW, *wrong]) == 2
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1
    assert words in printed.err
    assert "failed" not in printed.err + printed.out
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("folder", "words"),
    [
        ("", "expected one folder of masks per clip, as {masks}/a, found masks, and 3 clips"),
        ("d", "expected masks (.png) there, or in {masks}/a, found d"),
    ],
)
def test_masks_belong_to_a_clip_by_name(folder, words, frames, tmp_path, capsys):
    masks = tmp_path / "masks"
    write_masks(masks / folder)
    command = ["build", "--frames", str(frames), "-o", str(tmp_path / "out"), "--masks", str(masks), *FLOW]
    assert main(command) == 2
    assert words.format(masks=masks) in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@dataclasses.dataclass(frozen=True)
class Named(FrameFolder):
    name: str = "../elsewhere"


def test_proposals_of_unlabelled_clips_are_written_but_no_labels(frames, tmp_path, monkeypatch, capsys):
    def on_the_patch(request):
        assert len(request.frames) == FRAMES
        return Labels(1 + (on_patch(request.trajectories) == 1).astype(np.int64), background=1)

    monkeypatch.setattr(proposals.PROPOSERS, "load", lambda name: on_the_patch)
    notes, out = tmp_path / "notes", tmp_path / "out"
    save_annotation(notes / "a.json", Annotation("a", (WIDTH, HEIGHT), FRAMES))
    command = ["build", str(frames), "-o", str(out), "--annotations", str(notes), *FLOW]
    command += ["--spacing", "4", "--workers", "1"]
    assert main([*command, "--propose"]) == 0
    written = [notes / f"{name}.proposals.json" for name in "bc"]
    assert sorted(notes.glob("*.json")) == [notes / "a.json", *written]
    assert load(out / "b.h5").n_motions == 0
    (item,) = load_annotation(written[0], PROPOSALS).objects
    corner = np.array(patch_corner(0))
    assert np.abs(np.array(item.key_frames[0].polygons[0]) - corner - SIDE / 2).max() < SIDE
    with pytest.raises(FileFormatError, match="nobody has checked"):
        load_annotation(written[0])
    written[0].rename(notes / "b.json")  # as somebody may who takes them for labels
    capsys.readouterr()
    assert main(command) == 2
    assert "b failed" in (err := capsys.readouterr().err)
    assert "nobody has checked" in err
    written[1].write_bytes(b"kept")  # of an up to date clip
    build(frames, out, annotations=notes, propose=notes, spacing=4)
    assert written[1].read_bytes() == b"kept"


def test_a_name_does_not_lead_out_of_the_folder(frames, tmp_path):
    with pytest.raises(
        InvalidValueError, match=r"name of '.*': expected a clip's name.*found '../elsewhere'"
    ):
        build([Named(frames / "a")], tmp_path / "out")
    assert not (tmp_path / "elsewhere.h5").exists()


def test_a_folder_whose_name_is_not_utf_8_is_named(frames, tmp_path):
    (frames / "a").rename(frames / os.fsdecode(b"clip\xff"))
    with pytest.raises(InvalidValueError, match=r"name of '.*clip.udcff': expected a clip's name in UTF-8"):
        build(frames, tmp_path / "out")


def test_two_clips_of_one_name_are_both_named(frames, tmp_path):
    with pytest.raises(InvalidValueError, match=r"clip x: expected one source, found .*a and .*b; rename"):
        build([Named(frames / "a", name="x"), Named(frames / "b", name="x")], tmp_path / "out")


@pytest.mark.parametrize("workers", [1, 2])
def test_a_missing_package_is_reported_once(workers, frames, tmp_path):
    if importlib.util.find_spec("torch"):
        pytest.skip("torch is installed")
    with pytest.raises(MissingDependencyError, match="pip install"):
        build_dataset(frames, tmp_path / "out", flow="raft", workers=workers)
    assert not list((tmp_path / "out").glob("*"))


def test_clips_without_a_trajectory_are_reported_in_the_summary(tmp_path, capsys):
    for name, count in (("long", FRAMES), ("short", 4), ("shorter", 3)):
        write_clip(tmp_path / "frames" / name, frames=count)
    command = ["build", "--frames", str(tmp_path / "frames"), "-o", str(tmp_path / "out"), *FLOW]
    assert main([*command, "--workers", "1"]) == 0
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1
    assert "no trajectories in short (4 frames), shorter (3 frames); " in printed.err
    assert "--min-length 5 frames" in printed.err
    assert main([*command, "--workers", "1", "--min-length", "3"]) == 0
    assert capsys.readouterr().err == ""
    short = str(tmp_path / "frames" / "short")
    assert main(["track", short, "-o", str(tmp_path / "short.h5"), *FLOW]) == 0
    assert "no trajectories in" in capsys.readouterr().err


def _colour(folder):
    picture = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    picture[..., 2] = 90
    cv2.imwrite(str(folder / "000002.png"), picture)


def _rewrite(folder, picture):
    cv2.imwrite(str(folder / "000002.png"), picture)


def _cut_short(folder):
    file = folder / "000002.png"
    file.write_bytes(file.read_bytes()[:-200])


BAD = {
    "empty folder": (lambda f: [p.unlink() for p in f.iterdir()], "empty folder"),
    "one frame": (lambda f: [p.unlink() for p in sorted(f.iterdir())[1:]], "only 000001.png"),
    "two sizes": (lambda f: _rewrite(f, np.zeros((80, 90), np.uint8)), "expected 96x64 px.*found 90x80"),
    "colour": (_colour, "expected a gray picture, found colour; convert"),
    "16 bit": (lambda f: _rewrite(f, np.zeros((HEIGHT, WIDTH), np.uint16)), "8-bit picture, found 16 bits"),
    "corrupt": (_cut_short, "expected an intact picture"),
    "gap": (lambda f: (f / "000003.png").unlink(), "frame 3: .*without a gap"),
    "too thin": (lambda f: [_thin(p) for p in f.iterdir()], "at least 32"),
}


def _thin(path):
    cv2.imwrite(str(path), np.zeros((16, 64), np.uint8))


@pytest.mark.parametrize("name", BAD)
def test_bad_frames_are_one_line_and_leave_nothing(name, tmp_path, capfd):
    import re

    spoil, words = BAD[name]
    folder = write_clip(tmp_path / "clip")
    spoil(folder)
    code = main(["build", "--frames", str(folder), "-o", str(tmp_path / "out"), *FLOW])
    printed = capfd.readouterr().err
    assert code == 2
    assert printed.count("\n") == 1
    assert re.search(words, printed), printed
    assert str(folder) in printed
    assert not list((tmp_path / "out").glob("*"))


def test_colour_is_built_when_its_luma_is_asked_for(tmp_path):
    folder = write_clip(tmp_path / "clip")
    for path in folder.iterdir():
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        cv2.imwrite(str(path), np.dstack([picture, picture, 255 - picture]))
    build(folder, tmp_path / "out", colour="luma")
    assert len(load(tmp_path / "out/clip.h5").dense) > 0


def test_a_file_where_the_output_folder_should_be(frames, tmp_path, capsys):
    (tmp_path / "out").write_text("in the way")
    assert main(["build", "--frames", str(frames), "-o", str(tmp_path / "out"), *FLOW]) == 2
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1
    assert "cannot write" in printed


def test_a_read_only_output_folder(frames, tmp_path, monkeypatch):
    def refuse(**_):  # root may write anywhere
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr("tempfile.TemporaryFile", refuse)
    with pytest.raises(InputFileError, match="out: cannot write: Read-only file system; "):
        build(frames, tmp_path / "out")
    assert not (tmp_path / "out").exists()


_FULL_DISK = """
import resource, signal, sys
from kt3dmoseg.cli import main
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
sys.exit(main(sys.argv[1:]))
"""


def test_a_full_disk(frames, tmp_path):
    command = ["build", "--frames", str(frames / "a"), "-o", str(tmp_path / "out"), *FLOW, "--workers", "1"]
    done = subprocess.run(
        [sys.executable, "-c", _FULL_DISK, *command], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "cannot write" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not list((tmp_path / "out").glob("*"))


def test_two_builds_do_not_share_a_folder(frames, tmp_path):
    with hold_folder(tmp_path / "out"), pytest.raises(InputFileError, match="another build running"):
        build(frames, tmp_path / "out")


def test_bad_numbers_of_workers(frames, tmp_path):
    with pytest.raises(InvalidValueError, match="workers: expected a whole number, at least 1"):
        build(frames, tmp_path / "out", workers=0)


def _start(frames, output):
    command = ["build", "--frames", str(frames), "-o", str(output), "--workers", "2"]
    # Its own session, so that signals reach it and its workers as from a terminal.
    return subprocess.Popen(
        [sys.executable, "-m", "kt3dmoseg", *command],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def _wait_for_a_clip(process, output):
    while not list(output.glob("*.h5")):
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.01)


def _wait_for_the_end(group):
    """Wait until no process of the group is left: workers end with their parent."""
    while True:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return
        time.sleep(0.02)


@pytest.fixture(scope="module")
def twelve(tmp_path_factory):
    """So many clips that a build still works when the signal comes, and what an undisturbed one makes."""
    frames, built = tmp_path_factory.mktemp("frames"), tmp_path_factory.mktemp("built")
    for seed in range(12):
        write_clip(frames / f"clip{seed}", seed)
    build_dataset(frames, built, workers=1)
    return frames, contents(built)


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_build_resumes_to_the_same_bytes(how, twelve, tmp_path):
    frames, undisturbed = twelve
    process = _start(frames, tmp_path / "out")
    _wait_for_a_clip(process, tmp_path / "out")
    if how == signal.SIGINT:
        os.killpg(process.pid, how)
    else:
        process.send_signal(how)
    printed = process.communicate()[1]
    _wait_for_the_end(process.pid)
    assert process.returncode == (130 if how == signal.SIGINT else -how)
    if how == signal.SIGINT:
        assert printed == "kt3dmoseg: interrupted; what was finished is kept\n"
    finished = {path.name: path.read_bytes() for path in (tmp_path / "out").glob("*.h5")}
    assert 1 <= len(finished) < 12
    for name in finished:
        hdf5.read(tmp_path / "out" / name)
    (tmp_path / "out/.clip5.h5.before.part").write_bytes(b"half")
    outcomes = build_dataset(frames, tmp_path / "out", workers=1)
    assert {f"{o.name}.h5" for o in outcomes if o.status == "up to date"} == set(finished)
    assert contents(tmp_path / "out") == undisturbed


@dataclasses.dataclass(frozen=True)
class Deadly(FrameFolder):
    """Frames whose reading ends the process, as when memory runs out."""

    def frames(self, colour):
        os.kill(os.getpid(), signal.SIGKILL)


def test_a_clip_that_kills_its_workers_fails_alone(frames, tmp_path):
    sources = [FrameFolder(frames / "a"), Deadly(frames / "b"), FrameFolder(frames / "c")]
    outcomes = {outcome.name: outcome for outcome in build(sources, tmp_path / "out", workers=2)}
    assert statuses(outcomes.values()) == {"a": "built", "b": "failed", "c": "built"}
    assert "died 3 times; perhaps memory ran out: run again with fewer workers" in outcomes["b"].reason
