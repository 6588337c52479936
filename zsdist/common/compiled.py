"""Compilation of numeric kernels by numba that keeps the types of the functions for type checkers."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(**options: Any) -> Callable[[Function], Function]:
    """Return a decorator that compiles a function at its first call and keeps the machine code on disk.

    Args:
        options: further options of `numba.njit`, such as `fastmath`.
    """

    def decorate(function: Function) -> Function:
        return cast(Function, njit(cache=True, **options)(function))

    return decorate
