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


_memory_before = 0


def _most_memory():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10


def _outcome(test, fixtures):
    global _memory_before
    _memory_before = _most_memory()
    with open("/proc/self/statm") as stream:
        size = int(stream.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + 2 * BYTES, resource.RLIM_INFINITY))
    try:
        test(**fixtures)
    except BaseException:
        return traceback.format_exc()
    return ""


def survives(read, *given):
    """Read something damaged within the bounds: it may be intact still, else it is refused in one line."""
    limit = int(time.process_time()) + 1 + SECONDS
    resource.setrlimit(resource.RLIMIT_CPU, (limit, resource.RLIM_INFINITY))
    try:
        read(*given)
    except KT3DMoSegError as error:
        assert "\n" not in str(error)
        assert len(str(error)) < 2000
    assert _most_memory() - _memory_before < BYTES
