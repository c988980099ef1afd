"""Folders of frames: every way in which they can be wrong."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
import pytest
from PIL import Image

from kt3dmoseg.cli import main
from kt3dmoseg.errors import FileFormatError, InputFileError
from kt3dmoseg.io import images
from kt3dmoseg.io.images import (
    decode,
    decode_indices,
    encode_indices,
    frame_number,
    frame_paths,
    read_frame,
    write_png,
)


def _frames(folder, names, picture=None):
    folder.mkdir(exist_ok=True)
    for name in names:
        cv2.imwrite(str(folder / name), np.zeros((4, 6), np.uint8) if picture is None else picture)
    return folder


def test_what_is_shorter_is_averaged_whatever_the_other_side_is():
    picture = np.zeros((200, 600), np.uint8)
    picture[:, 1::3] = 255
    for height in (100, 200, 400):
        assert (images.resized(picture, (200, height)) == 85).all()


def test_frames_come_in_the_order_of_their_numbers(tmp_path):
    folder = _frames(tmp_path, ["img9.png", "img10.png", "img8.png"])
    (folder / "notes.txt").write_text("not a frame")
    assert [p.name for p in frame_paths(folder)] == ["img8.png", "img9.png", "img10.png"]


@pytest.mark.data
def test_real_frames(data_root):
    paths = frame_paths(data_root / "kt3dmoseg/frames/Seq028_clip03")
    assert [frame_number(p) for p in paths] == list(range(1, 11))
    assert read_frame(paths[0]).shape == (375, 1242)


def test_a_folder_of_clips_names_one(tmp_path):
    (tmp_path / "day").mkdir()
    _frames(tmp_path / "day" / "clip", ["1.png", "2.png"])
    with pytest.raises(InputFileError, match=r"give \S+/day/clip, or \S+/day for a clip of each"):
        frame_paths(tmp_path / "day")


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ([], "at least two numbered frames.*found no pictures"),
        (["000001.png"], "found only 000001.png"),
        (
            ["1.png", "2.png", "4.png"],
            "frame 3: expected frames numbered 1 to 4 without a gap",
        ),
        (["1.png", "01.png", "2.png"], "frame 1: expected one file, found 01.png and 1.png"),
        (["1.png", "last.png"], "ends in the frame's number"),
    ],
)
def test_bad_folders(names, words, tmp_path):
    with pytest.raises((FileFormatError, InputFileError), match=words) as caught:
        frame_paths(_frames(tmp_path / "clip", names))
    assert str(tmp_path / "clip") in str(caught.value)


@pytest.mark.parametrize("names", [["000001.png"], ["1.png", "2.png", "4.png"]])
def test_info_of_a_bad_folder_is_one_line(names, tmp_path, capsys):
    folder = _frames(tmp_path / "clip", names)
    assert main(["info", str(folder)]) == 2
    output = capsys.readouterr()
    assert output.err.count("\n") == 1
    assert output.out == ""
    _frames(tmp_path / "good", ["1.png", "2.png"])  # one of several has the reason in its row
    assert main(["info", str(tmp_path)]) == 0
    assert str(folder) in capsys.readouterr().out


def test_a_missing_folder(tmp_path):
    with pytest.raises(InputFileError, match="No such file"):
        frame_paths(tmp_path / "none")


def test_gray_is_read_as_it_is(tmp_path):
    picture = np.arange(24, dtype=np.uint8).reshape(4, 6)
    write_png(tmp_path / "1.png", picture)
    np.testing.assert_array_equal(read_frame(tmp_path / "1.png"), picture)


def test_gray_stored_as_colour_is_gray(tmp_path):
    picture = np.arange(24, dtype=np.uint8).reshape(4, 6)
    write_png(tmp_path / "1.png", np.dstack([picture] * 3))
    np.testing.assert_array_equal(read_frame(tmp_path / "1.png"), picture)


def test_colour_is_refused_and_its_luma_given_when_asked_for(tmp_path):
    picture = np.zeros((4, 6, 3), dtype=np.uint8)
    picture[..., 0] = 100  # red
    write_png(tmp_path / "1.png", picture)
    with pytest.raises(FileFormatError, match=r"1\.png: expected a gray picture, found colour;.*luma"):
        read_frame(tmp_path / "1.png")
    assert read_frame(tmp_path / "1.png", "luma")[0, 0] == round(0.299 * 100)


def test_16_bits_are_refused(tmp_path):
    cv2.imwrite(str(tmp_path / "1.png"), np.zeros((4, 6), np.uint16))
    with pytest.raises(FileFormatError, match="8-bit picture, found 16 bits per channel; convert"):
        read_frame(tmp_path / "1.png")


def test_a_corrupt_picture_is_one_line_and_opencv_stays_silent(tmp_path, capfd):
    write_png(tmp_path / "1.png", np.random.default_rng(0).integers(0, 255, (40, 60), dtype=np.uint8))
    content = (tmp_path / "1.png").read_bytes()
    flipped = bytearray(content)
    flipped[200] ^= 16
    for broken, words in (
        (content[:100], "an intact picture, found Truncated File Read; the file is damaged; fetch it again"),
        (content[:-5], "an intact picture"),
        # Such a chunk made OpenCV take 3 GB and a minute.
        (content[:33] + b"\x19\xa3\x49\x44" + content[37:], "Truncated"),
        (bytes(flipped), "an intact picture, found .*(checksum|CRC)"),
        (b"\x89PNG\r\n\x1a\nnothing", "expected a picture, found a file that starts with b'.x89PNG"),
        (b"", "expected a picture, found an empty file"),
        (b"text", "expected a picture, found a file that starts with b'text'"),
    ):
        (tmp_path / "1.png").write_bytes(broken)
        with pytest.raises(FileFormatError, match=words):
            read_frame(tmp_path / "1.png")
    assert capfd.readouterr() == ("", "")


def _png(width=6, height=4, bits=8, colour=0, interlace=0, pixels=bytes(28)):
    header = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, interlace)
    return _joined([(b"IHDR", header), (b"IDAT", zlib.compress(pixels)), (b"IEND", b"")])


def _joined(chunks):
    packed = (struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d)) for k, d in chunks)
    return b"\x89PNG\r\n\x1a\n" + b"".join(packed)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"pixels": bytes(27)}, "truncated"),
        ({"pixels": bytes(7) + b"\5" + bytes(20)}, "unrecognized data"),
        ({"bits": 3}, "expected a picture"),
        ({"height": 0}, "expected a picture"),
        ({"interlace": 1}, "truncated"),
    ],
)
def test_a_png_that_contradicts_itself(fields, words, tmp_path, capfd):
    (tmp_path / "1.png").write_bytes(_png(**fields))
    with pytest.raises(FileFormatError, match=words):
        read_frame(tmp_path / "1.png")
    assert capfd.readouterr() == ("", "")


def _jpeg(**settings):
    picture = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 255, (40, 60), dtype=np.uint8), (0, 0), 1)
    flags = [value for name, number in settings.items() for value in (getattr(cv2, name), number)]
    return bytes(cv2.imencode(".jpg", picture, flags)[1])


_JPEGS = ({}, {"IMWRITE_JPEG_PROGRESSIVE": 1}, {"IMWRITE_JPEG_RST_INTERVAL": 2})


@pytest.mark.parametrize("settings", _JPEGS)
def test_a_jpeg_is_refused_wherever_it_is_cut_short(settings, tmp_path, capfd):
    content = _jpeg(**settings)
    for size in [*range(3, len(content), 41), len(content) - 1]:
        # A download into a file of the final size leaves zeros.
        for tail in (b"", bytes(len(content) - size)):
            (tmp_path / "1.jpg").write_bytes(content[:size] + tail)
            with pytest.raises(FileFormatError, match=r"1\.jpg: expected a complete JPEG, .*fetch it again"):
                read_frame(tmp_path / "1.jpg")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("settings", _JPEGS)
def test_a_complete_jpeg_is_read_with_what_cameras_add_to_it(settings, tmp_path):
    content, preview = _jpeg(**settings), _jpeg()
    pixels = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    metadata = b"Exif\0\0" + preview
    segment = b"\xff\xff\xe1" + struct.pack(">H", 2 + len(metadata)) + metadata  # with a fill byte
    (tmp_path / "1.jpg").write_bytes(content[:2] + segment + content[2:] + b"\xff\xd8 a film" + bytes(9))
    np.testing.assert_array_equal(read_frame(tmp_path / "1.jpg"), pixels)
    (tmp_path / "1.jpg").write_bytes(content[:2] + segment + content[2:-2])
    with pytest.raises(FileFormatError, match="expected a complete JPEG"):
        read_frame(tmp_path / "1.jpg")


@pytest.mark.parametrize("suffix", [".bmp", ".pgm", ".tif", ".webp"])
def test_pictures_without_checksums_are_refused_when_cut_short(suffix, tmp_path, capfd):
    picture = np.random.default_rng(0).integers(0, 255, (40, 60), dtype=np.uint8)
    content, path = bytes(cv2.imencode(suffix, picture)[1]), tmp_path / f"1{suffix}"
    for size in [*range(1, len(content), len(content) // 20), len(content) - 5]:
        path.write_bytes(content[:size])
        with pytest.raises(
            FileFormatError, match=r"expected (a picture, found a file that starts with .*|an intact picture)"
        ):
            read_frame(path)
    assert capfd.readouterr() == ("", "")


def test_a_huge_jpeg_is_not_decoded(tmp_path):
    cv2.imwrite(str(tmp_path / "1.jpg"), np.zeros((16, 16), np.uint8))
    content = (tmp_path / "1.jpg").read_bytes()
    at = content.index(b"\xff\xc0") + 5
    (tmp_path / "1.jpg").write_bytes(content[:at] + b"\x3b\x67\x67\x6f" + content[at + 4 :])
    with pytest.raises(FileFormatError, match="at most 67108864 pixels, found 402666153 pixels"):
        read_frame(tmp_path / "1.jpg")


def test_an_interlaced_png_is_read(tmp_path):
    # Rows of the passes of Adam7, each with its filter byte: 2 + 2 + 0 + 2 + 4 + 2 * 4 + 2 * 7.
    (tmp_path / "1.png").write_bytes(_png(interlace=1, pixels=bytes(32)))
    assert read_frame(tmp_path / "1.png").shape == (4, 6)


@pytest.mark.parametrize(
    ("size", "words"),
    [
        ((30_000, 30_000), "at most 67108864 pixels, found 900000000 pixels"),
        ((9_000, 9_000), "at most 67108864 pixels, found 9000x9000"),
        ((4_000, 500), "an intact picture, found image file is truncated"),
        ((0xFFFFFFFF, 0xFFFFFFFF), "at most 67108864 pixels"),
    ],
)
def test_a_picture_too_large_for_its_bytes_is_not_decoded(size, words, tmp_path):
    write_png(tmp_path / "1.png", np.zeros((4, 6), np.uint8))
    content = bytearray((tmp_path / "1.png").read_bytes())
    content[16:24] = struct.pack(">II", *size)
    content[29:33] = struct.pack(">I", zlib.crc32(bytes(content[12:29])))
    (tmp_path / "1.png").write_bytes(content)
    with pytest.raises(FileFormatError, match=words):
        read_frame(tmp_path / "1.png")


def test_a_large_even_picture_is_read(tmp_path):
    write_png(tmp_path / "1.png", np.zeros((3000, 4000), np.uint8))
    assert read_frame(tmp_path / "1.png").shape == (3000, 4000)


def _palette_png(indices, bits, palette):
    """Encode (H, W) indices by hand: OpenCV cannot."""
    height, width = indices.shape
    per_byte = 8 // bits
    padded = np.pad(indices, ((0, 0), (0, -width % per_byte)))
    shifts = np.arange(per_byte)[::-1] * bits
    rows = (padded.reshape(height, -1, per_byte) << shifts).sum(axis=2).astype(np.uint8)
    data = zlib.compress(np.pad(rows, ((0, 0), (1, 0))).tobytes())
    parts = [(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, 3, 0, 0, 0)), (b"PLTE", palette)]
    chunks = [*parts, (b"tRNS", b"\0"), (b"IDAT", data), (b"IEND", b"")]
    return _joined(chunks)


def test_indices_of_gray_pngs_of_few_bits_come_back(rng):
    for bits in (1, 2, 4):
        indices = rng.integers(0, 1 << bits, (4, 8))
        shifts = np.arange(8 // bits)[::-1] * bits
        rows = (indices.reshape(4, -1, 8 // bits) << shifts).sum(axis=2).astype(np.uint8)
        content = _png(8, 4, bits, 0, 0, np.pad(rows, ((0, 0), (1, 0))).tobytes())
        read, depth = decode_indices(content, "mask.png")
        np.testing.assert_array_equal(read, indices)
        assert depth == bits


def test_encoded_indices_are_an_8_bit_palette_png(rng):
    indices, palette = rng.integers(0, 9, (5, 7), np.uint8), rng.integers(0, 256, (256, 3), np.uint8)
    content = encode_indices(indices, palette)
    read, depth = decode_indices(content, "mask.png")
    np.testing.assert_array_equal(read, indices)
    assert depth == 8
    np.testing.assert_array_equal(decode(content, "mask.png"), palette[indices])


@pytest.mark.parametrize("mode", ["1", "L", "LA", "P", "RGB", "RGBA", "CMYK"])
def test_every_kind_of_8_bit_gray_is_read(mode, tmp_path):
    image = Image.fromarray(np.arange(0, 240, 10, dtype=np.uint8).reshape(4, 6)).convert(mode)
    path = tmp_path / ("1.jpg" if mode == "CMYK" else "1.png")
    image.save(path, quality=100)
    np.testing.assert_allclose(read_frame(path), np.asarray(image.convert("RGB"))[..., 0], atol=2)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".ppm", ".pgm"])
def test_16_bits_keep_their_depth(suffix, rng):
    stored = rng.integers(0, 1 << 16, (4, 6) if suffix == ".pgm" else (4, 6, 3)).astype(np.uint16)
    read = decode(bytes(cv2.imencode(suffix, stored)[1]), "a")
    np.testing.assert_array_equal(read, stored if suffix == ".pgm" else stored[..., ::-1])
    assert read.dtype == np.uint16


@pytest.mark.parametrize("bits", [1, 2, 4, 8])
def test_indices_come_back_whatever_the_palette(bits, rng):
    indices = rng.integers(0, 1 << bits, (5, 7))
    palette = bytes(3 << bits)  # all black: colours show nothing
    read, depth = decode_indices(_palette_png(indices, bits, palette), "mask.png")
    np.testing.assert_array_equal(read, indices)
    assert depth == bits


def test_numbers_of_16_bits_and_colours(tmp_path):
    stored = np.array([[0, 1005, 10000]], dtype=np.uint16)
    content = bytes(cv2.imencode(".png", stored)[1])
    np.testing.assert_array_equal(decode_indices(content, "mask.png")[0], stored)
    coloured = bytes(cv2.imencode(".png", np.zeros((2, 2, 3), np.uint8))[1])
    with pytest.raises(FileFormatError, match="one channel of numbers, found 3 channels"):
        decode_indices(coloured, "mask.png")
