import socket
import threading

import pytest

from zsdist.diagnostics import cluster
from zsdist.diagnostics.result import CheckStatus


@pytest.fixture
def ray_port():
    """Port at which one connection is answered as Ray's head answers it."""

    def serve():
        connection, _ = server.accept()
        with connection:
            connection.sendall(bytes([0, 0, 0, 4, 0, 0, 0, 0, 0]))
            connection.recv(100)

    with socket.create_server(("127.0.0.1", 0)) as server:
        threading.Thread(target=serve, daemon=True).start()
        yield server.getsockname()[1]


@pytest.mark.parametrize("form", ["ray://127.0.0.1:{}", "127.0.0.1:{}"])
def test_a_cluster_that_answers_is_well(ray_port, form):
    assert cluster.check_address(form.format(ray_port)).status is CheckStatus.OK


def test_a_closed_address_and_a_wrong_one_are_not():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    for address in (f"127.0.0.1:{port}", "head:port"):
        wrong = cluster.check_address(address)
        assert wrong.status is CheckStatus.FAIL and wrong.advice


def test_auto_means_the_environments_cluster_or_none(monkeypatch, tmp_path, ray_port):
    monkeypatch.setenv("RAY_TMPDIR", str(tmp_path))
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    assert "none was started on this machine" in cluster.check_address("auto").found
    monkeypatch.setenv("RAY_ADDRESS", f"127.0.0.1:{ray_port}")
    assert cluster.check_address("auto").status is CheckStatus.OK


@pytest.mark.parametrize("endpoint", ["tcp/127.0.0.1:7447", "tcp/localhost:7447", "tcp/[::1]:7447", "7447"])
def test_an_endpoint_that_others_cannot_reach_fails(endpoint):
    assert cluster.check_endpoint(endpoint).status is CheckStatus.FAIL


def test_an_endpoint_with_an_address_of_its_own_is_well():
    assert cluster.check_endpoint("tls/10.0.0.10:7447").status is CheckStatus.OK
    plain = cluster.check_endpoint("tcp/10.0.0.10:7447")
    assert plain.status is CheckStatus.FAIL and "certificate" in plain.found and "tls/" in plain.advice
