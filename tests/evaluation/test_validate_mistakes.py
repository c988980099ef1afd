"""Every classic mistake is recognised, named, and answered with advice of its own."""

import io
import json
import os
import shutil
import stat
import struct
import zipfile

import h5py
import numpy as np
import pytest
from evaluation_helpers import CLIPS, META, codes, perfect, truth, zip_folder

import mseg.cli
from kt3dmoseg.types import Clip, Trajectories
from mseg.evaluation import SubmissionMeta, validate_submission, write_meta, write_submission

ONE = "example_two"
CLIP = CLIPS[ONE]
IDS = CLIP.dense.track_id[CLIP.evaluated]
LABEL = CLIP.labels.label


@pytest.fixture
def folder(tmp_path):
    return perfect(tmp_path / "submission")


def rewrite(folder, track, label, header="track,label"):
    rows = "\n".join(f"{t},{v}" for t, v in zip(track, label, strict=True))
    (folder / f"{ONE}.csv").write_text(f"{header}\n{rows}\n")


def text(folder, content):
    (folder / f"{ONE}.csv").write_text(content)


def npz(folder, **arrays):
    (folder / f"{ONE}.csv").unlink()
    np.savez(folder / f"{ONE}.npz", **arrays)


def floats(folder):
    rewrite(folder, IDS, LABEL.astype(float))


def with_label(value):
    return lambda f: rewrite(f, IDS, [value, *LABEL[1:].tolist()])


def wrong_case(folder):
    (folder / f"{ONE}.csv").rename(folder / "Example_Two.csv")


def other_name(name):
    return lambda f: (f / f"{ONE}.csv").rename(f / name)


def all_trajectories(folder):
    rewrite(folder, CLIP.dense.track_id, np.resize(LABEL, len(CLIP.dense)))


def transposed(folder):
    text(folder, "track," + ",".join(map(str, IDS)) + "\nlabel," + ",".join(map(str, LABEL)) + "\n")


def duplicate_rows(folder):
    rewrite(folder, [IDS[0], *IDS], [LABEL[0], *LABEL])


def extra_clip(folder):
    shutil.copy(folder / f"{ONE}.csv", folder / "example_four.csv")


def symlink(folder):
    (folder / f"{ONE}.csv").unlink()
    (folder / f"{ONE}.csv").symlink_to("/etc/passwd")


def object_array(folder):
    npz(folder, track=IDS, label=np.array([None, *LABEL[1:]], dtype=object))


def mixed_seeds(folder):
    (folder / "seed-1").mkdir()
    shutil.copy(folder / f"{ONE}.csv", folder / "seed-1" / f"{ONE}.csv")


def linked_h5(folder):
    (folder / f"{ONE}.csv").unlink()
    with h5py.File(folder / f"{ONE}.h5", "w") as file:
        file["track"] = IDS
        file["label"] = h5py.ExternalLink("/etc/passwd", "label")


def two_formats(folder):
    np.savez(folder / f"{ONE}.npz", track=IDS, label=LABEL)


def pipe(folder):
    os.mkfifo(folder / "pipe.csv")


def large_file(folder):
    with (folder / "large.csv").open("wb") as stream:
        stream.truncate(40 << 20)


def damaged_npz(folder):
    two_formats(folder)
    (folder / f"{ONE}.csv").unlink()
    path = folder / f"{ONE}.npz"
    path.write_bytes(path.read_bytes()[:-30])


def failed_twice(folder):
    (folder / f"{ONE}.failed").write_text("")


def meta(**changes):
    return lambda f: write_meta(f, SubmissionMeta(**{**vars(META), **changes}))


def meta_text(content):
    return lambda f: (f / "meta.toml").write_text(content)


GOOD = 'format_version = 1\nmethod = "x"\nauthors = ["a"]\nn_motions_given = true\ndataset_version = "1"\n'

