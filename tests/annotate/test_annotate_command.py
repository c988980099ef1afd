"""What `kt3dmoseg label` refuses, before it prints anything."""

from __future__ import annotations

import socket

import cv2
import numpy as np
import pytest

from kt3dmoseg.cli import main


@pytest.fixture
def frames(tmp_path):
    (tmp_path / "clip").mkdir()
    for k in (1, 2):
        cv2.imwrite(str(tmp_path / f"clip/{k:06d}.png"), np.zeros((48, 64), np.uint8))
    return tmp_path / "clip"


def refused(arguments, capsys):
    assert main(["label", *map(str, arguments), "--no-browser"]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    return printed.err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--port", "99999999"], "--port: expected 0 to 65535, found 99999999"),
        (["--frames", "nowhere"], "--frames nowhere: found no such file or folder"),
        (["--frames", "nowhere", "--port", "99999999"], "--frames nowhere"),
        (["--tracks", "nowhere"], "--tracks nowhere"),
        (["--compare", "nowhere"], "--compare nowhere"),
        (["--masks", "nowhere"], "--masks nowhere"),
        (["--kitti", "nowhere"], "--kitti nowhere"),
        (["--flow", "dsi"], "unknown flow 'dsi'"),
    ],
)
def test_a_wrong_argument_is_all_that_is_reported(arguments, words, frames, capsys):
    assert words in refused([frames, *arguments], capsys)


def test_a_port_in_use_is_reported_before_the_clips(frames, capsys):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        assert f"127.0.0.1:{port}: cannot listen" in refused([frames, "--port", port], capsys)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("000002.png", b"text", "000002.png: expected a picture"),
        ("000002.png", (30, 64), "000002.png: expected 64x48 px"),
        ("clip.h5", b"text", "clip.h5: expected a clip"),
        ("clip.json", b"{", "clip.json: "),
    ],
)
def test_a_bad_file_of_the_only_clip_is_reported_before_the_page(
    name, content, words, frames, tmp_path, capsys
):
    path = (frames if name.endswith("png") else tmp_path) / name
    if isinstance(content, tuple):
        cv2.imwrite(str(path), np.zeros(content, np.uint8))
    else:
        path.write_bytes(content)
    tracks = ["--tracks", tmp_path / "clip.h5"] if name == "clip.h5" else []
    assert words in refused([frames, "--annotations", tmp_path, *tracks], capsys)
