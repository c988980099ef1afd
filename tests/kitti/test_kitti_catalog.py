"""Catalogs: the built-in one, users' own, and every problem of a file in one go."""

from __future__ import annotations

import pickle
from pathlib import Path

import cv2
import kitti_drives as drives
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kt3dmoseg import catalog, cli
from kt3dmoseg.catalog import Drive, Entry, Fingerprint, fingerprint, format_numbers, parse_numbers
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError, UnknownNameError

MARK = Fingerprint(0x89ABCDEF, 1234, "0" * 64)


def test_built_in_catalog_is_complete() -> None:
    clips = catalog.load()
    assert len(clips) == 22
    assert "Seq028_clip03" in clips
    assert clips["Seq071_Clip01"].drive == Drive("2011_09_29", 71)
    assert {clip.size for clip in clips.values()} == {(1242, 375), (1224, 370), (1238, 374)}
    assert all(len(clip.frames) == clip.length for clip in clips.values())


@pytest.mark.parametrize("value", [5, "5", "05", "0005"])
def test_drive_numbers_may_be_spelt_as_text(value: object) -> None:
    assert Drive("2011_09_26", value).name == "2011_09_26_drive_0005"


@given(st.sets(st.integers(0, 300), min_size=1))
def test_numbers_written_and_read_are_the_same(numbers: set[int]) -> None:
    assert parse_numbers(format_numbers(sorted(numbers))) == tuple(sorted(numbers))


@pytest.mark.parametrize("text", ["", "5-", "9-5", "a", "1,,2", "-3", "1.5", "0-9999999999", "3 - 5"])
def test_nonsense_numbers_are_refused(text: str) -> None:
    with pytest.raises(InvalidValueError, match="40-59"):
        parse_numbers(text)


clips = st.builds(
    lambda name, drive, camera, n, size, marks: Entry(
        name, Drive("2011_09_28", drive), camera, n, size, tuple(range(7, 7 + n)), (marks,) * n
    ),
    st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_-]{0,20}", fullmatch=True),
    st.integers(0, 9999),
    st.integers(0, 3),
    st.integers(1, 5),
    st.none() | st.tuples(st.integers(1, 2000), st.integers(1, 2000)),
    st.builds(Fingerprint, st.integers(0, 2**32 - 1), st.integers(0, 10**7), st.just("a" * 64)),
)


@given(st.lists(clips, max_size=4, unique_by=lambda clip: clip.name))
def test_catalog_written_and_read_is_the_same(
    tmp_path_factory: pytest.TempPathFactory, made: list[Entry]
) -> None:
    path = tmp_path_factory.mktemp("catalog") / "mine.toml"
    catalog.save(path, made, comment="two\nlines")
    assert list(catalog.load(path, built_in=False).values()) == made


def test_source_and_proof_survive_odd_characters(tmp_path: Path) -> None:
    entry = Entry("A", Drive("2011_09_26", 1), 0, 1, None, (3,), (), "crc32", 'C:\\new "folder"\n')
    catalog.save(tmp_path / "a.toml", [entry])
    assert catalog.load(tmp_path / "a.toml", built_in=False)["A"] == entry
    assert pickle.loads(pickle.dumps(entry)) == entry


