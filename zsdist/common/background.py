"""Work beside a role's steps: functions that run on a thread of their own, or at once where a run has to repeat."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Protocol, TypeVar

Result = TypeVar("Result")


class Background(Protocol):
    """Place where functions run one after another, in the order in which they were given."""

    def __call__(self, function: Callable[[], Result], /) -> Future[Result]:
        """Accept a function, and return its result to come."""


def at_once(function: Callable[[], Result], /) -> Future[Result]:
    """Run a function before this returns: on a virtual clock a result may not depend on how fast a thread is."""
    future: Future[Result] = Future()
    try:
        future.set_result(function())
    except Exception as error:
        future.set_exception(error)
    return future


def thread(name: str) -> Background:
    """Return a place with one thread, which begins with the first function."""
    return ThreadPoolExecutor(1, thread_name_prefix=name).submit
