from __future__ import annotations

import pickle
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from kt3dmoseg import errors
from kt3dmoseg.files import atomic_path, hold_folder, read_bytes, sha256_arrays, sha256_file, write_text
from kt3dmoseg.registry import Registry


def test_a_failed_write_leaves_the_former_content_and_no_other_file(tmp_path):
    target = tmp_path / "deep" / "a.txt"
    write_text(target, "old")
    with pytest.raises(RuntimeError), atomic_path(target) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert target.read_text() == "old"
    assert [entry.name for entry in target.parent.iterdir()] == ["a.txt"]


def test_kill_9_in_the_middle_leaves_the_former_content(tmp_path):
    target = tmp_path / "a.txt"
    write_text(target, "old")
    program = (
        "import os, signal\nfrom kt3dmoseg.files import atomic_path\n"
        f"with atomic_path({str(target)!r}) as t:\n"
        "    t.write_text('half'); os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    killed = subprocess.run([sys.executable, "-c", program], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert target.read_text() == "old"


def test_an_unwritable_folder_is_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(errors.InputFileError, match="cannot write") as caught:
        write_text(tmp_path / "file" / "below", "x")
    assert "\n" not in str(caught.value)


def test_written_files_have_ordinary_permissions(tmp_path):
    write_text(tmp_path / "a", "x")
    (tmp_path / "b").write_text("x")
    assert (tmp_path / "a").stat().st_mode == (tmp_path / "b").stat().st_mode


def test_a_folder_is_held_alone_and_released_by_the_dead(tmp_path):
    target = tmp_path / "new" / "folder"
    program = (
        "import os, signal\nfrom kt3dmoseg.files import hold_folder\n"
        f"with hold_folder({str(target)!r}):\n"
        "    print('held', flush=True); input(); os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    other = subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert other.stdout.readline() == "held\n"
    events = []

    def busy():
        events.append("busy")
        if len(events) > 1:
            other.communicate("\n")
        else:
            raise errors.InputFileError("somebody is at work")

    with pytest.raises(errors.InputFileError, match="somebody"), hold_folder(target, busy=busy):
        events.append("in")
    with hold_folder(target, busy=busy):
        events.append("in")
    assert events == ["busy", "busy", "in"]


def test_a_folder_is_held_against_other_threads(tmp_path):
    at_work = []

    def work(number):
        with hold_folder(tmp_path):
            at_work.append(number)
            time.sleep(0.01)
            assert at_work[-1] == number

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(work, range(8)))
    assert sorted(at_work) == list(range(8))
    (tmp_path / "file").write_text("")
    with pytest.raises(errors.InputFileError, match="file: cannot write"), hold_folder(tmp_path / "file"):
        pass


def test_bounded_reads(tmp_path):
    (tmp_path / "a").write_bytes(b"12345")
    assert read_bytes(tmp_path / "a", 5) == b"12345"
    with pytest.raises(errors.InputFileError, match="at most 4 bytes"):
        read_bytes(tmp_path / "a", 4)
    with pytest.raises(errors.InputFileError, match="No such file"):
        read_bytes(tmp_path / "b", 4)
    with pytest.raises(errors.InputFileError, match="No such file"):
        sha256_file(tmp_path / "b")


def test_array_hash_sees_dtype_shape_and_values_but_not_byte_order():
    a = np.arange(4.0)
    assert sha256_arrays(a) == sha256_arrays(a.astype(">f8"))
    others = [a.astype(np.float32), a.reshape(2, 2), a + 1]
    assert len({sha256_arrays(a), *map(sha256_arrays, others)}) == 4


@pytest.mark.parametrize(
    "kind", [c for c in vars(errors).values() if isinstance(c, type) and issubclass(c, errors.KT3DMoSegError)]
)
def test_every_error_is_one_line_and_crosses_processes(kind):
    error = kind("a.mat", expected="20\nframes", found="19", fix="rebuild it")
    assert str(error) == "a.mat: expected 20 frames, found 19; rebuild it"
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is kind
    assert str(copy) == str(error)


def test_a_built_in_name_imports_no_package(monkeypatch):
    monkeypatch.setattr("importlib.metadata.entry_points", lambda **_: 1 / 0)
    registry = Registry("codec", {"json": "json:dumps"}, group="none.such")
    assert registry.load("json")([1]) == "[1]"
    with pytest.raises(ZeroDivisionError):
        registry.load("other")


def test_registry_lists_without_importing_and_names_the_nearest():
    registry = Registry("codec", {"json": "json:dumps", "broken": "no.such.module:x"}, group="none.such")
    assert registry.names() == ["json", "broken"]
    assert registry.load("json")([1]) == "[1]"
    with pytest.raises(errors.UnknownNameError, match=r"unknown codec 'jsno'; did you mean 'json'\?"):
        registry.load("jsno")
    with pytest.raises(errors.UnknownNameError, match="known: json, broken"):
        registry.load("zzz")


def test_what_was_found_is_cut_when_it_is_endless():
    error = errors.FileFormatError("a.mat", expected="numbers", found="x" * 100_000, fix="do this")
    assert len(str(error)) < 1100
    assert str(error).endswith("x ...; do this")
