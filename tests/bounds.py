"""Bounds on what reads files of strangers: a process of its own with 3 s of processor time and 128 MB."""

from __future__ import annotations

import functools
import os
import resource
import time
import traceback

from kt3dmoseg.errors import KT3DMoSegError

SECONDS, BYTES = 3, 128 << 20


def bounded(test):
    """Run a test in a forked process, which the system kills when a case takes too long."""

    @functools.wraps(test)
    def run(**fixtures):
        reader, writer = os.pipe()
        if not (child := os.fork()):
            message = _outcome(test, fixtures)
            with os.fdopen(writer, "w") as stream:
                stream.write(message)
            os._exit(0)
        os.close(writer)
        with os.fdopen(reader) as stream:
            message = stream.read()
        status = os.waitpid(child, 0)[1]
        assert not status, (
            f"killed by signal {os.WTERMSIG(status)}: its last file is {fixtures.get('tmp_path')}"
        )
        assert not message, message

    return run


def _outcome(test, fixtures):
    try:
        test(**fixtures)
    except BaseException:
        return traceback.format_exc()
    return ""


def _memory(name):
    with open("/proc/self/status") as stream:
        return next(int(line.split()[1]) << 10 for line in stream if line.startswith(name))


def survives(read, *given):
    """Read something damaged within the bounds: it may be intact still, else it is refused in one line.

    The bounds are those of this read alone: making the input may take more (hypothesis computes its table of
    characters once per checkout, in 200 MB).
    """
    with open("/proc/self/clear_refs", "w") as stream:
        stream.write("5")  # the peak starts at what there is now
    before = _memory("VmRSS")
    limits = {resource.RLIMIT_CPU: int(time.process_time()) + 1 + SECONDS}
    limits[resource.RLIMIT_AS] = _memory("VmSize") + 2 * BYTES
    for limit, most in limits.items():
        resource.setrlimit(limit, (most, resource.RLIM_INFINITY))
    try:
        read(*given)
    except KT3DMoSegError as error:
        assert "\n" not in str(error)
        assert len(str(error)) < 2000
    finally:
        for limit in limits:
            resource.setrlimit(limit, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    grown = _memory("VmHWM") - before
    assert grown < BYTES, f"{grown >> 20} MB"
