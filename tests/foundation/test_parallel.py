"""The pool of processes and the cache of arrays."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from kt3dmoseg.errors import InputFileError, InvalidValueError, KT3DMoSegError, MissingDependencyError
from kt3dmoseg.parallel import Cache, algorithm_version, cache_key, run_apart, run_tasks


def lost(task, reason):
    return reason


def run(work, tasks, workers=2, **options):
    return dict(run_tasks(work, tasks, lost=lost, workers=workers, **options))


def square(task, progress):
    progress("at", task)
    return task**2, os.getpid()


@pytest.mark.parametrize("workers", [1, 2])
def test_every_task_has_its_result_and_its_progress_arrives(workers):
    seen = []
    results = run(square, range(5), workers, progress=lambda *values: seen.append(values))
    assert {task: value for task, (value, _) in results.items()} == {k: k * k for k in range(5)}
    assert sorted(seen) == [("at", k) for k in range(5)]
    assert ({pid for _, pid in results.values()} == {os.getpid()}) == (workers == 1)


def threads(name, _progress):
    import cv2

    return os.environ.get(name), cv2.getNumThreads()


def test_workers_compute_with_one_thread_and_the_caller_keeps_its_environment(monkeypatch):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    monkeypatch.setenv("MKL_NUM_THREADS", "3")
    before = dict(os.environ)
    found = run(threads, ("OMP_NUM_THREADS", "MKL_NUM_THREADS"))
    assert found == {"OMP_NUM_THREADS": ("1", 1), "MKL_NUM_THREADS": ("3", 1)}
    assert dict(os.environ) == before


def die(task, _progress):
    """Do a task, or die in it as often as its file demands."""
    name, path = task
    if name == "mortal":
        left = int(Path(path).read_text())
        Path(path).write_text(str(left - 1))
        if left > 0:
            os.kill(os.getpid(), signal.SIGKILL)
    return name


@pytest.mark.parametrize(("deaths", "result"), [(2, "mortal"), (99, "its worker processes died 3 times")])
def test_a_dead_worker_costs_its_own_task_only(deaths, result, tmp_path):
    (tmp_path / "left").write_text(str(deaths))
    tasks = [(name, str(tmp_path / "left")) for name in ("a", "mortal", "b", "c", "d")]
    results = {name: value for (name, _), value in run(die, tasks).items()}
    assert results == {name: name for name in "abcd"} | {"mortal": result}
    assert int((tmp_path / "left").read_text()) == max(deaths - 3, -1)


def fail(task, _progress):
    raise InvalidValueError("task", found=f"{task}") if task else ZeroDivisionError("a bug")


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_of_a_task_is_raised_here(workers):
    with pytest.raises(InvalidValueError, match="task: found 1"):
        run(fail, [1, 1], workers)
    with pytest.raises(ZeroDivisionError) as caught:
        run(fail, [0, 0], workers)
    assert workers == 1 or "in fail" in caught.value.__notes__[0]


def test_dask_is_asked_for_by_name(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(
        MissingDependencyError, match=r"a Dask cluster needs distributed; pip install 'kt3dmoseg\[dask\]'"
    ):
        run(square, [1], dask="tcp://127.0.0.1:1")


_SCRIPT = """
from kt3dmoseg.parallel import run_tasks
print(list(run_tasks(print, [1, 2], lost=print, workers=2)))
"""


def test_a_script_without_a_main_guard_is_one_clear_error(tmp_path):
    (tmp_path / "script.py").write_text(_SCRIPT)
    done = subprocess.run(
        [sys.executable, tmp_path / "script.py"], capture_output=True, text=True, timeout=60, check=False
    )
    assert "worker processes end before their first task; in a script" in done.stderr.splitlines()[-1]
    assert done.returncode == 1


def sleep(path, _progress):
    Path(path).write_text(str(os.getpid()))
    time.sleep(60)


def _gone(pid):
    for _ in range(500):
        if not Path(f"/proc/{pid}").exists() or "Z" in Path(f"/proc/{pid}/stat").read_text().split()[2]:
            return True
        time.sleep(0.02)
    return False


def test_workers_end_when_the_results_are_given_up(tmp_path):
    tasks = [str(tmp_path / "a"), str(tmp_path / "b")]
    stop = time.monotonic() + 30

    def give_up(*_):
        raise KeyboardInterrupt

    signal.signal(signal.SIGALRM, give_up)
    signal.setitimer(signal.ITIMER_REAL, 3)
    with pytest.raises(KeyboardInterrupt):
        run(sleep, tasks)
    assert time.monotonic() < stop
    assert all(_gone(int(path.read_text())) for path in tmp_path.iterdir())


def test_cached_arrays_come_back_as_they_were(tmp_path):
    cache, key = Cache(tmp_path / "cache"), cache_key({"a": 1})
    arrays = {"flow": np.arange(6, dtype=np.float32).reshape(3, 2), "reason": np.array("why")}
    assert cache.get(key) is None
    cache.put(key, arrays)
    cache.put(cache_key({"a": 2}), {"seconds": 2.5})
    found = Cache(tmp_path / "cache").get(key)
    assert found.keys() == arrays.keys()
    assert found["flow"].dtype == np.float32
    np.testing.assert_array_equal(found["flow"], arrays["flow"])
    assert str(found["reason"]) == "why"
    assert float(cache.get(cache_key({"a": 2}))["seconds"]) == 2.5


def test_without_a_folder_nothing_is_kept():
    cache = Cache(None)
    cache.put("k", {"a": [1]})
    assert cache.get("k") is None


def test_no_damage_gives_other_arrays(tmp_path):
    cache, key = Cache(tmp_path), cache_key({})
    wanted = np.arange(40, dtype=np.int16).reshape(5, 8)
    cache.put(key, {"kernel": wanted})
    (path,) = tmp_path.rglob("*.npz")
    intact = path.read_bytes()
    lost = 0
    for at in range(len(intact)):
        flipped = bytes([intact[at] ^ (1 << at % 8)])
        for content in (intact[:at], intact[:at] + flipped + intact[at + 1 :]):
            path.write_bytes(content)
            found = cache.get(key)
            lost += found is None
            assert found is None or (found.keys() == {"kernel"} and np.array_equal(found["kernel"], wanted))
    assert lost > 1.5 * len(intact)


def test_arrays_of_another_key_do_not_count(tmp_path):
    cache, one, two = Cache(tmp_path), cache_key({"k": 1}), cache_key({"k": 2})
    cache.put(one, {"a": [1]})
    cache.put(two, {"a": [2]})
    by_key = {path.stem: path for path in tmp_path.rglob("*.npz")}
    by_key[two].write_bytes(by_key[one].read_bytes())
    assert cache.get(two) is None
    assert cache.get(one)["a"].tolist() == [1]


def test_objects_are_never_unpickled(tmp_path):
    cache = Cache(tmp_path)
    cache.put("k", {"a": np.array([{}], dtype=object)})
    assert cache.get("k") is None


def test_an_unwritable_folder_is_one_clear_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputFileError, match="cannot write"):
        Cache(tmp_path / "file").put("k", {"a": [1]})
    assert Cache(tmp_path / "file").get("k") is None


def test_keys_go_by_content():
    a, b = np.zeros((2, 3)), np.zeros((3, 2))
    keys = [{"a": 1}, {"a": 1.0}, {"a": "1"}, {"b": 1}, {"a": a}, {"a": b}, {"a": a.astype(np.float32)}]
    assert len({cache_key(description) for description in keys}) == len(keys)
    assert cache_key({"a": (1, 2), "b": a}) == cache_key({"b": a.copy(), "a": [1, 2]})


def test_the_version_of_an_algorithm_is_the_nearest(monkeypatch):
    from kt3dmoseg import __version__

    class Own:
        ALGORITHM_VERSION = 3

    class Plain:
        pass

    assert algorithm_version(Own) == "3"
    assert algorithm_version(Plain) is None
    assert algorithm_version(KT3DMoSegError) == __version__
    monkeypatch.setattr(sys.modules[__name__], "ALGORITHM_VERSION", 5, raising=False)
    assert algorithm_version(Plain) == "5"
    assert algorithm_version(Own) == "3"


def talk(value):
    print("talk")
    if not value:
        raise InvalidValueError("value", expected="something", found="nothing")
    return value, os.getpid()


def wait_for_ever(path):
    Path(path).write_text(str(os.getpid()))
    while True:
        time.sleep(1)


def test_work_apart_returns_or_raises_in_the_caller():
    value, pid = run_apart(talk, [3], stop=threading.Event())
    assert value == [3]
    assert pid != os.getpid()
    with pytest.raises(InvalidValueError, match="something"):
        run_apart(talk, [], stop=threading.Event())
    with pytest.raises(KT3DMoSegError, match="died"):
        run_apart(os._exit, 7, stop=threading.Event())


def test_more_than_a_pipe_holds_arrives_although_the_other_process_starts_late(monkeypatch):
    monkeypatch.setattr("kt3dmoseg.parallel._POLL", 0.001)
    assert run_apart(len, bytes(1_000_000), stop=threading.Event()) == 1_000_000


def test_work_apart_ends_when_it_is_stopped(tmp_path):
    stop, path = threading.Event(), tmp_path / "pid"

    def stop_when_it_runs():
        while not (path.exists() and path.read_text()):
            time.sleep(0.01)
        stop.set()

    threading.Thread(target=stop_when_it_runs, daemon=True).start()
    with pytest.raises(KT3DMoSegError, match="cancelled"):
        run_apart(wait_for_ever, str(path), stop=stop)
    with pytest.raises(ProcessLookupError):
        os.kill(int(path.read_text()), 0)