GOOD = 'date = "2011_09_26"\ndrive = 5\ncamera = 0\nlength = 2\nnumbers = "3-4"\n'


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[clips.A", "not TOML"),
        ("a = " + "[" * 100_000, "not TOML"),
        ("a = " + "1" * 5000, "not TOML"),
        ("clips = 3", r"expected tables \[clips.NAME\]"),
        ("[clip.A]\n" + GOOD, "unknown key 'clip'; did you mean 'clips'"),
        ("[clips.A]\n" + GOOD + "camra = 1", "did you mean 'camera'"),
        ("[clips.A]\n" + GOOD.replace("drive = 5\n", ""), "drive: expected a value"),
        ("[clips.A]\n" + GOOD.replace("= 5", "= 5.0"), "drive: expected a whole number"),
        ("[clips.A]\n" + GOOD.replace("= 5", "= true"), "drive: expected a whole number"),
        ("[clips.A]\n" + GOOD.replace("2011_09_26", "26.9.2011"), "date: expected the form"),
        ("[clips.A]\n" + GOOD.replace("2011_09_26", "2011_13_26"), "date: expected the form"),
        ("[clips.A]\n" + GOOD.replace("camera = 0", "camera = 4"), "camera"),
        (
            "[clips.A]\n" + GOOD.replace("length = 2", "length = 3"),
            "expected 3, the length, found 2",
        ),
        ("[clips.A]\n" + GOOD.replace("length = 2", "length = 0"), "length"),
        ("[clips.A]\n" + GOOD.replace("3-4", "4,3"), "ascending"),
        ("[clips.A]\n" + GOOD.replace('numbers = "3-4"\n', ""), "numbers or frames"),
        ("[clips.A]\n" + GOOD + "size = [3]", "size: expected"),
        ("[clips.A]\n" + GOOD + "frames = [3]", r"frames\[0\]"),
        ("[clips.A]\n" + GOOD + 'frames = [{crc32 = "xyz", bytes = 1, pixels = ""}]', "8 hexadecimal"),
        ("[clips.A]\n" + GOOD + "frames = 3", "frames: expected a list"),
        ('[clips."../A"]\n' + GOOD, "name: expected letters"),
        ("[clips]\nA = 3", "expected a table"),
    ],
)
def test_each_problem_is_one_line(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=reason):
        catalog.load(path)


def test_numbers_that_are_written_as_texts_are_numbers() -> None:
    found = catalog.Fingerprint("12", "294096", "0" * 64)
    assert (found.crc32, found.bytes) == (12, 294096)
    entry = catalog.Entry("A", catalog.Drive("2011_09_26", 5), 0, "2", numbers=(1, 2))
    assert entry.length == 2


def test_missing_catalog_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match=r"none\.toml"):
        catalog.load(tmp_path / "none.toml")


def test_name_of_the_built_in_catalog_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("[clips.Seq005_Clip01]\n" + GOOD)
    with pytest.raises(FileFormatError, match="taken by another catalog"):
        catalog.load(path)
    assert len(catalog.load(path, built_in=False)) == 1


def test_selecting_keeps_the_order_asked_for() -> None:
    names = ["Seq071_Clip01", "Seq005_Clip01"]
    assert [entry.name for entry in catalog.choose(names)] == names
    assert len(catalog.choose([])) == 22
    with pytest.raises(UnknownNameError, match="did you mean 'Seq028_clip03'"):
        catalog.choose(["Seq028_Clip03_"])


def test_command_adds_lists_and_checks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mine, frames = str(tmp_path / "mine.toml"), tmp_path / "frames"
    frames.mkdir()
    for k in range(3):
        cv2.imwrite(str(frames / f"{k}.png"), drives.picture(k))
    where = ["--date", "2011_09_26", "--drive", "0005", "--catalog", mine]
    assert cli.main(["catalog", "add", "ByNumbers", *where, "--camera", "2", "--numbers", "40-59"]) == 0
    assert cli.main(["catalog", "add", "ByFrames", *where, "--frames", str(frames)]) == 0
    assert cli.main(["catalog", "add", "ByFrames", *where, "--numbers", "1"]) == 2
    assert cli.main(["catalog", "add", "Seq005_Clip01", *where, "--numbers", "1"]) == 2
    assert cli.main(["catalog", "add", "Nothing", *where]) == 2
    added = catalog.load(mine, built_in=False)
    assert added["ByNumbers"].numbers == tuple(range(40, 60))
    content = (frames / "1.png").read_bytes()
    assert added["ByFrames"].frames[1] == fingerprint(content, drives.picture(1))
    assert added["ByFrames"].size == drives.SIZE
    capsys.readouterr()
    assert cli.main(["catalog", "list", "--catalog", mine]) == 0
    out = capsys.readouterr().out
    assert out.count("\n") == 25
    assert "ByNumbers" in out
    assert "40-59" in out
    assert cli.main(["catalog", "check", mine]) == 0
    Path(mine).write_text("[clips.A]\ncamera = 9\n[clips.B]\nx = 1\n" + "[clips.C]\n" + GOOD)
    assert cli.main(["catalog", "check", mine]) == 2
    out = capsys.readouterr().out
    assert "clips.A" in out
    assert "clips.B" in out
    assert "1 clips, 2 problems" in out
    assert cli.main(["catalog", "check"]) == 0
