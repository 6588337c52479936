import signal
import subprocess
import sys
import threading

import pytest

from zsdist.common import signals
from zsdist.common.signals import Interrupted, Interruption, handled_by


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.mark.parametrize("number", signals.STOPPING)
def test_the_first_signal_requests_a_stop_and_the_second_stops_at_once(clock, number):
    before = {each: signal.getsignal(each) for each in signals.STOPPING}
    with handled_by(Interruption(clock=clock)) as interruption:
        assert not interruption()
        signal.raise_signal(number)
        assert interruption()
        assert (interruption.status, interruption.name) == (128 + number, signals.name_of(number))
        clock.now += 2
        with pytest.raises(Interrupted) as stopped:
            signal.raise_signal(signal.SIGINT)
        assert signals.status_of(stopped.value) == 128 + number
    assert {each: signal.getsignal(each) for each in signals.STOPPING} == before


def test_signals_that_arrive_together_are_one_request(clock):
    with handled_by(Interruption(clock=clock)) as interruption:
        for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGTERM):  # as service managers and `timeout` send them
            signal.raise_signal(number)
        assert interruption.name == "SIGTERM"


def test_the_first_signal_raises_where_nothing_has_to_be_saved(clock):
    with handled_by(Interruption(at_once=True, clock=clock)), pytest.raises(Interrupted) as stopped:
        signal.raise_signal(signal.SIGUSR1)
    assert signals.status_of(stopped.value) == 128 + signal.SIGUSR1


def test_ctrl_c_that_python_itself_raised_is_sigint():
    assert signals.status_of(KeyboardInterrupt()) == 130


def test_a_third_signal_kills():
    code = """
import signal, sys
from zsdist.common.signals import Interruption, handled_by
now = iter(range(100))
with handled_by(Interruption(clock=lambda: next(now))):
    for _ in range(3):
        try:
            signal.raise_signal(signal.SIGTERM)
        except KeyboardInterrupt:
            print("insisted", flush=True)
print("not killed")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (-signal.SIGTERM, "insisted\n")


def test_an_ignored_signal_stays_ignored_but_for_those_that_shells_ignore_in_the_background(monkeypatch):
    before = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGHUP, signal.SIGINT)}
    try:
        with handled_by(Interruption()) as interruption:
            signal.raise_signal(signal.SIGHUP)
            assert not interruption()
            signal.raise_signal(signal.SIGINT)
            assert interruption()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def test_a_signal_while_it_is_withheld_takes_effect_afterwards_whatever_handlers_a_library_has_set(clock):
    with handled_by(Interruption(clock=clock)) as interruption:
        with signals.withheld():
            signal.signal(signal.SIGTERM, signal.SIG_DFL)  # as `ray.init` does
            signal.pthread_kill(threading.get_ident(), signal.SIGTERM)  # another thread might take one for the process
            assert not interruption()
        assert interruption.name == "SIGTERM"


def test_processes_that_are_started_while_signals_are_withheld_do_not_react_to_them():
    code = "import signal; print(*sorted(signal.pthread_sigmask(signal.SIG_BLOCK, [])))"
    with signals.withheld():
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert {int(number) for number in done.stdout.split()} >= set(signals.STOPPING)
    assert not signal.pthread_sigmask(signal.SIG_BLOCK, []) & set(signals.STOPPING)


def test_a_request_counts_as_a_signal_and_one_for_a_closed_pipe_never_insists(clock):
    with handled_by(Interruption(clock=clock)) as interruption:
        signals.request(signal.SIGPIPE)
        assert interruption.status == 141
        clock.now += 2
        signals.request(signal.SIGPIPE)
    signals.request(signal.SIGPIPE)  # nothing is handled any longer
