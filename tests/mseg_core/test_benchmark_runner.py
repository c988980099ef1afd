"""The runner: same bytes for any number of workers, resumable, nothing mixed, nothing hidden."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import shutil
import signal

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import mseg
from kt3dmoseg.errors import InputFileError, KT3DMoSegError
from kt3dmoseg.files import hold_folder
from kt3dmoseg.io import load, save
from kt3dmoseg.parallel import Cache, run_tasks
from kt3dmoseg.types import Clip, Labels
from mseg.benchmark import Configuration, find_clips, predict, run
from mseg.benchmark import runner as runner_module
from mseg.benchmark.runner import (
    Outcome,
    Task,
    keep_outcome,
    lost_task,
    outcome_key,
    read_outcome,
    run_task,
)
from mseg.cli import main
from mseg.errors import SegmentationError
from mseg.evaluation import load_protocol, validate_submission
from mseg.methods import METHODS, create

CLIPS = ("Seq005_Clip01", "Seq009_Clip02", "Seq011_Clip01")


@pytest.fixture(scope="module")
def data(make_clip, tmp_path_factory):
    """Three tiny clips under names of the benchmark."""
    folder = tmp_path_factory.mktemp("data") / "kt3dmoseg"
    for seed, name in enumerate(CLIPS):
        clip = make_clip(points=14, seed=seed)
        save(Clip(name, clip.dense, clip.evaluated, clip.labels), folder / f"{name}.h5")
    return folder


@pytest.fixture(scope="module")
def serial(data):
    return run("kt3dmoseg", ["affine", "subset"], data=data, seeds=2)


def test_scores_and_coverage(serial):
    assert repr(serial) == "BenchmarkResult(affine, subset on KT3DMoSeg, 3 of 22 clips, 2 seeds)"
    assert "printed Subset" in serial._repr_html_()
    assert serial.errors.shape == (2, 3, 2)
    assert serial.mean("subset") == serial.errors[1].mean()
    text = serial.summary().text()
    assert "KT3DMoSeg, 3 of 22 clips, 2 seeds" in text
    assert "all clips (3 of 22): mean" in text
    assert "printed Subset" in text
    assert "19 of 22 clips are missing" in text
    assert "mean of 3 of 22" in serial.per_clip().text()


def test_workers_change_nothing(serial, data):
    parallel = run("kt3dmoseg", ["affine", "subset"], data=[data], seeds=2, workers=2)
    assert_array_equal(parallel.errors, serial.errors)


def _same_labels(tasks, results):
    expected = {task.name: run_task(task) for task in tasks}
    assert sorted(task.name for task, _ in results) == sorted(expected)
    for task, outcomes in results:
        assert outcomes.keys() == expected[task.name].keys()
        for key, found in outcomes.items():
            assert not found.reason
            assert_array_equal(found.labels, expected[task.name][key].labels)


@pytest.fixture(scope="module")
def tasks(make_clip):
    clip = make_clip(points=14).without_labels()
    return [
        Task(clip, 2, seed, {"a": Configuration("affine"), "s": Configuration("subset")}) for seed in range(6)
    ]


def test_a_killed_dask_worker_costs_nothing(tasks):
    distributed = pytest.importorskip("distributed")
    results = []
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        for item in run_tasks(run_task, tasks, lost=lost_task, dask=cluster.scheduler_address):
            if not results:
                os.kill(cluster.workers[0].process.pid, signal.SIGKILL)
            results.append(item)
    _same_labels(tasks, results)


def test_no_scheduler_there(data, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("kt3dmoseg.parallel._CONNECT_SECONDS", 1)
    with pytest.raises(InputFileError, match="a Dask scheduler"):
        run("kt3dmoseg", ["one_motion"], data=[data], dask="tcp://127.0.0.1:9")


def dying(work, tasks, *, lost, **_):
    return ((task, lost(task, "its worker processes died 3 times")) for task in tasks)


def test_predictions_whose_workers_died_are_made_by_the_next_run(data, monkeypatch, tmp_path):
    with monkeypatch.context() as broken:
        broken.setattr("mseg.benchmark.runner.run_tasks", dying)
        with pytest.raises(SegmentationError, match="died 3 times"):
            predict(data, tmp_path / "p", "affine")
    assert validate_submission(tmp_path / "p", data).ok
    assert len(list((tmp_path / "p").glob("*.failed"))) == 3
    predict(data, tmp_path / "p", "affine")
    assert not list((tmp_path / "p").glob("*.failed"))


def test_tasks_whose_workers_died_count_as_failed(data, monkeypatch, tmp_path):
    monkeypatch.setattr(runner_module, "run_tasks", dying)
    with pytest.raises(SegmentationError, match=r"found affine on \w+: .*died 3 times"):
        run("kt3dmoseg", ["affine"], data=[data], cache=tmp_path / "cache")
    assert not (tmp_path / "cache").exists()  # it is no result of the method


KILLER = """
import dataclasses, os
import numpy as np
import mseg

