import os
import signal
import subprocess
import sys

import psutil
import pytest

from zsdist.run import undertaker

PATIENCE_S = 30.0
CHILD = "subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)'], start_new_session=True).pid"
LAUNCHER = f"""
import subprocess, sys
from zsdist.run import undertaker
with undertaker.employed():
    print({CHILD}, flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def launched():
    """Launcher with an undertaker, and a process that it has started."""
    with subprocess.Popen(
        [sys.executable, "-c", LAUNCHER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as launcher:
        child = psutil.Process(int(launcher.stdout.readline()))
        yield launcher, child
        launcher.kill()
        if child.is_running():
            child.kill()


def test_a_family_is_buried_though_it_carries_no_word():
    other = subprocess.Popen([sys.executable, "-c", "import sys; sys.stdin.read()"], stdin=subprocess.PIPE, env={})
    family = undertaker.descendants(os.getpid())
    assert other.pid in {pid for pid, _ in family}
    undertaker.bury("a word", {identity for identity in family if identity[0] == other.pid})
    assert other.wait(PATIENCE_S) == -signal.SIGKILL
    other.stdin.close()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_nothing_outlives_a_killed_launcher(launched, number):
    launcher, child = launched
    launcher.send_signal(number)
    child.wait(PATIENCE_S)


def test_nothing_is_left_where_the_launcher_ends_by_itself(launched):
    launcher, child = launched
    launcher.stdin.close()
    assert launcher.wait(PATIENCE_S) == 0
    child.wait(PATIENCE_S)


def test_other_processes_are_left_alone():
    other = subprocess.Popen([sys.executable, "-c", "import sys; sys.stdin.read()"], stdin=subprocess.PIPE)
    with undertaker.employed():
        assert os.environ[undertaker.WORD]
    assert undertaker.WORD not in os.environ
    undertaker.bury("a word that nobody carries", set())
    assert other.poll() is None
    other.communicate()