MISTAKES = [
    ("all-trajectories", all_trajectories, "60 labels: those are all trajectories"),
    ("zero-based", lambda f: rewrite(f, IDS, LABEL - 1), "add 1 to every label"),
    ("zero-label", lambda f: rewrite(f, IDS, np.where(LABEL == 1, 0, 7)), "outliers = true"),
    ("transposed", transposed, "transpose the table"),
    ("float", floats, "2 and not 2.0"),
    ("nan", with_label("nan"), "give every trajectory a label"),
    ("infinite", with_label("inf"), "whole numbers"),
    ("negative", with_label(-1), "motions are 1, 2"),
    ("not-a-number", with_label("car"), "not its name"),
    ("one-label", lambda f: rewrite(f, IDS, np.ones_like(LABEL)), "baseline = true"),
    ("missing-clip", lambda f: (f / f"{ONE}.csv").unlink(), f"{ONE}.failed"),
    ("extra-clip", extra_clip, "did you mean"),
    ("wrong-case", wrong_case, f"rename the file to {ONE}"),
    ("duplicate-rows", duplicate_rows, "one row per trajectory"),
    ("duplicate-clip", two_formats, "keep one of them"),
    ("symlink", symlink, "put the file itself there"),
    ("object-array", object_array, "never opened"),
    ("not-a-dataset", linked_h5, "a link or group"),
    ("transposed", lambda f: npz(f, track=IDS[:, None], label=LABEL[:, None]), "flatten"),
    ("missing-array", lambda f: npz(f, labels=LABEL), "np.savez(file, track=ids, label=labels)"),
    ("float", lambda f: npz(f, track=IDS, label=LABEL / 1.0), "write integers"),
    ("ragged", lambda f: npz(f, track=IDS, label=LABEL[1:]), "as many labels"),
    ("not-a-number", lambda f: npz(f, track=IDS, label=LABEL.astype(str)), "write integers"),
    ("unreadable", damaged_npz, "np.savez(file, track=ids, label=labels)"),
    ("swapped-columns", lambda f: rewrite(f, LABEL, IDS), "track first, then label"),
    ("special-file", pipe, "remove it"),
    ("too-large", large_file, "one label per evaluated trajectory"),
    ("duplicate-clip", failed_twice, "keep one of them"),
    ("meta-field", meta_text(GOOD.replace('["a"]', "[]")), "docs/submit.md"),
    ("meta-field", meta_text(GOOD.replace('dataset_version = "1"', "")), "docs/submit.md"),
    (
        "no-header",
        lambda f: text(f, "".join(f"{t},{v}\n" for t, v in zip(IDS, LABEL, strict=False))),
        "first line",
    ),
    ("label-only", lambda f: text(f, "\n".join(map(str, LABEL))), "mseg example-submission"),
    ("separator", lambda f: text(f, "track;label\n1;2\n"), "commas"),
    ("header", lambda f: text(f, "id,motion\n1,2\n"), "track,label"),
    ("header", lambda f: text(f, "track,label,conf\n1,2,0.5\n"), "remove the other columns"),
    ("header", lambda f: text(f, "conf,label,track\n0.5,2,1\n0.5,2,2\n"), "remove the other columns"),
    ("ragged", lambda f: text(f, "track,label\n1,2,3\n"), "line 2"),
    ("empty-file", lambda f: text(f, ""), "first line"),
    ("empty-file", lambda f: npz(f, track=IDS[:0], label=LABEL[:0]), "one label per trajectory"),
    ("encoding", lambda f: (f / f"{ONE}.csv").write_bytes(b"\xff\xfe\x00"), "UTF-8"),
    ("one-based-ids", lambda f: rewrite(f, IDS + 1, LABEL), "subtract 1"),
    ("row-numbers", lambda f: rewrite(f, range(len(IDS)), LABEL), "clip.dense.track_id[clip.evaluated]"),
    ("other-trajectories", lambda f: rewrite(f, IDS + 1000, LABEL), "another version of the data"),
    ("trajectories", lambda f: rewrite(f, IDS[2:], LABEL[2:]), "2 missing"),
    ("trajectories", lambda f: rewrite(f, IDS[:10], LABEL[:10]), "30 missing"),
    ("trajectories", lambda f: rewrite(f, IDS[:1], LABEL[:1]), "39 missing"),
    ("too-many-groups", lambda f: rewrite(f, IDS, IDS + 1), "swapped"),
    ("mixed-seeds", mixed_seeds, "seed folder"),
    (
        "unknown-folder",
        lambda f: (f / "labels").mkdir() or shutil.copy(f / f"{ONE}.csv", f / "labels"),
        "seed-<number>",
    ),
    (
        "unknown-file",
        lambda f: [(f / f"{n}.png").write_bytes(b"x") for n in range(3)],
        "found .png, 3 files; remove it",
    ),
    ("unknown-file", lambda f: (f / "result.mat").write_bytes(b"x"), "mseg example-submission"),
    ("extra-clip", other_name(f"{ONE}_Tracks.csv"), f"did you mean {ONE}?"),
    ("no-meta", lambda f: (f / "meta.toml").unlink(), "docs/submit.md"),
    ("no-meta", lambda f: (f / "meta.toml").rename(f / "META.TOML"), "lower case"),
    ("meta-syntax", meta_text("method = \n"), "TOML"),
    ("meta-field", meta_text(GOOD + 'autors = ["a"]\n'), "did you mean 'authors'?"),
    ("meta-field", meta_text(GOOD.replace("= 1", "= 2")), "format_version = 1"),
    ("meta-field", meta_text(GOOD + "seconds = nan\n"), "seconds >= 0"),
    ("meta-field", meta_text(GOOD.replace("n_motions_given = true\n", "")), "if the method was given"),
    ("meta-field", meta(benchmark="Hopkins-155"), "did you mean 'hopkins155'?"),
    ("dataset-version", meta(fingerprints={ONE: "0" * 16}), "another version of the data"),
]


