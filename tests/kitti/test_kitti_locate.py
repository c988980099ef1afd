"""Locating clips: exact evidence, graded evidence, ambiguity, and the command."""

from __future__ import annotations

from pathlib import Path

import cv2
import kitti_drives as drives
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kitti_world import FRAMES, HIDDEN, QUICK, SYNC, World

from kt3dmoseg import catalog, cli
from kt3dmoseg.errors import InputFileError
from kt3dmoseg.files import sha256_arrays
from kt3dmoseg.kitti.http import Traffic
from kt3dmoseg.kitti.locating import (
    NotLocatedError,
    descriptor,
    locate,
    match_exact,
    match_graded,
)
from kt3dmoseg.kitti.raw import fingerprint_folder

FOLDER = f"{drives.DATE}/{drives.NAME}_sync/image_00/data"
SIZE = (320, 96)


def test_frames_with_one_equal_each_are_proved() -> None:
    assert match_exact([[4], [5], [7]]).numbers == (4, 5, 7)


def test_repeated_frames_are_decided_by_a_constant_step() -> None:
    # A parked car: frames 5 and 6 are equal; only 4, 5, 6 has one step.
    assert match_exact([[4], [5, 6], [5, 6]]).numbers == (4, 5, 6)


def test_two_matches_are_ambiguous_and_both_are_named() -> None:
    verdict = match_exact([[4, 40], [5, 41], [6, 42]])
    assert verdict.numbers is None
    assert verdict.ambiguous
    assert verdict.candidates == ("4-6 (all frames equal)", "40-42 (all frames equal)")


def test_frames_out_of_order_are_not_a_clip() -> None:
    verdict = match_exact([[5], [4]])
    assert verdict.numbers is None
    assert "not in ascending order" in verdict.candidates[0]


def test_partial_match_names_the_best_candidate() -> None:
    verdict = match_exact([[10], [], [12], [50]])
    assert verdict.numbers is None
    assert verdict.candidates[0] == "10-13 (2 of 4 frames equal)"
    assert match_exact([[], []]).candidates == ()


@given(st.integers(1, 12), st.integers(0, 1000), st.integers(1, 3))
def test_any_steady_run_is_found(length: int, first: int, step: int) -> None:
    numbers = tuple(range(first, first + length * step, step))
    assert match_exact([[n] for n in numbers]).numbers == numbers


def _similarity(first: int, n: int, length: int = 4, best: float = 0.95, other: float = 0.5) -> np.ndarray:
    matrix = np.full((length, n), other)
    matrix[np.arange(length), first + np.arange(length)] = best
    return matrix


def test_graded_match_needs_height_margin_and_agreement() -> None:
    numbers = list(range(100, 120))
    assert match_graded(_similarity(7, 20), numbers).numbers == (107, 108, 109, 110)
    assert match_graded(_similarity(7, 20, best=0.7), numbers).numbers is None
    close = match_graded(_similarity(7, 20, other=0.94), numbers)
    assert close.numbers is None
    assert close.ambiguous
    torn = _similarity(7, 20)
    torn[0, 0] = torn[1, 0] = 0.99
    assert match_graded(torn, numbers).numbers is None
    assert match_graded(np.zeros((4, 2)), [1, 2]).candidates == ()


def test_graded_match_respects_holes_in_the_drive() -> None:
    numbers = [*range(10), *range(20, 30)]
    # Columns 8..11 look best but belong to frames 8, 9, 20, 21: not consecutive.
    assert match_graded(_similarity(8, 20), numbers).numbers is None
    assert match_graded(_similarity(12, 20), numbers).numbers == (22, 23, 24, 25)


def test_descriptor_is_a_unit_vector_and_blind_to_brightness() -> None:
    image = drives.picture(1, size=SIZE) // 2
    brighter = image + 100
    assert descriptor(image) @ descriptor(image) == pytest.approx(1.0, abs=1e-5)
    assert descriptor(image) @ descriptor(brighter) == pytest.approx(1.0, abs=1e-3)
    assert descriptor(np.zeros((96, 320), np.uint8)).tolist() == [0.0] * (96 * 320)


