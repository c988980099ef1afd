import json
import re
from itertools import product

import numpy as np
import pytest
from evaluation_helpers import CLIPS, perfect, truth
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

import kt3dmoseg
import mseg
import mseg.cli
from kt3dmoseg.errors import FileFormatError, InvalidValueError, UnknownNameError
from kt3dmoseg.types import Clip, Labels
from mseg.evaluation import SubmissionMeta, score_submission, write_submission
from mseg.evaluation.comparison import compare, comparison_table
from mseg.evaluation.scoring import from_json, to_json
from mseg.evaluation.statistics import bootstrap_mean, holm, wilcoxon_p

CLIP = CLIPS["example_two"]
MANY = {f"clip{i:02}": Clip(f"clip{i:02}", CLIP.dense, CLIP.evaluated, CLIP.labels) for i in range(12)}


def scores_of(folder, method, wrong_by_seed, clips=MANY):
    """Score a submission with a given number of wrong labels per clip, for each seed."""
    label = CLIP.labels.label
    runs = {
        seed: {
            name: np.where(np.arange(40) < w, 3 - label, label) for name, w in zip(clips, wrong, strict=True)
        }
        for seed, wrong in enumerate(wrong_by_seed)
    }
    write_submission(folder / method, clips.values(), runs, SubmissionMeta(method))
    return score_submission(folder / method, clips)


def test_a_clear_difference(tmp_path):
    good = scores_of(tmp_path, "good", [[0] * 12, [0] * 11 + [1]])
    bad = scores_of(tmp_path, "bad", [range(4, 16), range(4, 16)])
    (pair,) = compare([good, bad]).pairs
    assert pair.difference == pytest.approx((0.5 / 12 - 9.5) / 40)
    assert pair.interval.low < pair.difference < pair.interval.high < 0
    assert pair.p == pytest.approx(2 / 2**12)
    assert "good is better than bad by 23.65 points on average over 12 clips" in pair.sentence
    assert "is larger than the seed noise" in pair.sentence
    assert "is consistent" in pair.sentence


def test_a_difference_inside_the_seed_noise(tmp_path):
    one = scores_of(tmp_path, "one", [[0] * 12, [10] * 12])
    two = scores_of(tmp_path, "two", [[4] * 12, [8] * 12])
    (pair,) = compare([one, two]).pairs
    assert pair.seed_sd == pytest.approx(np.hypot(np.std([0, 0.25], ddof=1), np.std([0.1, 0.2], ddof=1)))
    assert "one is better than two" in pair.sentence
    assert "is not larger than the seed noise" in pair.sentence


def test_a_mean_that_one_clip_decides_is_not_called_consistent(tmp_path):
    often = scores_of(tmp_path, "often", [[0] * 11 + [20]])
    rarely = scores_of(tmp_path, "rarely", [[1] * 12])
    for pair in (compare([often, rarely]).pairs[0], compare([rarely, often]).pairs[0]):
        assert "rarely is better than often by" in pair.sentence
        assert "But over the clips often is better, consistently (Wilcoxon" in pair.sentence
        assert pair.p < 0.05


def test_a_mapping_names_what_is_compared():
    clip = next(iter(CLIPS.values()))
    table = mseg.score(clip, clip.labels)
    assert compare({"mine": table, "yours": table}).to_dataframe()["method"].tolist() == ["mine", "yours"]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["mine", "seeds"], "tables: expected several ScoreTable or a mapping, found list of str"),
        ({"a": 0.1, "b": 0.2}, "table: expected ScoreTable, found 0.1"),
    ],
)
def test_what_is_no_score_is_not_compared(given, message):
    for function in (compare, mseg.compare, mseg.evaluation.compare):
        with pytest.raises(InvalidValueError, match=message):
            function(given)


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda table: table.of("clop"), "unknown clip 'clop'; did you mean 'clip'?"),
        (lambda table: table.of("clip", 7), "unknown seed '7'; known: 0"),
        (lambda table: table.matrix("error", ["x"]), "unknown clip 'x'; known: clip"),
        (lambda table: table.summary("error", ["x"]), "unknown clip 'x'; known: clip"),
    ],
)
def test_an_unknown_clip_or_seed_of_scores_is_named(ask, message):
    with pytest.raises(UnknownNameError, match=re.escape(message)):
        ask(mseg.score([1, 1, 2], [1, 1, 2]))


def test_one_seed_is_not_enough(tmp_path):
    one, two = scores_of(tmp_path, "one", [[0] * 12]), scores_of(tmp_path, "two", [[1] * 12])
    assert "seed noise is unknown" in compare([one, two]).pairs[0].sentence
    same = compare([one, one])
    assert same.pairs[0].p == 1
    assert "have the same mean" in same.pairs[0].sentence
    assert same.names == ["one (1)", "one (2)"]


