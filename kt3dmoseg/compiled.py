"""Loops over arrays as machine code: compiled on the first call, then kept on disk."""

import threading
from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

from kt3dmoseg.files import hold_folder

FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])

_lock, _held = threading.RLock(), threading.local()


def compiled(function: FunctionT, **options: Any) -> FunctionT:  # noqa: ANN401
    """Compile a function of arrays and numbers on its first call, with further options of numba.

    The code is kept beside the function's module, else in the user's cache folder; where neither can be
    written every process compiles for itself. Of processes that start together one compiles, the others load.
    Divisions by zero give infinities, as in arrays.
    """
    try:
        kernel: Any = njit(cache=True, error_model="numpy", nogil=True, **options)(function)
    except RuntimeError:  # no folder can be written
        return cast("FunctionT", njit(error_model="numpy", nogil=True, **options)(function))
    make = kernel.compile

    def compile_alone(signature: Any) -> Any:  # noqa: ANN401
        if getattr(_held, "here", False):  # a function that another one calls
            return make(signature)
        with _lock, hold_folder(kernel._cache.cache_path):
            _held.here = True
            try:
                return make(signature)
            finally:
                _held.here = False

    kernel.compile = compile_alone
    return cast("FunctionT", kernel)
