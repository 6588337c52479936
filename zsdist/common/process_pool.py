"""Work on a sequence of items in this process or in several."""

import multiprocessing
import multiprocessing.connection
import os
import threading
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import resource_tracker
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

from zsdist.common import signals
from zsdist.errors import RunError

Item = TypeVar("Item")
Result = TypeVar("Result")
_AHEAD = 2  # items per worker that are handed out at a time


def each(
    work: Callable[[Item], Result],
    items: Iterable[Item],
    workers: int,
    begin: Callable[..., None],
    arguments: tuple[Any, ...],
    go_on: Callable[[], bool] = lambda: True,
    ahead: int | None = None,
) -> Generator[Result, None, None]:
    """Yield the result of `work` for each item, as soon as it is ready, or in the order of the items with `ahead`.

    Items are started in order, so the finished ones are the first when `go_on` ends the work. Close the generator if it
    may not be exhausted: its processes then end at once.

    Args:
        work: function from an item to its result, at module level, as is `begin`.
        items: items to work on, possibly without an end; none is None.
        workers: number of processes; 1: only this one.
        begin: function that is called once in every process, with `arguments`, before any work.
        arguments: arguments of `begin`.
        go_on: called before an item is started; once it returns false, only the started items are finished.
        ahead: number of items that other processes work on before their results are asked for, which come in order;
            None: a few for each process, and results come as they are ready.

    Raises:
        ZsdistError: `work` raised it.
        RunError: a worker died.
    """
    if workers <= 1:
        begin(*arguments)
        for item in items:
            if not go_on():
                return
            yield work(item)
        return
    others = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=(begin, arguments))
    left = iter(items)
    running: list[Future[Result]] = []
    most = ahead or _AHEAD * workers
    restore = _set_one_thread()
    try:
        while True:
            while len(running) < most and go_on() and (following := next(left, None)) is not None:
                running.append(submit(pool, work, following))
            if not running:
                return
            done = {running[0]} if ahead else wait(running, return_when=FIRST_COMPLETED).done
            ready, running = [each for each in running if each in done], [each for each in running if each not in done]
            for future in ready:
                yield future.result()
    except BrokenProcessPool as error:
        raise RunError("a worker process died; run with --workers 1 to see its own message") from error
    finally:
        for child in set(multiprocessing.active_children()) - others:
            child.kill()
        # Wait: Python prints a traceback if the pool's own thread is still ending when the interpreter exits.
        pool.shutdown(wait=True, cancel_futures=True)
        restore()


def _set_one_thread() -> Callable[[], None]:
    """Let processes that are started from now on compute in one thread each; return the function that ends this."""
    before = {name: os.environ.get(name) for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")}
    os.environ.update(dict.fromkeys(before, "1"))

    def restore() -> None:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})

    return restore


def start(process: BaseProcess) -> None:
    """Start a process that computes in one thread and does not react to signals that ask to stop, as `submit` does."""
    restore = _set_one_thread()
    try:
        with signals.withheld():
            resource_tracker.ensure_running()
        with signals.withheld():
            process.start()
    finally:
        restore()


def submit(pool: ProcessPoolExecutor, work: Callable[[Item], Result], item: Item) -> Future[Result]:
    """Submit an item to a pool whose workers do not react to signals that ask to stop, since the parent does.

    A worker that is started here inherits the blocked signals. They are blocked and not ignored, so that one that
    arrives meanwhile takes effect right afterwards.
    """
    with signals.withheld():
        resource_tracker.ensure_running()  # at its start it unblocks some
    with signals.withheld():
        return pool.submit(work, item)


def _begin(begin: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    threading.Thread(target=_die_with_parent, daemon=True).start()
    begin(*arguments)


def _die_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None, "runs in workers only"
    multiprocessing.connection.wait([parent.sentinel])
    os._exit(1)
