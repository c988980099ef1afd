"""Submissions, label files, meta data and scores as strangers write them, within the bounds of `bounded`."""

import io
import json
import zipfile

import numpy as np
import pytest
import submission_fuzz
from bounds import bounded, survives
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mseg.evaluation import read_label_files, score_submission
from mseg.evaluation.scoring import from_json, to_json
from mseg.evaluation.submission import parse_meta

thorough = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
PIECES = [
    "[" * 99,
    "{a=" * 99,
    ".a" * 20_000,
    "a." * 20_000,
    "9" * 400,
    "9" * 5000,
    '"""',
    "'",
    "\0",
    "\ud7ff",
]
PIECES += [
    "nan",
    "\\u0000",
    "1e999",
    "-1",
    "0",
    "1,",
    ",",
    "\n",
    "\r",
    "\t",
    "1_0",
    "９",
    "\ufeff",
    "1\n" * 300_000,
]


@st.composite
def edited(draw: st.DrawFn, text: str) -> bytes:
    """A text with pieces put in or out, and now and then a byte that is no UTF-8."""
    for _ in range(draw(st.integers(1, 3))):
        at, cut = draw(st.integers(0, len(text))), draw(st.sampled_from([0, 0, 1, 5]))
        text = text[:at] + draw(st.sampled_from(PIECES)) + text[at + cut :]
    content = text.encode()
    return content + draw(st.sampled_from([b"", b"", b"\xff", b"\xff\xfe"]))


def test_the_bounds_are_limits_of_the_process(monkeypatch):
    @bounded
    def hungry():
        survives(lambda: np.ones(200 << 20, np.uint8))

    @bounded
    def busy():
        survives(lambda: next(n for n in iter(int, 1) if n))

    with pytest.raises(AssertionError, match=r"AssertionError: 20[0-9] MB"):
        hungry()
    monkeypatch.setattr("bounds.SECONDS", 0)
    with pytest.raises(AssertionError, match="killed by signal 24"):
        busy()


@bounded
def test_a_sample_of_mutated_submissions(tmp_path):
    """The full run is ``python tests/evaluation/submission_fuzz.py 10000``."""
    found = {}
    for seed in range(100):
        survives(
            lambda seed=seed: found.setdefault(submission_fuzz.run_case(seed, tmp_path), []).append(seed)
        )
    assert len(found["valid"]) > 5  # unmutated ones among them: the fuzzer is not stuck at the door
    assert len(found["invalid"]) > 60


@pytest.mark.parametrize("suffix", [".txt", ".csv", ".dat"])
@bounded
@given(data=st.data())
@thorough
def test_damaged_label_files(suffix, tmp_path, data):
    for name, clip in submission_fuzz.CLIPS.items():
        text = "".join(f"{label}\n" for label in clip.labels.label)
        if suffix == ".dat":
            text = f"3 {len(clip.evaluated)}\n" + "".join(f"{v} 1\n1.5 2 0\n" for v in clip.labels.label)
        (tmp_path / f"{name}{suffix}").write_bytes(text.encode())
    (tmp_path / f"{name}{suffix}").write_bytes(data.draw(edited(text)))
    survives(lambda: read_label_files(tmp_path, submission_fuzz.CLIPS, zero="outlier"))


@bounded
@given(data=st.data())
@thorough
def test_damaged_meta_data(data):
    text = submission_fuzz.base_files("csv", 1)["meta.toml"].decode()
    content = data.draw(edited(text))

    def read():
        for problem in parse_meta(content)[1]:
            assert "\n" not in str(problem)
            assert len(str(problem)) < 2000

    survives(read)


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.text(max_size=5) | st.integers(-(10**400), 10**400),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)


@pytest.fixture(scope="module")
def scores(tmp_path_factory):
    folder = tmp_path_factory.mktemp("s")
    for name, content in submission_fuzz.base_files("csv", 1).items():
        (folder / name).write_bytes(content)
    return json.dumps(to_json(score_submission(folder, submission_fuzz.CLIPS)))


@bounded
@given(data=st.data())
@thorough
def test_damaged_scores(scores, data):
    survives(from_json, data.draw(edited(scores)))
    made = place = json.loads(scores)
    while place and data.draw(st.integers(0, 3)):
        key = data.draw(st.sampled_from([*place] if isinstance(place, dict) else [*range(len(place))]))
        if not isinstance(place[key], dict | list):
            break
        place = place[key]
    if place:
        key = data.draw(st.sampled_from([*place] if isinstance(place, dict) else [*range(len(place))]))
        place[key] = data.draw(JSON)
    survives(from_json, json.dumps(made))


def test_unmutated_are_valid(tmp_path):
    files = submission_fuzz.base_files("npz", 2)
    packed = tmp_path / "s.zip"
    with zipfile.ZipFile(packed, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    assert submission_fuzz.validate_submission(packed, submission_fuzz.CLIPS).ok
    arrays = np.load(io.BytesIO(files["seed-1/example_two.npz"]))
    assert sorted(arrays.files) == ["label", "track"]
