import contextlib
import itertools
import multiprocessing
import multiprocessing.connection
import os
import signal
import subprocess
import sys

import pytest

from zsdist.common import process_pool
from zsdist.common.process_pool import each
from zsdist.errors import ConfigError, RunError


class Begun:
    number = None


def begin(number):
    Begun.number = number


def work(item):
    if item == "die":
        os._exit(3)
    if item == "refuse":
        raise ConfigError("the item is wrong")
    blocked = signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])
    return item * Begun.number, os.getpid(), blocked, os.environ.get("OMP_NUM_THREADS")


@pytest.mark.parametrize("count", [1, 2])
def test_every_item_is_worked_on_by_processes_that_have_begun(count):
    made = list(each(work, [1, 2, 3, 4, 5], count, begin, (10,)))
    assert sorted(value for value, *_ in made) == [10, 20, 30, 40, 50]
    assert (os.getpid() in {process for _, process, *_ in made}) == (count == 1)


@pytest.mark.parametrize("count", [1, 2])
def test_results_of_endless_items_come_in_order_where_work_goes_ahead(count):
    with contextlib.closing(each(work, itertools.count(1), count, begin, (10,), ahead=3)) as made:
        assert [value for value, *_ in itertools.islice(made, 7)] == [10, 20, 30, 40, 50, 60, 70]


def test_workers_ignore_ctrl_c_and_use_one_thread_and_the_parent_is_left_as_it_was(monkeypatch):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    made = list(each(work, [1, 2, 3], 2, begin, (1,)))
    assert {(blocked, threads) for *_, blocked, threads in made} == {(True, "1")}
    assert signal.pthread_sigmask(signal.SIG_BLOCK, []) == before and "OMP_NUM_THREADS" not in os.environ


def test_a_ctrl_c_while_an_item_is_submitted_is_not_lost(hears_ctrl_c):
    class Pool:
        def submit(self, work, item):
            signal.raise_signal(signal.SIGINT)  # to this thread: another one of the process would answer it later

    with pytest.raises(KeyboardInterrupt):
        process_pool.submit(Pool(), work, 1)


def test_when_no_more_items_are_started_the_first_ones_are_done():
    answers = itertools.chain([True, True], itertools.repeat(False))
    assert [value for value, *_ in each(work, [1, 2, 3, 4], 1, begin, (1,), lambda: next(answers))] == [1, 2]


def test_a_worker_that_died_and_an_error_of_the_work_end_it_in_one_line():
    with pytest.raises(RunError, match="a worker process died; run with --workers 1 to see its own message"):
        list(each(work, ["die", 1], 2, begin, (1,)))
    with pytest.raises(ConfigError, match="the item is wrong"):
        list(each(work, ["refuse", 1], 2, begin, (1,)))


def test_a_closed_generator_ends_its_processes():
    with contextlib.closing(each(work, list(range(50)), 2, begin, (1,))) as made:
        next(made)
        processes = multiprocessing.active_children()
    assert len(processes) == 2
    assert all(multiprocessing.connection.wait([process.sentinel], 10.0) for process in processes)  # each has ended


def test_workers_end_with_a_parent_that_was_killed():
    code = (
        "import os, test_process_pool as t; from zsdist.common.process_pool import each\n"
        "if __name__ == '__main__':\n"
        "    for made in each(t.work, list(range(10**6)), 2, t.begin, (1,)):\n"
        "        print(made[1], flush=True); os.kill(os.getpid(), 9)"
    )
    environment = os.environ | {"PYTHONPATH": os.path.dirname(__file__)}
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, env=environment)
    written, _ = process.communicate(timeout=60)  # ends when the last process that could write has ended
    assert process.returncode == -signal.SIGKILL and int(written.split()[0]) > 0