@dataclasses.dataclass(frozen=True)
class Killer:
    def segment(self, clip, *, n_motions, rng):
        if clip.name == "Seq005_Clip01":
            os._exit(9)
        return mseg.Segmentation(np.ones(len(clip.evaluated), dtype=int))
"""


@pytest.fixture
def where(request, plugin):
    """Two workers that know the killer, of this machine or of a Dask cluster, as arguments of `run`."""
    plugin("mseg.methods", "killer", "killing:Killer", KILLER)
    if request.param == "processes":
        yield {"workers": 2}
        return
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        yield {"dask": cluster.scheduler_address}


@pytest.mark.parametrize("where", ["processes", "dask"], indirect=True)
def test_a_method_that_kills_its_worker_costs_no_other_method(data, serial, where):
    done, methods = [], ["affine", "killer", "subset"]
    result = run("kt3dmoseg", methods, data=data, progress=lambda *a: done.append(a), **where)
    [(made, clip, _, reason)] = result.failures
    assert (made.method, clip) == ("killer", CLIPS[0])
    assert "workers died" in reason or "died 3 times" in reason
    assert_array_equal(result.errors[[0, 2], :, 0], serial.errors[:, :, 0])
    assert [n for n, *_ in done] == list(range(1, len(done) + 1))
    assert done[-1][1] == len(done)
    assert len(done) == 6 or "dask" in where  # which loses as many as wait for the worker


def test_cached_outcomes_are_not_run_again(serial, data, tmp_path, monkeypatch):
    done = []
    kwargs = {"data": [data], "seeds": 2, "cache": tmp_path, "progress": lambda *a: done.append(a)}
    run("kt3dmoseg", ["affine"], **kwargs)
    assert [d[:2] for d in done] == [(i, 6) for i in range(1, 7)]
    done.clear()
    again = run("kt3dmoseg", ["affine", "subset"], **kwargs)
    assert len(done) == 6
    assert_array_equal(again.errors, serial.errors)
    monkeypatch.setattr(
        runner_module, "run_tasks", lambda _, tasks, **__: pytest.fail("ran") if tasks else iter(())
    )
    assert_array_equal(run("kt3dmoseg", ["affine", "subset"], **kwargs).errors, serial.errors)


def test_a_method_that_draws_nothing_runs_once_for_all_seeds(data, make_clip):
    done = []
    result = run("kt3dmoseg", ["one_motion"], data=[data], seeds=2, progress=lambda *a: done.append(a))
    assert len(done) == len(CLIPS)
    assert_array_equal(result.errors[..., 0], result.errors[..., 1])
    assert outcome_key(Configuration("one_motion"), make_clip(), 2, 0) == outcome_key(
        Configuration("one_motion"), make_clip(), 2, 1
    )


@pytest.mark.parametrize("name", ["one_motion", "alc"])
def test_methods_that_draw_nothing(make_clip, name):
    class Undrawn:
        def __getattr__(self, attribute):
            pytest.fail(f"drew {attribute}")

    create(name).segment(make_clip(), n_motions=2, rng=Undrawn())


def test_keys_distinguish_everything(make_clip):
    clip, other = make_clip(), make_clip(seed=1)
    keys = [
        outcome_key(Configuration("affine"), clip, 2, 0),
        outcome_key(Configuration("homography"), clip, 2, 0),
        outcome_key(Configuration("affine", {"alpha": 9.0}), clip, 2, 0),
        outcome_key(Configuration("affine"), other, 2, 0),
        outcome_key(Configuration("affine"), clip, 3, 0),
        outcome_key(Configuration("affine"), clip, 2, 1),
    ]
    assert len(set(keys)) == len(keys)
    assert outcome_key(Configuration("affine", {"restarts": 100}), clip, 2, 0) == keys[0]


@dataclasses.dataclass(frozen=True)
class Theirs:
    def segment(self, clip, *, n_motions, rng):
        return mseg.Segmentation(np.ones(len(clip.evaluated), dtype=int))


def test_a_method_of_another_package_is_known_by_its_version(make_clip, monkeypatch):
    monkeypatch.setattr(METHODS, "load", lambda name: Theirs)
    clip, keys = make_clip(), []
    for package, stated in (("pytest", None), ("pytest", 2), ("pytest", 3), ("a_loose_file", None)):
        monkeypatch.setattr(Theirs, "__module__", f"{package}.velocity")
        monkeypatch.setattr(Theirs, "ALGORITHM_VERSION", stated, raising=False)
        keys.append(outcome_key(Configuration("theirs"), clip, 2, 0))
    assert len(set(keys)) == len(keys)
    monkeypatch.setattr("mseg.benchmark.runner._THIS_PROCESS", "another process")
    assert outcome_key(Configuration("theirs"), clip, 2, 0) != keys[-1]


@dataclasses.dataclass(frozen=True)
class Faulty:
    fault: str = ""

    def segment(self, clip, *, n_motions, rng):
        if clip.name == CLIPS[0]:
            raise {"value": ValueError, "exit": SystemExit, "stop": KeyboardInterrupt}[self.fault](
                "two\nlines"
            )
        return mseg.Segmentation(np.ones(len(clip.evaluated), dtype=int))


@pytest.mark.parametrize(("fault", "name"), [("value", "ValueError"), ("exit", "SystemExit")])
def test_whatever_a_method_raises_costs_its_clip_only(data, monkeypatch, tmp_path, fault, name):
    monkeypatch.setattr(METHODS, "load", lambda name: Faulty)
    predict(data, tmp_path / "p", "theirs", parameters={"fault": fault})
    reason = (tmp_path / "p" / f"{CLIPS[0]}.failed").read_text()
    assert re.fullmatch(
        rf"found {name} in test_\w+\.py, line \d+: two lines; .*fault of the method\n", reason
    )
    result = run("kt3dmoseg", "theirs", data=data, parameters={"fault": fault})
    assert result.errors[0, :, 0].tolist() == [1, *result.errors[0, 1:, 0]] != [1, 1, 1]
    with pytest.raises(SegmentationError, match=rf"Clip01: found {name} in ") as caught:
        mseg.segment(load(data / f"{CLIPS[0]}.h5"), "theirs", fault=fault)
    assert caught.value.__cause__.__traceback__


def test_an_interrupt_and_a_fault_of_the_runner_are_no_result_of_a_method(data, monkeypatch, tmp_path):
    monkeypatch.setattr(METHODS, "load", lambda name: Faulty)
    with pytest.raises(KeyboardInterrupt):
        predict(data, tmp_path / "p", "theirs", parameters={"fault": "stop"})
    monkeypatch.setattr("mseg.methods._notes", lambda *_, **__: {}["a key"])
    with pytest.raises(KeyError):
        predict(data, tmp_path / "q", "affine")


def test_our_methods_are_known_by_the_version_of_the_algorithms(make_clip, monkeypatch):
    clip, keys = make_clip(), []
    for version in (1, 2, 1):
        monkeypatch.setattr("mseg.methods.ALGORITHM_VERSION", version)
        keys.append(outcome_key(Configuration("subset"), clip, 2, 0))
    assert keys[0] == keys[2] != keys[1]


def test_failures_are_kept_but_not_deaths(tmp_path):
    cache = Cache(tmp_path / "cache")
    none = np.zeros(0, dtype=int)
    keep_outcome(cache, "failed", Outcome(none, 1.0, "too few points"))
    keep_outcome(cache, "died", Outcome(none, float("nan"), "worker died"))
    kept = read_outcome(cache, "failed")
    assert kept is not None
    assert (len(kept.labels), kept.reason) == (0, "too few points")
    assert read_outcome(cache, "died") is None
    assert read_outcome(cache, "never kept") is None


def test_a_failure_counts_as_fully_wrong(data, make_clip, tmp_path):
    small = make_clip(points=3)
    save(Clip("Seq113_Clip01", small.dense, small.evaluated, small.labels), tmp_path / "Seq113_Clip01.h5")
    result = run("kt3dmoseg", ["fundamental"], data=[data, tmp_path])
    row = result.clips.index("Seq113_Clip01")
    assert result.errors[0, row, 0] == 1.0
    assert len(result.failures) == 1
    text = result.summary().text()
    assert "Counted as fully wrong: fundamental on Seq113_Clip01, seed 0: fundamental view" in text


def test_clips_of_other_benchmarks_are_not_counted(data, make_clip, tmp_path):
    clip = make_clip(points=14)
    save(Clip("cars1", clip.dense, clip.evaluated, clip.labels), tmp_path / "cars1.h5")
    clips, others = find_clips(load_protocol("kt3dmoseg"), [data, tmp_path])
    assert (list(clips), others) == (list(CLIPS), ["cars1"])
    with pytest.raises(InputFileError, match="clips of KT3DMoSeg"):
        find_clips(load_protocol("kt3dmoseg"), [tmp_path])


def test_default_folder(data, monkeypatch, tmp_path):
    monkeypatch.setenv("KT3DMOSEG_DATA", str(data.parent))
    assert list(find_clips(load_protocol("kt3dmoseg"))[0]) == list(CLIPS)
    monkeypatch.setenv("KT3DMOSEG_DATA", str(tmp_path))
    with pytest.raises(InputFileError, match="KT3DMOSEG_DATA"):
        find_clips(load_protocol("kt3dmoseg"))


def test_default_folder_may_have_the_name_of_its_archive(data, monkeypatch, tmp_path):
    shutil.copytree(data, tmp_path / "KT3DMoSeg" / "release")
    monkeypatch.setenv("KT3DMOSEG_DATA", str(tmp_path))
    assert list(find_clips(load_protocol("kt3dmoseg"))[0]) == list(CLIPS)
    shutil.copy(data / f"{CLIPS[0]}.h5", tmp_path / "cars1.h5")
    shutil.rmtree(tmp_path / "KT3DMoSeg")
    with pytest.raises(InputFileError, match=r"expected clips of KT3DMoSeg, found 1 others \(cars1\)"):
        find_clips(load_protocol("kt3dmoseg"), [tmp_path])


def test_a_method_named_twice_is_run_once(data):
    result = run("kt3dmoseg", ["affine", "affine", "one_motion"], data=[data])
    assert [c.title for c in result.configurations] == ["affine", "one_motion"]
    assert [row[0] for row in result.summary().rows[:2]] == ["affine", "one_motion"]


def test_parameters_go_to_the_methods_that_have_them(data):
    result = run("kt3dmoseg", ["one_motion", "coreg"], data=[data], parameters={"lam": "0.1"})
    assert [c.title for c in result.configurations] == ["one_motion", "coreg lam=0.1"]
    with pytest.raises(KT3DMoSegError, match="did you mean 'lam'"):
        run("kt3dmoseg", ["coreg"], data=[data], parameters={"lan": 1})


def test_a_configuration_is_known_by_what_differs_from_the_defaults(data):
    typed = [{"lam": "0.1"}, {"lam": 0.10}, {"lam": create("coreg").lam}, {}]
    result = run("kt3dmoseg", [Configuration("coreg", each) for each in typed], data=data)
    assert [c.title for c in result.configurations] == ["coreg lam=0.1", "coreg"]
    assert result.as_dict()["methods"][0] == {"method": "coreg", "parameters": {"lam": 0.1}}
    result = run("kt3dmoseg", "affine", data=data, parameters={"hypotheses": "500", "alpha": "5"})
    assert [c.title for c in result.configurations] == ["affine alpha=5.0"]
    assert create("affine").hypotheses == 500


def test_predictions_resume_and_do_not_mix(data, tmp_path):
    out, done = tmp_path / "predictions", []
    predict(data, out, "affine", seeds=2, progress=lambda *a: done.append(a))
    assert len(done) == 6
    wanted = {p: p.read_bytes() for p in sorted(out.glob("seed-*/*.csv"))}
    assert len(wanted) == 6
    (out / "seed-1" / f"{CLIPS[0]}.csv").unlink()
    done.clear()
    predict(data, out, "affine", seeds=2, workers=2, progress=lambda *a: done.append(a))
    assert [name for *_, name in done] == [f"{CLIPS[0]}, seed 1"]
    assert {p: p.read_bytes() for p in sorted(out.glob("seed-*/*.csv"))} == wanted
    with pytest.raises(KT3DMoSegError, match="differs in parameters"):
        predict(data, out, "affine", seeds=2, parameters={"alpha": 3})
    with pytest.raises(KT3DMoSegError, match="n_motions"):
        predict(data, out, "affine", seeds=2, n_motions=2)
    with pytest.raises(KT3DMoSegError, match="layout"):
        predict(data, out, "affine", seeds=1)
    with pytest.raises(KT3DMoSegError, match="1 or more"):
        predict(data, tmp_path / "zero", "affine", n_motions=0)


def test_kept_predictions_are_those_of_their_own_data_and_options(data, make_clip, tmp_path):
    """A file counts as made only by the outcome that was written into it last."""

    def files(folder):
        return {path.name: path.read_bytes() for path in folder.glob("*.csv")}

    (source := tmp_path / "data").mkdir()
    path, fresh = source / "a.h5", {}
    for seed in (1, 2):
        clip = make_clip(points=14, seed=seed)
        save(Clip("a", clip.dense, clip.evaluated, clip.labels), path)
        fresh[seed] = path.read_bytes(), files(predict(source, tmp_path / f"fresh{seed}", "affine"))
    assert fresh[1][1] != fresh[2][1]
    for seed in (1, 2, 1):
        path.write_bytes(fresh[seed][0])
        assert files(predict(source, tmp_path / "again", "affine")) == fresh[seed][1]
    for seeds in ([0], [5], [0]):
        flat = files(predict(data, tmp_path / "seeds", "affine", seeds=seeds))
        assert flat == files(predict(data, tmp_path / f"seed{seeds[0]}", "affine", seeds=seeds))
    predict(source, tmp_path / "rows", "affine", rows="all")
    with pytest.raises(KT3DMoSegError, match="differs in rows"):
        predict(source, tmp_path / "rows", "affine")
    predict(data, tmp_path / "more", "affine", seeds=3)
    with pytest.raises(KT3DMoSegError, match="expected no other seeds, found seed-2 of an earlier run"):
        predict(data, tmp_path / "more", "affine", seeds=2)
    with pytest.raises(KT3DMoSegError, match=rf"expected no other clips, found {CLIPS[1]}, {CLIPS[2]} of an"):
        predict(data / f"{CLIPS[0]}.h5", tmp_path / "more", "affine", seeds=3)
    counted = predict(source, tmp_path / "count", "affine", n_motions=np.int64(2))
    assert predict(source, counted, "affine", n_motions=2) == counted


def test_what_ran_out_of_memory_is_tried_again(data, monkeypatch, tmp_path):
    real = runner_module.segment

    def full(clip, *args, **options):
        if clip.name == CLIPS[0]:
            raise MemoryError("Unable to allocate 40 GiB")
        return real(clip, *args, **options)

    monkeypatch.setattr(runner_module, "segment", full)
    out, cache = tmp_path / "p", tmp_path / "cache"
    result = run("kt3dmoseg", "affine", data=data, cache=cache)
    assert [reason for *_, reason in result.failures] == ["Unable to allocate 40 GiB"]
    predict(data, out, "affine")
    assert (out / f"{CLIPS[0]}.failed").is_file()
    monkeypatch.setattr(runner_module, "segment", real)
    assert not run("kt3dmoseg", "affine", data=data, cache=cache).failures
    predict(data, out, "affine")
    assert not (out / f"{CLIPS[0]}.failed").exists()


def test_clips_without_labels_next_to_others_change_nothing(data, make_clip, tmp_path):
    clip = make_clip(points=14)
    bare = Clip("Seq113_Clip01", clip.dense, clip.evaluated, Labels(np.zeros(len(clip.evaluated), int)))
    save(bare, tmp_path / "bare" / "Seq113_Clip01.h5")
    result = run("kt3dmoseg", "affine", data=[data, tmp_path / "bare"])
    assert tuple(result.clips) == CLIPS
    assert result.others == ("Seq113_Clip01",)
    with pytest.raises(KT3DMoSegError, match="expected clips with labels, found Seq113_Clip01 without"):
        run("kt3dmoseg", "affine", data=tmp_path / "bare")
    both = shutil.copytree(data, tmp_path / "both")
    shutil.copy(tmp_path / "bare" / "Seq113_Clip01.h5", both)
    found = validate_submission(predict(both, tmp_path / "p", "affine"), both)
    assert found.ok
    assert found.submission.meta.n_motions_given


def test_a_clip_has_the_name_of_its_file(make_clip, tmp_path):
    clip = make_clip(points=14)
    for name in ("first", "second"):
        save(Clip("frames", clip.dense, clip.evaluated, clip.labels), tmp_path / "data" / f"{name}.h5")
    out = predict(tmp_path / "data", tmp_path / "p", "affine")
    assert sorted(path.stem for path in out.glob("*.csv")) == ["first", "second"]
    assert validate_submission(out, tmp_path / "data").ok
    one = predict(tmp_path / "data" / "first.h5", tmp_path / "q", "affine")
    assert [path.stem for path in one.glob("*.csv")] == ["first"]


def test_unlabelled_clips_need_a_number_or_a_method_that_finds_it(make_clip, tmp_path):
    clip = make_clip(points=14)
    bare = Clip("bare", clip.dense, clip.evaluated, Labels(np.zeros(len(clip.evaluated), int)))
    save(bare, tmp_path / "bare.h5")
    predict(tmp_path / "bare.h5", tmp_path / "given", "affine", n_motions=2)
    assert (tmp_path / "given" / "bare.csv").is_file()
    predict(tmp_path / "bare.h5", tmp_path / "found", "affine")
    assert (tmp_path / "found" / "bare.csv").is_file()
    with pytest.raises(SegmentationError, match=r"found bare\.failed: .*cannot find it"):
        predict(tmp_path / "bare.h5", tmp_path / "unknown", "lsa")
    assert "cannot find it" in (tmp_path / "unknown" / "bare.failed").read_text()


def test_methods_find_the_number_of_motions_on_request(data, tmp_path):
    methods, cache = ["affine", "lsa"], tmp_path / "cache"
    given = run("kt3dmoseg", methods, data=[data], cache=cache)
    found = run("kt3dmoseg", methods, data=[data], cache=cache, number="found")
    assert not given.failures
    assert {(c.method, clip) for c, clip, *_ in found.failures} == {("lsa", name) for name in CLIPS}
    assert all("cannot find it" in reason for *_, reason in found.failures)
    assert found.number == found.as_dict()["number"] == "found"
    assert "number of motions found" in found.summary().title
    assert found.summary().columns[-3:] == ["number right, %", "CPU s", "failed"]
    assert found.summary().rows[1][-3] == "0"  # lsa failed on every clip
    out = tmp_path / "found"
    command = ["run", str(data), "-o", str(out), "--method", "affine", "--number", "found", "--quiet"]
    assert main(command) == 0
    scores = mseg.score(data, out)
    assert not scores.meta.n_motions_given
    assert scores.matrix().tolist() == found.tables[0].matrix().tolist()
    with pytest.raises(KT3DMoSegError, match="differs in n_motions"):
        predict(data, out, "affine")
    with pytest.raises(KT3DMoSegError, match="n_motions: expected none where it is to be found, found 2"):
        predict(data, out, "affine", n_motions=2, number="found")
    with pytest.raises(KT3DMoSegError, match="number: expected given or found, found 'known'"):
        run("kt3dmoseg", methods, data=[data], number="known")


def test_command_line(data, tmp_path, capsys):
    out = tmp_path / "predictions"
    assert main(["run", "--method", "subset", str(data), "-o", str(out), "-p", "alpha=10", "--quiet"]) == 0
    assert main(["validate", str(out), str(data)]) == 0
    command = ["benchmark", "kt3dmoseg", "--methods", "affine", "coreg", "--data", str(data)]
    assert main([*command, "--seeds", "2", "--cache", str(tmp_path / "cache"), "--quiet"]) == 0
    assert "3 of 22 clips" in capsys.readouterr().out
    cached = [*command, "--seeds", "2", "--cache", str(tmp_path / "cache"), "--quiet", "--json"]
    assert main([*cached, str(tmp_path / "all.json")]) == 0
    assert "3 of 22 clips" in capsys.readouterr().out
    assert main(cached) == 0
    printed = capsys.readouterr().out
    assert json.loads(printed) == json.loads((tmp_path / "all.json").read_text())
    for dash in (["-"], ["-", "--markdown"]):
        assert main([*cached, *dash]) == 0
        assert capsys.readouterr().out == printed
    assert main([*cached, "a", "b"]) == 2
    assert "argument --json: expected at most 1 value, found 2 (see" in capsys.readouterr().err
    assert main([*command, "-p", "alpah=2", "--no-cache", "--quiet"]) == 2
    assert "did you mean 'alpha'" in capsys.readouterr().err


def test_methods_command(capsys):
    assert main(["methods"]) == 0
    listed = capsys.readouterr().out
    assert all(name in listed for name in mseg.methods.list())
    assert main(["methods", "subset"]) == 0
    assert "gamma" in capsys.readouterr().out
    assert main(["methods", "--json"]) == 0
    described = json.loads(capsys.readouterr().out)
    assert [each["name"] for each in described] == mseg.methods.list()
    assert main(["methods", "subset", "--json"]) == 0
    [subset] = json.loads(capsys.readouterr().out)
    assert subset in described
    assert {"gamma": "0.01"}.items() <= {
        each["name"]: each["default"] for each in subset["parameters"]
    }.items()


@pytest.mark.parametrize(
    ("source", "found"),
    [
        (
            "",
            "expected an importable theirs:Bad, found AttributeError: module 'theirs' has no attribute 'Bad'",
        ),
        (
            "import no_such_package",
            "theirs:Bad, found ModuleNotFoundError: No module named 'no_such_package'",
        ),
        ("1 / 0", "found ZeroDivisionError: division by zero; repair or uninstall the package that names it"),
        ("def", "found SyntaxError: invalid syntax"),
        ("class Bad: pass", "a default for every field, found <class 'theirs.Bad'>"),
        (
            "import dataclasses\n@dataclasses.dataclass\nclass Bad:\n    size: int",
            "Bad'> without one of size",
        ),
    ],
)
def test_a_broken_method_of_another_package_is_one_line(data, plugin, capsys, source, found):
    plugin("mseg.methods", "bad", "theirs:Bad", source)
    assert main(["methods"]) == 0
    [line] = [line for line in capsys.readouterr().out.splitlines() if line.startswith("bad ")]
    assert "(not available: method " in line
    assert found in line
    run_bad = ["run", str(data), "-o", str(data.parent / "bad"), "--method", "bad"]
    for command in (
        ["methods", "bad"],
        run_bad,
        ["benchmark", "kt3dmoseg", "--methods", "bad", "--no-cache"],
    ):
        assert main([*command, *(["--data", str(data)] if command[0] == "benchmark" else [])]) == 2
        printed = capsys.readouterr().err
        assert printed.count("\n") == 1
        assert found in printed
    with pytest.raises(KT3DMoSegError, match=re.escape(found)):
        mseg.segment(load(data / f"{CLIPS[0]}.h5"), "bad")


def test_a_worker_that_lacks_a_method_ends_the_run(tasks, monkeypatch):
    real = METHODS.load
    monkeypatch.setattr(METHODS, "load", lambda name: real(name if name == "affine" else "theirs"))
    with pytest.raises(KT3DMoSegError, match="unknown method 'theirs'"):
        run_task(tasks[0])


def test_one_run_at_a_time_writes_into_a_folder_and_none_into_the_data(data, tmp_path):
    out = tmp_path / "predictions"
    with hold_folder(out), pytest.raises(KT3DMoSegError, match="another run running in this folder"):
        predict(data, out, "affine")
    assert not list(out.iterdir())
    with pytest.raises(KT3DMoSegError, match="expected a folder of predictions, found the data"):
        predict(data, data, "affine")
    assert not (data / "meta.toml").exists()


def test_tables_are_told_apart_by_their_labels(serial):
    first, second = (table.provenance for table in serial.tables)
    assert first.dataset_sha256 == second.dataset_sha256
    assert first.submission_sha256 != second.submission_sha256


def test_kernels_that_cannot_be_kept_are_no_failure_of_the_method(data, tmp_path):
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(InputFileError, match="file"):
        run("kt3dmoseg", ["affine"], data=data, cache=tmp_path / "cache", kernels=tmp_path / "file")
    assert not run("kt3dmoseg", ["affine"], data=data, cache=tmp_path / "cache").failures
