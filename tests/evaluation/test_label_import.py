"""Label vectors as people have them become valid submissions."""

import contextlib
import os
import re
from dataclasses import replace

import h5py
import numpy as np
import pytest
from evaluation_helpers import CLIPS, NAMES, truth
from scipy.io import savemat

import kt3dmoseg
import mseg.cli
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.types import Labels
from mseg.evaluation import score_submission, validate_submission
from mseg.evaluation.example import (
    read_brox_labels,
    read_label_files,
    read_label_text,
)


@pytest.fixture
def data(tmp_path):
    for name, clip in CLIPS.items():
        kt3dmoseg.save(clip, tmp_path / "data" / f"{name}.h5")
    return tmp_path / "data"


def cells(*vectors):
    out = np.empty((1, len(vectors)), dtype=object)
    out[0, :] = vectors
    return out


def same(found):
    assert sorted(found) == NAMES
    for name in NAMES:
        np.testing.assert_array_equal(found[name], truth()[name])


def test_cells_of_the_authors_scripts(tmp_path):
    vectors = [truth()[name].astype(np.uint8)[:, None] for name in NAMES]
    savemat(tmp_path / "Error.mat", {"ClusterIdx": cells(*vectors), "error": [0.1, 0.2]})
    same(read_label_files(tmp_path / "Error.mat", CLIPS))


def test_cells_of_all_clips_of_a_benchmark_by_its_list_of_names(tmp_path):
    names = ["other", *NAMES]
    vectors = [np.ones((3, 1)), *(truth()[name].astype(float)[None] for name in NAMES)]
    savemat(tmp_path / "r.mat", {"ClusterIdx": cells(*vectors)})
    same(read_label_files(tmp_path / "r.mat", CLIPS, names=names))
    with pytest.raises(FileFormatError, match="2 cells"):
        read_label_files(tmp_path / "r.mat", CLIPS)


def test_damaged_and_old_mat_files_are_named(tmp_path):
    path = tmp_path / "r.mat"
    savemat(path, {"ClusterIdx": cells(*truth().values())})
    content = path.read_bytes()
    for at in range(128, len(content), 17):
        path.write_bytes(content[:at] + bytes([content[at] ^ 0x41]) + content[at + 1 :])
        with contextlib.suppress(KT3DMoSegError):
            read_label_files(path, CLIPS)
    savemat(path, {"labels": np.ones(9)}, format="4")
    with pytest.raises(FileFormatError, match="version 4 MAT-file; save it in MATLAB with the option '-v7'"):
        read_label_files(path, CLIPS)


def test_version_73_is_refused_with_what_to_do(tmp_path):
    with h5py.File(tmp_path / "r.mat", "w", userblock_size=512) as file:
        file["ClusterIdx"] = np.ones(3)
    with (tmp_path / "r.mat").open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(128))
    with pytest.raises(FileFormatError, match=r"version 7\.3 .*'-v7'"):
        read_label_files(tmp_path / "r.mat", CLIPS)


def test_empty_cell_is_a_clip_without_labels(tmp_path):
    savemat(tmp_path / "r.mat", {"ClusterIdx": cells(np.zeros((0, 0)), truth()[NAMES[1]])})
    assert list(read_label_files(tmp_path / "r.mat", CLIPS)) == [NAMES[1]]


def test_text_mat_and_all_trajectories_in_a_folder(tmp_path):
    every = np.zeros(len(CLIPS[NAMES[0]].dense), dtype=int)
    every[CLIPS[NAMES[0]].evaluated] = truth()[NAMES[0]]
    (tmp_path / f"{NAMES[0]}.txt").write_text("# labels\n" + "\r\n".join(map(str, every)) + "\n\n")
    savemat(tmp_path / f"{NAMES[1]}_Tracks.mat", {"groups": truth()[NAMES[1]][:, None], "k": 3})
    (tmp_path / "readme.txt").write_text("hello")
    same(read_label_files(tmp_path, CLIPS))


def test_brox_labels_as_the_file_has_them(tmp_path):
    path = tmp_path / "x.dat"
    path.write_text("2\n4\n0 1\n1 1 0\n1 2\n1 1 0\n2 2 1\n-1 1\n3 3 1\n1\n1\n4 4 0\n")
    assert read_brox_labels(path).tolist() == [0, 1, -1, 1]