def _locate(world: World, *clips: str, **options: object) -> dict[str, catalog.Entry]:
    world.traffic = Traffic()
    return locate(
        world.root,
        clips or ("Hidden",),
        catalogs=[world.catalog],
        traffic=world.traffic,
        report=world.lines.append,
        mirror=world.server.url,
        **{k: v for k, v in QUICK.items() if k != "accept_license"} | options,
    )


def test_directory_alone_is_enough(world: World) -> None:
    found = _locate(world)["Hidden"]
    assert (found.numbers, found.proof, found.camera) == (HIDDEN, "crc32", 0)
    assert len(world.server.requests) == 2
    assert world.server.sent < 80_000
    written = catalog.load(world.root / "located.toml", built_in=False)["Hidden"]
    assert written == found
    assert world.lines == [f"Hidden: {drives.NAME} camera 0 frames 11-16 (crc32)"]


def test_pull_after_locate_reads_no_directory_again(world: World) -> None:
    _locate(world)
    world.server.reset()
    world.pull()
    assert len(world.server.requests_for(SYNC)) <= 3  # timestamps, frames, packets


def test_clip_of_the_other_camera_is_found_there(world: World) -> None:
    world.serve({name.replace("image_00", "image_01"): c for name, c in world.files.items()})
    assert _locate(world)["Hidden"].camera == 1
    world.pull()
    assert (world.root / FOLDER.replace("image_00", "image_01") / "0000000011.png").exists()


def _recode(world: World, change) -> None:
    frames = {
        f"{FOLDER}/{k:010d}.png": drives.encode(change(drives.picture(k, size=SIZE)), level=0)
        for k in range(FRAMES)
    }
    world.serve(world.files | frames)


def test_other_compression_is_found_by_pixels_and_pull_uses_it(world: World) -> None:
    _recode(world, lambda image: image)
    with pytest.raises(NotLocatedError, match="kt3dmoseg locate compares pixels"):
        world.pull()
    assert _locate(world)["Hidden"].proof == "pixels"
    world.pull()
    world.check()


def test_local_copies_are_compared_by_pixels_without_asking(world: World, tmp_path: Path) -> None:
    _recode(world, lambda image: image)
    drives.write_files(tmp_path / "here", world.files | drives.calibration_files())
    world.pull(local=str(tmp_path / "here"))
    world.check()


def _own(world: World, folder: Path) -> Path:
    folder.mkdir()
    for index, number in enumerate(HIDDEN):
        cv2.imwrite(str(folder / f"{index + 1:06d}.png"), drives.picture(number, size=SIZE))
    return folder


def test_lossy_copies_are_found_by_correlation(world: World, tmp_path: Path) -> None:
    def worse(image: np.ndarray) -> np.ndarray:
        smooth = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 60])[1]
        return cv2.imdecode(smooth, cv2.IMREAD_GRAYSCALE)

    _recode(world, worse)
    with pytest.raises(NotLocatedError, match=r"given their folder"):
        _locate(world)
    found = _locate(world, frames=str(_own(world, tmp_path / "own")))["Hidden"]
    assert (found.numbers, found.proof) == (HIDDEN, "correlation")
    assert world.pull().files == 18


def test_clip_of_another_drive_is_not_found_and_candidates_are_named(world: World, tmp_path: Path) -> None:
    _recode(world, lambda image: image[::-1].copy())
    with pytest.raises(NotLocatedError, match=r"no match .* best candidates: \d+-\d+ \(correlation 0\.\d+\)"):
        _locate(world, frames=str(_own(world, tmp_path / "own")))
    assert not (world.root / "located.toml").exists()


def test_clip_that_is_there_twice_is_ambiguous(world: World) -> None:
    copies = {f"{FOLDER}/{k + 100:010d}.png": world.files[f"{FOLDER}/{k:010d}.png"] for k in range(FRAMES)}
    world.serve(world.files | copies)
    with pytest.raises(
        NotLocatedError, match=r"several matches .* 11-16 .* 111-116 .* numbers into a catalog"
    ):
        _locate(world)
    assert world.traffic.bytes < 150_000  # the directory, twice; there is no use in reading the frames


