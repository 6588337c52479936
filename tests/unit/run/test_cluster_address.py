import os
import socket
import threading
import time

import pytest

from zsdist import config
from zsdist.errors import RunError
from zsdist.run import cluster_address

SETTINGS_FRAME = bytes([0, 0, 0, 4, 0, 0, 0, 0, 0])


@pytest.fixture
def server():
    """Server that answers the first connection with what is put into `answer`; nothing at all where it is None."""

    class Server:
        answer: bytes | None = SETTINGS_FRAME

        def __init__(self):
            self.socket = socket.create_server(("127.0.0.1", 0))
            self.port = self.socket.getsockname()[1]
            self.done = threading.Event()
            threading.Thread(target=self.serve, daemon=True).start()

        def serve(self):
            connection, _ = self.socket.accept()
            with connection:
                if self.answer is not None:
                    connection.sendall(self.answer)
                self.done.wait()

    made = Server()
    yield made
    made.done.set()


def test_a_cluster_that_answers_as_ray_does_is_well(server):
    cluster_address.check_answers("127.0.0.1", server.port)


@pytest.mark.parametrize("answer", [b"-ERR unknown command\r\n", b"HTTP/1.1 400 Bad Request\r\n\r\n", None])
def test_what_listens_and_is_not_ray_is_refused_in_time(server, monkeypatch, answer):
    monkeypatch.setattr(cluster_address, "CONNECT_TIMEOUT_S", 0.3)
    server.answer = answer
    began_s = time.monotonic()
    with pytest.raises(RunError, match=f"Ray cluster 127.0.0.1:{server.port}") as refused:
        cluster_address.check_answers("127.0.0.1", server.port)
    assert "ray start --head" in str(refused.value) and "\n" not in str(refused.value)
    assert time.monotonic() - began_s < 5


def test_an_address_at_which_nobody_listens_is_refused_before_a_run_starts():
    with socket.create_server(("127.0.0.1", 0)) as closed:
        address = f"127.0.0.1:{closed.getsockname()[1]}"
    settings = config.parse(
        {"run": {"address": address}, "transport": {"endpoint": "tls/10.0.0.1:7447", "tls": "certificates"}}
    )
    with pytest.raises(RunError, match="does not answer"):
        cluster_address.check(settings)


@pytest.mark.parametrize(
    ("address", "found"),
    [
        ("head:6380", ("head", 6380)),
        ("head", ("head", 6379)),
        ("ray://head", ("head", 10001)),
        ("[fe80::1]:6380", ("fe80::1", 6380)),
        ("[fe80::1]", ("fe80::1", 6379)),
    ],
)
def test_an_address_names_host_and_port(address, found):
    assert cluster_address.resolve(address) == found


@pytest.mark.parametrize("address", ["", ":6379", "head:port", "head:0", "head:70000", "auto:x"])
def test_what_is_no_address_is_refused(address):
    with pytest.raises(RunError, match="is not an address; allowed are auto and HOST:PORT"):
        cluster_address.resolve(address)


def test_auto_means_what_the_environment_names_or_the_cluster_that_was_started_here(monkeypatch, tmp_path):
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    monkeypatch.setenv("RAY_TMPDIR", str(tmp_path))
    with pytest.raises(RunError, match=r"'auto': none was started on this machine; start one .*, or name HOST:PORT"):
        cluster_address.named("auto")
    (tmp_path / "ray").mkdir()
    (tmp_path / "ray" / "ray_current_cluster").write_text("here:3\n")
    assert cluster_address.named("auto") == "here:3"
    monkeypatch.setenv("RAY_ADDRESS", "head:1")
    assert cluster_address.named("auto") == "head:1"
    assert cluster_address.named("other:2") == "other:2"


@pytest.mark.parametrize("name", ["TMPDIR", "RAY_TMPDIR"])
def test_a_folder_for_temporary_files_with_a_long_name_is_refused_by_its_variable(monkeypatch, tmp_path, name):
    for each in ("TMPDIR", "RAY_TMPDIR"):
        monkeypatch.delenv(each, raising=False)
    allowed = 107 - len("/ray/session_2026-11-30_12-11-23_165917_/sockets/plasma_store") - len(str(os.getpid()))
    monkeypatch.setenv(name, "/" + "x" * allowed)
    with pytest.raises(RunError, match=rf"{name} is /x+, which has {allowed + 1} bytes; allowed are {allowed}"):
        cluster_address.check(config.Config())
    monkeypatch.setenv(name, "/" + "x" * (allowed - 1))
    cluster_address.check(config.Config())
    cluster_address.check(config.parse({"placement": "inline", "transport": {"kind": "memory"}}))


@pytest.mark.parametrize("name", ["TMPDIR", "RAY_TMPDIR"])
@pytest.mark.parametrize("folder", ["tmp", "", "/tmp/\u00e9t\u00e9"])
def test_a_folder_for_temporary_files_that_ray_cannot_name_is_refused_and_not_made(monkeypatch, tmp_path, name, folder):
    monkeypatch.chdir(tmp_path)
    for each in ("TMPDIR", "RAY_TMPDIR"):
        monkeypatch.delenv(each, raising=False)
    monkeypatch.setenv(name, folder)
    with pytest.raises(RunError, match=rf"{name} is '.*'; Ray allows an absolute path of ASCII characters"):
        cluster_address.check(config.Config())
    assert list(tmp_path.iterdir()) == []


def test_a_folder_for_temporary_files_that_is_a_file_is_refused(monkeypatch, tmp_path):
    monkeypatch.setenv("RAY_TMPDIR", "/dev/null")
    with pytest.raises(RunError, match="RAY_TMPDIR is /dev/null, where Ray cannot write"):
        cluster_address.check_temporary_folder()
