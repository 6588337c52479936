import signal
import subprocess
import sys
import threading

import pytest

from zsdist.run.processes import ProcessIdentity, name_role_thread

WAITS = "import sys\nfrom zsdist.run.processes import ProcessIdentity\nplace = ProcessIdentity.here()\n"
WAITS += "print(place.pid, place.started, flush=True)\nsys.stdin.read()"


@pytest.fixture
def child():
    process = subprocess.Popen([sys.executable, "-c", WAITS], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        pid, started = map(int, process.stdout.readline().split())
        yield process, ProcessIdentity(pid, started)
    finally:
        process.kill()
        process.communicate()


def test_a_stopped_process_is_told_from_one_that_waits_and_is_killed_all_the_same(child):
    process, identity = child
    assert identity.lives() and not identity.pulse().stopped
    process.send_signal(signal.SIGSTOP)
    while not identity.pulse().stopped:
        pass
    assert identity.lives()
    assert identity.kill()
    assert not identity.lives() and identity.pulse() is None
    assert process.wait() == -signal.SIGKILL
    assert identity.kill()  # again, which does nothing


def test_another_process_with_the_same_number_is_left_alone(child):
    process, identity = child
    other = ProcessIdentity(identity.pid, identity.started + 1)
    assert not other.lives() and other.pulse() is None
    assert other.kill()
    assert process.poll() is None and identity.lives()


def test_a_role_moves_when_its_thread_is_woken_and_not_when_others_are():
    woken, answered, ended = threading.Event(), threading.Event(), threading.Event()

    def work():
        name_role_thread()
        answered.set()
        woken.wait()
        answered.set()
        ended.wait()

    thread = threading.Thread(target=work)
    thread.start()
    try:
        identity = ProcessIdentity.here()
        answered.wait()
        seen = [identity.pulse().movement]
        while len(seen) < 100 or seen[-100] != seen[-1]:  # until it waits
            seen.append(identity.pulse().movement)
        before = seen[-1]
        sum(range(10**6))  # this thread computes
        assert identity.pulse().movement == before
        answered.clear()
        woken.set()
        answered.wait()
        while identity.pulse().movement == before:
            pass
    finally:
        woken.set()
        ended.set()
        thread.join()


def test_a_thread_that_computes_wants_a_processor_and_one_that_waits_does_not():
    ended = False

    def work():
        name_role_thread()
        while not ended:
            pass

    identity = ProcessIdentity.here()
    thread = threading.Thread(target=work)
    thread.start()
    try:
        while not identity.pulse().wants_processor:  # but while it waits for the interpreter's lock
            pass
    finally:
        ended = True
        thread.join()