@pytest.mark.parametrize(
    ("code", "spoil", "advice"), MISTAKES, ids=[f"{i}-{m[0]}" for i, m in enumerate(MISTAKES)]
)
def test_mistake(folder, code, spoil, advice):
    spoil(folder)
    checked = validate_submission(folder, CLIPS)
    assert not checked.ok
    found = [p for p in checked.problems if p.code == code]
    assert found, str(checked)
    assert advice in str(found[0])
    assert found[0].found
    assert found[0].expected


def test_several_problems_are_listed_at_once_and_numbered(folder):
    floats(folder)
    (folder / "example_three.csv").unlink()
    extra_clip(folder)
    (folder / "notes.xlsx").write_bytes(b"x")
    checked = validate_submission(folder, CLIPS)
    assert set(codes(checked)) == {"float", "missing-clip", "extra-clip", "unknown-file"}
    lines = str(checked).splitlines()
    assert lines[0] == f"invalid: {len(checked.problems)} problems"
    assert [line.split(".")[0] for line in lines[1:5]] == ["1", "2", "3", "4"]


def test_seed_by_seed(tmp_path):
    folder = perfect(tmp_path / "s", seeds=2)
    (folder / "seed-1" / f"{ONE}.csv").unlink()
    (problem,) = validate_submission(folder, CLIPS).problems
    assert (problem.code, problem.clip, problem.file) == ("missing-clip", ONE, "seed-1")


def test_intended_exceptions_are_accepted(folder):
    rewrite(folder, IDS, np.zeros_like(LABEL))
    assert codes(validate_submission(folder, CLIPS)) == ["zero-label", "one-label"]
    meta(outliers=True, baseline=True)(folder)
    assert validate_submission(folder, CLIPS).ok


