import socket

import pytest

from zsdist.diagnostics import cluster
from zsdist.diagnostics.result import CheckStatus


def test_a_listening_cluster_address_answers_and_a_closed_one_does_not():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        assert cluster.check_address(f"ray://127.0.0.1:{port}").status is CheckStatus.OK
        assert cluster.check_address(f"127.0.0.1:{port}").status is CheckStatus.OK
    closed = cluster.check_address(f"127.0.0.1:{port}")
    assert closed.status is CheckStatus.FAIL and closed.advice


def test_auto_means_the_environments_cluster_or_none(monkeypatch, tmp_path):
    monkeypatch.setattr(cluster.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    assert "no Ray cluster" in cluster.check_address("auto").found
    with socket.create_server(("127.0.0.1", 0)) as server:
        monkeypatch.setenv("RAY_ADDRESS", f"127.0.0.1:{server.getsockname()[1]}")
        assert cluster.check_address("auto").status is CheckStatus.OK


@pytest.mark.parametrize("endpoint", ["tcp/127.0.0.1:7447", "tcp/localhost:7447", "tcp/[::1]:7447", "7447"])
def test_an_endpoint_that_others_cannot_reach_fails(endpoint):
    assert cluster.check_endpoint(endpoint).status is CheckStatus.FAIL


def test_an_endpoint_with_an_address_of_its_own_is_well():
    assert cluster.check_endpoint("tls/10.0.0.10:7447").status is CheckStatus.OK
    plain = cluster.check_endpoint("tcp/10.0.0.10:7447")
    assert plain.status is CheckStatus.FAIL and "certificate" in plain.found and "tls/" in plain.advice
