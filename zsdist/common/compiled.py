"""Compilation of numeric kernels by numba that keeps the types of the functions for type checkers."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

from zsdist.common.cache_folder import compiled_code_folder

Function = TypeVar("Function", bound=Callable[..., Any])
_FOLDER = compiled_code_folder()
_SETTINGS: Any = numba.config  # sets its attributes at run time, unseen by type checkers


def compiled(**options: Any) -> Callable[[Function], Function]:
    """Return a decorator that compiles a function at its first call and keeps the machine code on disk.

    Where no folder for the code can be written, each process compiles for itself.

    Args:
        options: further options of `numba.njit`, such as `fastmath`.
    """

    def decorate(function: Function) -> Function:
        if _FOLDER is None:
            return cast(Function, numba.njit(**options)(function))
        before = _SETTINGS.CACHE_DIR  # of this process: the caller's own functions keep their place
        _SETTINGS.CACHE_DIR = str(_FOLDER)
        try:
            return cast(Function, numba.njit(cache=True, **options)(function))
        finally:
            _SETTINGS.CACHE_DIR = before

    return decorate
