"""Output goes to regular files only: pipes, devices, sockets and folders of that name stay as they are."""

from __future__ import annotations

import os
import socket
import stat

import pytest

from kt3dmoseg.errors import InputFileError
from kt3dmoseg.files import atomic_path, write_bytes, write_text


def refuses(path, found):
    for write in (lambda: write_bytes(path, b"x"), lambda: write_text(path, "x")):
        with pytest.raises(InputFileError, match=rf"cannot write: expected a regular file .*found {found}"):
            write()
    with pytest.raises(InputFileError, match=found), atomic_path(path):
        pytest.fail("the block ran")


def test_a_fifo_and_a_link_to_one_stay(tmp_path):
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "link").symlink_to("fifo")
    for name in ("fifo", "link"):
        refuses(tmp_path / name, "a FIFO")
    assert stat.S_ISFIFO((tmp_path / "fifo").stat().st_mode)
    assert (tmp_path / "link").is_symlink()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fifo", "link"]


def test_devices_are_refused_also_by_names_that_lead_to_a_file(tmp_path):
    refuses("/dev/null", "a device")
    with open(tmp_path / "redirected", "w") as stream:
        refuses(f"/dev/fd/{stream.fileno()}", "a device")
    assert os.path.lexists("/dev/null")


def test_a_folder_and_a_socket_are_refused(tmp_path, monkeypatch):
    (tmp_path / "folder").mkdir()
    refuses(tmp_path / "folder", "a folder")
    monkeypatch.chdir(tmp_path)  # the names of sockets are short
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind("socket")
        refuses("socket", "a socket")


def test_a_new_name_a_file_and_a_link_to_nothing_are_written(tmp_path):
    (tmp_path / "old").write_text("before")
    (tmp_path / "dangling").symlink_to("nowhere")
    for name in ("old", "new", "dangling"):
        write_text(tmp_path / name, "after")
        assert (tmp_path / name).read_text() == "after"
