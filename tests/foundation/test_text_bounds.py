"""JSON and TOML of strangers: parsed within bounds of size, depth and length of numbers, or one line."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.files import parse_json, parse_toml

DEEP = "at most 64 levels"


@pytest.mark.parametrize(
    ("parse", "content", "message"),
    [
        (parse_toml, "a" + ".a" * 20_000 + " = 1", DEEP),
        (parse_toml, "a" + " . a" * 20_000 + " = 1", DEEP),
        (parse_toml, '"x"' + '."x"' * 20_000 + " = 1", DEEP),
        (parse_toml, "[a" + ".a" * 20_000 + "]", DEEP),
        (parse_toml, "a = " + "[" * 100_000, DEEP),
        (parse_toml, "a = " + "{b=" * 70 + "1" + "}" * 70, DEEP),
        (parse_toml, "a = '''[[" + "'''\nb = " + "[" * 100, DEEP),
        (parse_toml, "a = " + "1" * 5000, "less than 300 digits"),
        (parse_toml, "a = 0x" + "f" * 5000, "less than 300 digits"),
        (parse_json, '{"b": 1, "a": null, "a": null}', "the key 'a' twice"),
        (parse_toml, b"a = '\xff'", "UTF-8, found byte 0xff at 5"),
        (parse_toml, "a = '\0'", r"invalid character .*\(at line 1"),
        (parse_toml, "#" * ((256 << 10) + 1), "at most 262144 bytes, found 262145"),
        (parse_json, "[" * 100_000, DEEP),
        (parse_json, '{"a":' * 65 + "1" + "}" * 65, DEEP),
        (parse_json, '{"a": ' + "9" * 400 + "}", "a number of 400 digits"),
        (parse_json, '{"a": NaN}', "NaN, which is no number"),
        (parse_json, "[-Infinity]", "-Infinity, which is no number"),
        (parse_json, b'{"a": "\xff"}', "UTF-8"),
        (parse_json, "[1,]", "expected JSON"),
        (parse_json, " " * ((8 << 20) + 1), "at most 8388608 bytes"),
    ],
)
def test_a_text_out_of_bounds_is_refused_in_one_line(parse, content, message):
    with pytest.raises(FileFormatError, match=r"^given: [^\n]*" + message):
        parse(content, "given")


def test_what_is_within_bounds_is_parsed_whatever_its_strings_hold():
    brackets = "[{" * 1000 + ".a" * 1000
    assert parse_json(json.dumps({"a": [brackets, '"' + brackets]}), "x") == {"a": [brackets, '"' + brackets]}
    toml = f"# {brackets}\na = '{brackets}'\nb = \"\\\"{brackets}\"\nc = '''{brackets}'''\nd.e.f = 1.5\n"
    assert parse_toml(toml.encode(), "x") == tomllib.loads(toml)
    assert parse_json("[" * 64 + "]" * 64, "x") is not None
    assert parse_toml(b"\xef\xbb\xbfa = 1", "x") == {"a": 1}


_PIECES = st.sampled_from(
    ['"', "'", '"""', "'''", "\\", "[", "]", "{", "}", ".", "a", "=", ",", "#", "\n", " ", "1", ":", "\0"]
)
_TEXTS = st.lists(st.tuples(_PIECES, st.integers(1, 300)), max_size=12).map(
    lambda parts: "".join(piece * count for piece, count in parts)
)


@pytest.mark.parametrize(("parse", "reference"), [(parse_json, json.loads), (parse_toml, tomllib.loads)])
@given(text=_TEXTS)
def test_any_text_is_parsed_as_the_library_parses_it_or_refused(parse, reference, text):
    try:
        found = parse(text, "x")
    except FileFormatError as error:
        assert "\n" not in str(error)
    else:
        assert found == reference(text)


_BOUNDED = r"""
import resource
resource.setrlimit(resource.RLIMIT_CPU, (20, 20))
from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.files import parse_json, parse_toml
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
starts = ["[", "a=[", "", "", "", "", "a"]
pieces = ["[],", "1,", '"\\', '\"\"\"\\', "a", "a ", ".a"]
for parse, size in ((parse_json, 8 << 20), (parse_toml, 256 << 10)):
    for start, piece in zip(starts, pieces):
        try:
            parse((start + piece * (size // len(piece)))[:size], "x")
        except FileFormatError:
            pass
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


def test_the_largest_texts_stay_within_the_bounds_of_time_and_memory():
    """All take 300 MB and 20 s of processor time at most; work in the square of the size takes hours."""
    done = subprocess.run([sys.executable, "-c", _BOUNDED], capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) << 10 < 300 << 20
