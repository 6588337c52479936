import errno
import os
import subprocess
import sys

import pytest

from zsdist.common import locks
from zsdist.errors import RunError

HOLDER = """
import pathlib, sys
from zsdist.common import locks
with locks.held(pathlib.Path(sys.argv[1]), "run"):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture(params=["folder", "file"])
def place(request, tmp_path):
    path = tmp_path / request.param
    if request.param == "folder":
        path.mkdir()
    return path


@pytest.fixture
def holder(place):
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(place)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    with process:
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def files(place):
    return {path: path.read_bytes() for path in place.parent.rglob("*") if path.is_file()}


def test_the_second_process_is_refused_by_name_and_changes_nothing(place, holder):
    before = files(place)
    for attempt in (lambda: locks.check_free(place, "run x"), locks.held(place, "run x").__enter__):
        with pytest.raises(RunError, match=f"run x is in use by process {holder.pid} on "):
            attempt()
    assert files(place) == before


def test_a_killed_process_leaves_no_lock_behind(place, holder):
    holder.kill()
    holder.wait()
    locks.check_free(place, "run")
    with locks.held(place, "run"):
        pass


def test_nothing_is_left_of_a_lock_that_is_given_back(place, holder):
    holder.communicate("")
    assert files(place) == {}
    locks.check_free(place, "run")
    assert files(place) == {}


def test_processes_that_the_holder_starts_do_not_hold_its_lock(place):
    with locks.held(place, "run"):
        child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE, close_fds=False)
    with child:
        with locks.held(place, "run"):
            pass
        child.kill()


def test_a_lock_that_its_holder_removes_meanwhile_is_taken_anew(place, monkeypatch):
    with locks.held(place, "first"):
        pass
    opened, removed = os.open, []

    def open_late(path, flags, mode=0o777):
        descriptor = opened(path, flags, mode)
        if not removed:
            removed.append(path)
            os.unlink(path)
        return descriptor

    monkeypatch.setattr(locks.os, "open", open_late)
    with locks.held(place, "run"):
        assert removed and os.path.exists(removed[0])


@pytest.mark.parametrize("number", locks.NO_LOCKS)
def test_a_file_system_without_locks_is_named_and_used(place, monkeypatch, capsys, number):
    def refuse(descriptor, operation):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(locks.fcntl, "flock", refuse)
    with locks.held(place, "run x"):
        assert "run x has no locks on its file system" in capsys.readouterr().err


def test_a_place_that_cannot_be_written_is_one_line(place, monkeypatch):
    def refuse(path, flags, mode=0o777):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(locks.os, "open", refuse)
    with pytest.raises(RunError, match="run x cannot be written: Read-only file system"):
        locks.held(place, "run x").__enter__()


@pytest.mark.parametrize("mode", [0o400, 0o444])
def test_a_lock_file_that_another_user_has_left_is_used(place, monkeypatch, mode):
    """The superuser may write any file, so the refusal of the system is made here."""
    with locks.held(place, "run"):
        (left,) = files(place)
    (place.parent if not place.is_dir() else place).joinpath(left).touch()
    opened = os.open

    def of_another_user(path, flags, mode=0o777):
        if flags & os.O_RDWR:
            raise PermissionError(errno.EACCES, "Permission denied")
        return opened(path, flags, mode)

    monkeypatch.setattr(locks.os, "open", of_another_user)
    monkeypatch.setattr(locks.os, "access", lambda path, how: False)
    with locks.held(place, "run"):
        monkeypatch.setattr(locks.os, "open", opened)
        with pytest.raises(RunError, match="run is in use by another process"), locks.held(place, "run"):
            pass


def test_a_held_lock_is_told_from_one_that_a_killed_process_left(tmp_path):
    assert locks.is_held(tmp_path) is None
    with locks.held(tmp_path, "run"):
        assert locks.is_held(tmp_path) is True
    (tmp_path / locks.LOCK_FILE).touch()
    assert locks.is_held(tmp_path) is False


def test_a_disk_that_takes_no_lock_file_has_none_left(place, monkeypatch):
    def full(descriptor, content):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(locks.os, "write", full)
    with pytest.raises(RunError, match="run cannot be written: No space left"):
        locks.held(place, "run").__enter__()
    assert files(place) == {}


def test_a_lock_that_cannot_be_tried_stays_with_its_holder(place, monkeypatch):
    def broken(descriptor, operation):
        raise OSError(errno.EIO, "Input/output error")

    with locks.held(place, "run"):
        before = files(place)
        with monkeypatch.context() as patched, pytest.raises(RunError, match="run cannot be written: Input/output"):
            patched.setattr(locks.fcntl, "flock", broken)
            locks.held(place, "run").__enter__()
        assert files(place) == before


def test_a_device_is_no_ones_own():
    with locks.held(locks.Path("/dev/null"), "out"), locks.held(locks.Path("/dev/null"), "out"):
        pass