def test_higher_is_better_for_other_metrics(tmp_path):
    one, two = scores_of(tmp_path, "one", [[0] * 12]), scores_of(tmp_path, "two", [[5] * 12])
    assert compare([two, one], metric="f_measure").pairs[0].sentence.startswith("one is better than two")


def test_many_methods_are_corrected(tmp_path):
    tables = [scores_of(tmp_path, f"m{i}", [list(range(i, 12 + i))]) for i in range(4)]
    found = compare(tables)
    assert len(found.pairs) == 6
    assert [pair.p_holm for pair in found.pairs] == holm([pair.p for pair in found.pairs])
    assert "m3" in comparison_table(found).text()


def test_different_data_are_not_compared(tmp_path):
    one = scores_of(tmp_path, "one", [[0] * 12])
    relabelled = {n: c.with_labels(Labels(c.labels.label[::-1].copy())) for n, c in MANY.items()}
    two = scores_of(tmp_path / "x", "two", [[0] * 12], relabelled)
    with pytest.raises(InvalidValueError, match="same clips and labels"):
        compare([one, two])
    with pytest.raises(InvalidValueError, match="two submissions"):
        compare([one])


def test_json_and_back(tmp_path):
    scores = scores_of(tmp_path, "one", [[0] * 12, [3] * 12])
    again = from_json(json.dumps(to_json(scores)))
    assert again.matrix().tolist() == scores.matrix().tolist()
    assert again.provenance == scores.provenance
    assert again.meta == scores.meta
    assert compare([scores, again]).pairs[0].difference == 0


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"format": "mseg-scores", "version": 1}', "[" * 5000])
def test_other_json_is_refused(content):
    with pytest.raises(FileFormatError, match="scores that 'mseg score' wrote"):
        from_json(content)


@given(st.lists(st.floats(-1, 1), min_size=1, max_size=30))
def test_bootstrap_interval_holds_the_mean(values):
    values = np.array(values)
    low, high = bootstrap_mean(values)
    assert values.min() - 1e-9 <= low <= high <= values.max() + 1e-9
    assert bootstrap_mean(values) == (low, high)


def test_bootstrap_of_a_large_sample_is_the_normal_interval():
    values = np.random.default_rng(1).normal(3, 2, 2000)
    low, high = bootstrap_mean(values)
    half = 1.96 * values.std() / np.sqrt(2000)
    assert (low, high) == pytest.approx((values.mean() - half, values.mean() + half), abs=0.02)


@settings(deadline=None, max_examples=40)
@given(st.lists(st.integers(-4, 4), min_size=1, max_size=9))
def test_wilcoxon_is_the_search_over_signs(values):
    nonzero = np.array([v for v in values if v])
    p = wilcoxon_p(np.array(values, dtype=float))
    if not len(nonzero):
        assert p == 1
        return
    ranks = stats.rankdata(np.abs(nonzero))
    sums = np.array([ranks[list(signs)].sum() for signs in product([False, True], repeat=len(ranks))])
    smaller = min(ranks[nonzero > 0].sum(), ranks[nonzero < 0].sum())
    assert p == pytest.approx(min(1, 2 * np.mean(sums <= smaller)))


def test_wilcoxon_is_scipys_without_ties():
    values = np.random.default_rng(0).normal(0.3, 1, 22)
    assert wilcoxon_p(values) == pytest.approx(stats.wilcoxon(values, method="exact").pvalue)


@given(st.lists(st.floats(0, 1), max_size=12))
def test_holm_only_lifts_and_keeps_the_order(p):
    adjusted = holm(p)
    assert all(a >= b for a, b in zip(adjusted, p, strict=True))
    assert all(a <= 1 for a in adjusted)
    assert [adjusted[i] for i in np.argsort(p, kind="stable")] == sorted(adjusted)


def test_command(tmp_path, capsys):
    for name, clip in CLIPS.items():
        kt3dmoseg.save(clip, tmp_path / "data" / f"{name}.h5")
    data = str(tmp_path / "data")
    a = str(perfect(tmp_path / "a"))
    b = str(
        write_submission(
            tmp_path / "b", CLIPS.values(), {n: (v + 1) // 2 for n, v in truth().items()}, SubmissionMeta("b")
        )
    )
    assert mseg.cli.main(["compare", a, b, data]) == 0
    assert "tested is better than b" in capsys.readouterr().out
    assert mseg.cli.main(["compare", a, b, "--data", data, "--json", "--metric", "nmi"]) == 0
    assert json.loads(capsys.readouterr().out)["pairs"][0]["difference"] > 0
    files = []
    for folder in (a, b):
        files.append(f"{folder}.json")
        assert mseg.cli.main(["score", folder, data, "--json", "-o", files[-1]]) == 0
    assert mseg.cli.main(["compare", *files]) == 0
    assert "tested is better than b" in capsys.readouterr().out
    assert mseg.cli.main(["compare", a, b]) == 2
    assert "give the data last" in capsys.readouterr().err