def test_dataset_version_is_recognised_by_its_trajectories(folder):
    tracks = CLIP.dense
    moved = Trajectories(tracks.xy + 0.25, tracks.visible, tracks.track_id)
    other = {**CLIPS, ONE: Clip(ONE, moved, CLIP.evaluated, CLIP.labels)}
    (problem,) = validate_submission(folder, other).problems
    assert (problem.code, problem.clip) == ("dataset-version", ONE)


def test_declared_version_that_the_data_are_not(tmp_path):
    """The trajectories of the 2018 release are recognised by their checksums."""
    clip = Clip("Seq005_Clip01", CLIP.dense, CLIP.evaluated, CLIP.labels)
    meta = SubmissionMeta("m", dataset_version="2018")
    folder = write_submission(tmp_path / "s", [clip], {clip.name: LABEL}, meta)
    (problem,) = validate_submission(folder, [clip]).problems
    assert (problem.code, problem.file) == ("dataset-version", "meta.toml")
    other = Clip("Seq005_Clip02", CLIP.dense, CLIP.evaluated, CLIP.labels)  # not listed: is unknown
    assert validate_submission(
        write_submission(tmp_path / "t", [other], {other.name: LABEL}, meta), [other]
    ).ok


def test_unlabelled_clip_is_not_scored_but_no_mistake(folder):
    hidden = {**CLIPS, ONE: CLIP.without_labels()}
    checked = validate_submission(folder, hidden)
    assert checked.ok
    assert [n.code for n in checked.notes] == ["not-scored"]
    assert list(checked.clips) == ["example_three"]


def test_no_data_for_the_benchmark(folder):
    assert "no-data" in codes(validate_submission(folder, CLIPS, benchmark="kt3dmoseg"))


# --- archives ---------------------------------------------------------------------------------


def test_zip_of_the_content(folder, tmp_path):
    assert validate_submission(zip_folder(folder, tmp_path / "s.zip"), CLIPS).ok


def test_zip_of_the_folder_is_noted_and_still_checked(folder, tmp_path):
    floats(folder)
    packed = zip_folder(folder, tmp_path / "s.zip", prefix="submission/")
    checked = validate_submission(packed, CLIPS)
    assert codes(checked) == ["wrapped-folder", "float"]
    assert "cd submission && zip -r ../submission.zip ." in str(checked)


def test_litter_of_operating_systems_is_ignored(folder, tmp_path):
    packed = zip_folder(folder, tmp_path / "s.zip")
    with zipfile.ZipFile(packed, "a") as archive:
        archive.writestr("__MACOSX/._meta.toml", "x")
        archive.writestr(".DS_Store", "x")
        archive.writestr("README.md", "x")
    assert validate_submission(packed, CLIPS).ok


@pytest.mark.parametrize(
    "name", ["../evil.csv", "/abs.csv", "a/../../evil.csv", "C:/evil.csv", "a\\..\\evil.csv"]
)
def test_path_outside_the_archive(folder, tmp_path, name):
    packed = zip_folder(folder, tmp_path / "s.zip")
    with zipfile.ZipFile(packed, "a") as archive:
        archive.writestr(name, "track,label\n")
    before = sorted(tmp_path.rglob("*"))
    assert codes(validate_submission(packed, CLIPS)) == ["unsafe-path"]
    assert sorted(tmp_path.rglob("*")) == before


def test_symbolic_link_in_an_archive(folder, tmp_path):
    packed = zip_folder(folder, tmp_path / "s.zip")
    link = zipfile.ZipInfo("link.csv")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    with zipfile.ZipFile(packed, "a") as archive:
        archive.writestr(link, "/etc/passwd")
    assert codes(validate_submission(packed, CLIPS)) == ["symlink"]


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_same_name_twice(folder, tmp_path):
    packed = zip_folder(folder, tmp_path / "s.zip")
    with zipfile.ZipFile(packed, "a") as archive:
        archive.writestr(f"{ONE}.csv", "track,label\n")
    assert codes(validate_submission(packed, CLIPS)) == ["duplicate-name"]