def test_brox_files_mean_what_they_do_as_clips(tmp_path):
    for name, clip in CLIPS.items():
        kt3dmoseg.save(clip, tmp_path / f"{name}.dat")
    same(read_label_files(tmp_path, CLIPS))  # 0: not evaluated
    for file in tmp_path.iterdir():  # -1 for that, and clusters from 0
        less = re.sub(r"(?m)^(\d+) (\d+)$", lambda m: f"{int(m[1]) - 1} {m[2]}", file.read_text())
        file.write_text(less)
    same(read_label_files(tmp_path, CLIPS))


def test_label_0_of_a_brox_file_is_asked_about(tmp_path):
    for name, clip in CLIPS.items():
        label = clip.labels.label.copy()
        label[:5] = 0
        kt3dmoseg.save(replace(clip, labels=Labels(label)), tmp_path / f"{name}.dat")
    with pytest.raises(InvalidValueError, match="state what it is"):
        read_label_files(tmp_path, CLIPS)
    assert (read_label_files(tmp_path, CLIPS, zero="outlier")[NAMES[0]][:5] == 0).all()


@pytest.mark.parametrize(
    ("content", "word"),
    [
        ("1\nx\n", "'x'"),
        ("1\n2.5\n", "2.5"),
        ("1 2 3\n", "one whole number"),
        ("nan\n", "nan"),
        ("+-1\n", "one whole"),
        ("9" * 400, "999"),
        ("1\n" * 1_000_002, "at most"),
    ],
)
def test_text_that_is_no_labels(tmp_path, content, word):
    (tmp_path / "a.txt").write_text(content)
    with pytest.raises(FileFormatError, match=word):
        read_label_text(tmp_path / "a.txt")


def test_other_content_is_refused(tmp_path):
    (tmp_path / "r.mat").write_bytes(b"MATLAB 5.0 MAT-file" + bytes(200))
    with pytest.raises(FileFormatError):
        read_label_files(tmp_path / "r.mat", CLIPS)
    savemat(tmp_path / "s.mat", {"error": [1.0]})
    with pytest.raises(FileFormatError, match="ClusterIdx"):
        read_label_files(tmp_path / "s.mat", CLIPS)
    with pytest.raises(InputFileError, match="none of the clips"):
        read_label_files(tmp_path, CLIPS)
    with pytest.raises(FileFormatError, match="ClusterIdx"):
        read_label_files(tmp_path / "labels.xls", CLIPS)
    (tmp_path / f"{NAMES[0]}.txt").write_text("1\n2\n")
    with pytest.raises(FileFormatError, match="60 labels"):
        read_label_files(tmp_path, CLIPS)


def test_command(tmp_path, data, capsys):
    folder = tmp_path / "labels"
    folder.mkdir()
    for name in NAMES:
        (folder / f"{name}.txt").write_text("\n".join(map(str, truth()[name])))
    out = tmp_path / "out"
    assert (
        mseg.cli.main(
            ["example-submission", str(data), "--from", str(folder), "-o", str(out), "--method", "m"]
        )
        == 0
    )
    assert validate_submission(out, CLIPS).ok
    assert score_submission(out, CLIPS).error == 0
    assert mseg.cli.main(["example-submission", str(data), "--from", str(folder), "-o", str(out)]) == 2
    assert mseg.cli.main(["example-submission", "--from", str(folder), "-o", str(tmp_path / "o")]) == 2
    assert "the folder of clips" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["--from", "labels", "--seeds", "3"],
            "--seeds: expected 1 with label files, which are of one run, found 3",
        ),
        (["--zero", "first"], "--zero: expected none without label files, found first; give --from FILES"),
    ],
)
def test_options_that_would_do_nothing_are_refused(words, message, tmp_path, data, capsys):
    assert mseg.cli.main(["example-submission", str(data), "-o", str(tmp_path / "out"), *words]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_pipes_hidden_files_and_broken_links_among_label_files(tmp_path):
    for name, label in truth().items():
        np.savetxt(tmp_path / f"{name}.txt", label, fmt="%d")
    (tmp_path / f"._{NAMES[0]}.txt").write_bytes(b"\0")
    same(read_label_files(tmp_path, CLIPS))
    (tmp_path / f"{NAMES[0]}.txt").unlink()
    os.mkfifo(tmp_path / f"{NAMES[0]}.txt")
    assert list(read_label_files(tmp_path, CLIPS)) == NAMES[1:]
    (tmp_path / f"{NAMES[0]}.csv").symlink_to("nowhere")
    with pytest.raises(InputFileError, match="a link that leads nowhere"):
        read_label_files(tmp_path, CLIPS)
