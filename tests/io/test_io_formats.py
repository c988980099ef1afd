"""Contract of every clip format, and what `load` and `save` report about files they cannot use."""

from __future__ import annotations

import os
import pickle
import time
from dataclasses import replace

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from io_clips import assert_same, assert_same_tracks, clips, small_clip

import kt3dmoseg
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.io import load, save
from kt3dmoseg.io.formats import FORMATS
from kt3dmoseg.io.info import info

SUFFIXES = [f.suffix for f in FORMATS]
LOSSLESS = [".h5", ".npz"]
quick = settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_trajectories_and_labels_survive(suffix, tmp_path):
    clip, path = small_clip(), tmp_path / f"tiny{suffix}"
    save(clip, path)
    back = load(path)
    assert_same_tracks(clip.dense, back.dense)
    np.testing.assert_array_equal(
        [2] if suffix == ".dat" else clip.labels.label[clip.evaluated == 5],
        back.labels.label[back.evaluated == 5],
    )
    assert back.name == "tiny"


@pytest.mark.parametrize("suffix", LOSSLESS)
@given(clip=clips())
@quick
def test_everything_survives(suffix, clip, tmp_path):
    save(clip, tmp_path / f"clip{suffix}")
    assert_same(clip, load(tmp_path / f"clip{suffix}"))


@pytest.mark.parametrize("suffix", [".mat", ".dat"])
@given(clip=clips())
@quick
def test_coordinates_keep_every_bit(suffix, clip, tmp_path):
    save(clip, tmp_path / f"clip{suffix}")
    assert_same_tracks(clip.dense, load(tmp_path / f"clip{suffix}").dense)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_equal_clips_give_equal_bytes(suffix, tmp_path, monkeypatch):
    save(small_clip(), tmp_path / f"a{suffix}")
    monkeypatch.setattr(time, "time", lambda: 0.0)
    monkeypatch.setenv("TZ", "Asia/Tokyo")
    save(load(tmp_path / f"a{suffix}") if suffix in LOSSLESS else small_clip(), tmp_path / f"b{suffix}")
    assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_content_decides_not_the_suffix(suffix, tmp_path):
    save(small_clip(), tmp_path / f"tiny{suffix}")
    (tmp_path / f"tiny{suffix}").rename(tmp_path / "tiny.clip")
    assert len(load(tmp_path / "tiny.clip").dense) == 6


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_truncated_file_is_one_line(suffix, tmp_path):
    save(small_clip(), tmp_path / f"whole{suffix}")
    content = (tmp_path / f"whole{suffix}").read_bytes()
    path = tmp_path / f"cut{suffix}"
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(KT3DMoSegError) as caught:
        load(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_nothing_is_written_into_a_read_only_folder(suffix, tmp_path):
    folder = tmp_path / "closed"
    folder.mkdir()
    (folder / "file").write_text("a file where a folder is needed")
    with pytest.raises(InputFileError, match="cannot write"):
        save(small_clip(), folder / "file" / f"clip{suffix}")


def test_an_unknown_suffix_is_refused_with_the_known_ones(tmp_path):
    with pytest.raises(InvalidValueError, match=r"\.h5, \.mat, \.npz, \.dat"):
        save(small_clip(), tmp_path / "clip.csv")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "empty file; is the file complete"),
        (b"<html>not found</html>", "a web page; fetch the file itself"),
        (pickle.dumps({"video": 1}), "a pickle.*savez"),
    ],
)
def test_other_files_are_named_for_what_they_are(content, words, tmp_path):
    path = tmp_path / "clip.npz"
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match=words):
        load(path)


def test_a_missing_file_is_reported_as_missing(tmp_path):
    with pytest.raises(InputFileError, match="no such file"):
        load(tmp_path / "nothing.h5")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
@pytest.mark.parametrize("read", [load, info])
def test_a_pipe_is_not_waited_for(read, tmp_path):
    os.mkfifo(tmp_path / "a.h5")
    with pytest.raises(InputFileError, match=r"a\.h5: expected a file, found a pipe or device"):
        read(tmp_path / "a.h5")


def test_an_unreadable_file_is_one_line(tmp_path):
    path = tmp_path / "loop.h5"
    path.symlink_to(path)
    with pytest.raises(InputFileError):
        load(path)


def test_a_folder_of_one_clip_loads_and_one_of_two_does_not(tmp_path):
    save(small_clip(), tmp_path / "a.h5")
    assert load(tmp_path).name == "tiny"
    save(small_clip(), tmp_path / "b.h5")
    with pytest.raises(InputFileError, match=r"give one, e.g. .*a\.h5; load_dataset reads them all"):
        load(tmp_path)


def test_the_public_names_lead_here():
    assert kt3dmoseg.load is load
    assert kt3dmoseg.save is save


def test_a_name_that_leads_elsewhere_is_neither_written_nor_read(tmp_path):
    clip = small_clip()
    with pytest.raises(InvalidValueError, match=r"name: expected a clip's name.*\.\./up"):
        save(replace(clip, name="../up"), tmp_path / "a.h5")
    save(clip, tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as stream:
        stream.attrs["name"] = b"../up"
    with pytest.raises(FileFormatError, match=r"a\.h5: name: expected a clip's name"):
        load(tmp_path / "a.h5")