def test_zip_bomb(folder, tmp_path):
    packed = zip_folder(folder, tmp_path / "s.zip")
    with zipfile.ZipFile(packed, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("bomb.csv", bytes(20 << 20))
    assert packed.stat().st_size < 100_000
    assert codes(validate_submission(packed, CLIPS)) == ["too-large"]


def test_bomb_inside_an_npz(folder):
    (folder / f"{ONE}.csv").unlink()
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": "<i8", "fortran_order": False, "shape": (1 << 50,)}
    )
    with zipfile.ZipFile(folder / f"{ONE}.npz", "w") as archive:
        archive.writestr("track.npy", header.getvalue())
        archive.writestr("label.npy", header.getvalue())
    assert set(codes(validate_submission(folder, CLIPS))) == {"too-large"}


def test_wrong_declared_size(folder, tmp_path):
    packed = zip_folder(folder, tmp_path / "s.zip")
    content = bytearray(packed.read_bytes())
    at = content.rfind(b"PK\x01\x02")
    content[at + 24 : at + 28] = struct.pack("<I", 5)
    packed.write_bytes(content)
    assert "unreadable" in codes(validate_submission(packed, CLIPS))


def test_other_files_are_no_archive(tmp_path):
    other = tmp_path / "s.tar.gz"
    other.write_bytes(b"\x1f\x8b nothing")
    assert "not-a-zip" in codes(validate_submission(other, CLIPS))


# --- the command ------------------------------------------------------------------------------


@pytest.fixture
def data(tmp_path):
    from kt3dmoseg.io import save

    for name, clip in CLIPS.items():
        save(clip, tmp_path / "data" / f"{name}.h5")
    return tmp_path / "data"


def test_command_and_its_exit_codes(folder, data, tmp_path, capsys):
    assert mseg.cli.main(["validate", str(folder), str(data)]) == 0
    assert "valid: 2 clips" in capsys.readouterr().out
    floats(folder)
    assert mseg.cli.main(["validate", str(folder), str(data)]) == 1
    assert "1. [float]" in capsys.readouterr().out
    assert mseg.cli.main(["validate", str(tmp_path / "nothing"), str(data)]) == 2
    assert mseg.cli.main(["validate", str(folder), str(tmp_path / "nothing")]) == 2
    assert mseg.cli.main(["validate"]) == 2


def test_json(folder, data, capsys):
    floats(folder)
    assert mseg.cli.main(["validate", str(folder), str(data), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["valid"] is False
    (problem,) = found["problems"]
    assert (problem["number"], problem["code"], problem["clip"], problem["file"]) == (
        1,
        "float",
        ONE,
        f"{ONE}.csv",
    )
    assert problem["expected"]
    assert problem["found"]
    assert problem["fix"]


def test_extra_clip_of_a_listed_benchmark_is_a_note(tmp_path):
    """Someone submits all 22 clips; here are labels of some of them."""
    renamed = {
        n: Clip(n, CLIP.dense, CLIP.evaluated, CLIP.labels) for n in ("Seq005_Clip01", "Seq005_Clip02")
    }
    folder = write_submission(tmp_path / "s", renamed.values(), dict.fromkeys(renamed, truth()[ONE]), META)
    del renamed["Seq005_Clip02"]
    checked = validate_submission(folder, renamed)
    assert checked.protocol.name == "kt3dmoseg"
    assert checked.ok, str(checked)
    assert [n.clip for n in checked.notes] == ["Seq005_Clip02"]


def test_the_advice_for_a_deep_zip_is_a_command_that_works(folder, tmp_path):
    packed = zip_folder(folder, tmp_path / "s.zip", prefix="a/b/")
    assert "cd a/b && zip -r ../../b.zip ." in str(validate_submission(packed, CLIPS))
