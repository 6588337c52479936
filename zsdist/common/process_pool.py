"""The same work on many things, in this process or in several."""

import multiprocessing
import multiprocessing.connection
import os
import signal
import threading
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import resource_tracker
from typing import Any, TypeVar

from zsdist.errors import RunError

Item = TypeVar("Item")
Result = TypeVar("Result")
_AHEAD = 2  # things for each worker that are handed out at a time


def each(
    work: Callable[[Item], Result],
    items: Sequence[Item],
    workers: int,
    begin: Callable[..., None],
    arguments: tuple[Any, ...],
    go_on: Callable[[], bool] = lambda: True,
) -> Generator[Result, None, None]:
    """What `work` makes of each item, as it is done; items are taken in order, so that those done are the first ones.

    Where it may not be used up, close the generator: its processes then end at once.

    Args:
        work: on one item; a function of a module, as is `begin`.
        items: what is worked on.
        workers: processes; 1: this one.
        begin: called once in every process, with `arguments`, before any work.
        arguments: of `begin`.
        go_on: asked before an item is taken; where it says no, what was taken is still finished.

    Raises:
        ZsdistError: as the work does.
        RunError: a worker died.
    """
    if workers <= 1:
        begin(*arguments)
        for item in items:
            if not go_on():
                return
            yield work(item)
        return
    environment = {name: os.environ.get(name) for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")}
    os.environ.update(dict.fromkeys(environment, "1"))
    others = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=(begin, arguments))
    left, running = iter(items), set()
    try:
        while True:
            while len(running) < _AHEAD * workers and go_on() and (item := next(left, None)) is not None:
                running.add(_submit(pool, work, item))
            if not running:
                return
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                yield future.result()
    except BrokenProcessPool as error:
        raise RunError("a worker died; with --workers 1 its own message is seen") from error
    finally:
        for child in set(multiprocessing.active_children()) - others:
            child.terminate()
        # Waited for: where the pool's own thread still ends as the interpreter does, Python prints a traceback.
        pool.shutdown(wait=True, cancel_futures=True)
        for name, value in environment.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def _submit(pool: ProcessPoolExecutor, work: Callable[[Item], Result], item: Item) -> Future[Result]:
    """Starts workers deaf to Ctrl-C, which is the parent's to answer: what is blocked here stays so in them.

    Blocked and not ignored, so that a Ctrl-C at this very moment is answered right after it.
    """
    if threading.current_thread() is not threading.main_thread():
        return pool.submit(work, item)
    resource_tracker.ensure_running()  # when it starts, it unblocks what is blocked here
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        return pool.submit(work, item)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin(begin: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    threading.Thread(target=_die_with_parent, daemon=True).start()
    begin(*arguments)


def _die_with_parent() -> None:
    multiprocessing.connection.wait([multiprocessing.parent_process().sentinel])
    os._exit(1)