def test_given_numbers_decide_between_equal_matches(world: World) -> None:
    copies = {f"{FOLDER}/{k + 100:010d}.png": world.files[f"{FOLDER}/{k:010d}.png"] for k in range(FRAMES)}
    world.serve(world.files | copies)
    text = world.catalog.read_text()
    world.catalog.write_text(text.replace("length = 6", 'length = 6\nnumbers = "111-116"'))
    assert _locate(world)["Hidden"].numbers == tuple(range(111, 117))


def test_all_clips_are_tried_before_the_error(world: World) -> None:
    text = world.catalog.read_text()
    other = text.replace("clips.Hidden", "clips.Aaa").replace('crc32 = "', 'crc32 = "0').splitlines()
    other = [line.replace('", bytes', '"; bytes') for line in other]
    fixed = [line.replace('crc32 = "0', 'crc32 = "').replace('"; bytes = ', '", bytes = 1') for line in other]
    world.catalog.write_text("\n".join(fixed) + "\n" + text)
    with pytest.raises(NotLocatedError, match="1 of 2 clips were not located: found Aaa"):
        _locate(world, "Aaa", "Hidden", pixels=False)
    assert "Hidden" in catalog.load(world.root / "located.toml", built_in=False)


def test_a_clip_without_frames_of_its_own_does_not_stop_the_others(world: World, tmp_path: Path) -> None:
    text = world.catalog.read_text()
    world.catalog.write_text(text.replace("clips.Hidden", "clips.Aaa") + "\n" + text)
    _recode(world, lambda image: image[::-1].copy())
    _own(world, tmp_path / "Hidden").rename(tmp_path / "own")
    (tmp_path / "both" / "Aaa").mkdir(parents=True)
    (tmp_path / "own").rename(tmp_path / "both" / "Hidden")
    with pytest.raises(NotLocatedError, match="2 of 2 clips were not located: found Aaa, Hidden"):
        _locate(world, "Aaa", "Hidden", frames=str(tmp_path / "both"))


def test_drive_that_the_server_lacks_does_not_stop_the_others(world: World) -> None:
    with pytest.raises(NotLocatedError, match="1 of 2 clips were not located: found Seq071_Clip01"):
        _locate(world, "Seq071_Clip01", "Hidden")
    assert "answered 404" in world.lines[0]
    assert "frames 11-16" in world.lines[1]
    with pytest.raises(OSError, match="answered 404"):
        _locate(world, "Seq071_Clip01")


def test_server_without_ranges_sends_the_zip_once_for_locate_and_pull(world: World) -> None:
    world.server.ranges = False
    assert _locate(world)["Hidden"].numbers == HIDDEN
    assert "sends whole files only; fetching all" in world.lines[0]
    world.server.reset()
    world.pull()
    world.check()
    assert world.server.requests_for("_sync") == []
    assert not list(world.root.rglob("*.zip"))


def test_command_line(world: World, capsys: pytest.CaptureFixture[str]) -> None:
    line = world.command("locate")
    assert cli.main(line) == 0
    assert "frames 11-16 (crc32)" in capsys.readouterr().out


def test_a_clips_own_frames_go_by_number_and_are_png(tmp_path: Path) -> None:
    pictures = [drives.picture(k, size=(320, 96)) for k in range(3)]
    for number, picture in zip((9, 10, 11), pictures, strict=True):  # "10" sorts before "9"
        (tmp_path / f"frame{number}.png").write_bytes(drives.encode(picture))
    (tmp_path / "._frame9.png").write_bytes(b"left by macOS")
    marks, size = fingerprint_folder(tmp_path)
    assert size == (320, 96)
    assert [mark.pixels for mark in marks] == [sha256_arrays(picture) for picture in pictures]
    (tmp_path / "frame12.jpg").write_bytes(b"x")
    with pytest.raises(InputFileError, match="expected the clip's PNG files, found frame12"):
        fingerprint_folder(tmp_path)
