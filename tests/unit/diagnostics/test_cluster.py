import socket

import pytest
from ray_head import ray_head

from zsdist.diagnostics import cluster
from zsdist.diagnostics.result import CheckStatus
from zsdist.errors import RunError
from zsdist.run.placement import Node

NODES = [Node("1", "10.0.0.1", {"CPU": 4.0}, {}, {}), Node("2", "10.0.0.2", {"CPU": 8.0, "GPU": 1.0}, {}, {})]


@pytest.fixture
def ray_port(monkeypatch):
    """Port of a head that asks for a token; to connect shows two nodes."""
    for name in ("RAY_AUTH_MODE", "RAY_AUTH_TOKEN_PATH", "RAY_ADDRESS"):
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    monkeypatch.setenv("RAY_AUTH_TOKEN", "right")
    monkeypatch.setattr(cluster, "survey", lambda address: NODES)
    with ray_head("right") as port:
        yield port


@pytest.mark.parametrize("form", ["ray://127.0.0.1:{}", "127.0.0.1:{}"])
def test_a_cluster_that_accepts_this_machine_is_well_and_shows_its_nodes(ray_port, form):
    result = cluster.check_address(form.format(ray_port))
    assert result.status is CheckStatus.OK
    assert "2 nodes: 10.0.0.1: 4 cores of Ray; 10.0.0.2: 8 cores of Ray and 1 GPU" in result.found


def test_a_cluster_that_answers_and_refuses_the_token_is_not_well(ray_port, monkeypatch):
    monkeypatch.setenv("RAY_AUTH_TOKEN", "wrong")
    result = cluster.check_address(f"127.0.0.1:{ray_port}")
    assert result.status is CheckStatus.FAIL and "refuses the token in RAY_AUTH_TOKEN" in result.found
    assert "docs/security.md" in result.advice


def test_one_that_cannot_be_connected_to_is_not_well(ray_port, monkeypatch):
    def survey(address):
        raise RunError("this machine is none of its nodes")

    monkeypatch.setattr(cluster, "survey", survey)
    result = cluster.check_address(f"127.0.0.1:{ray_port}")
    assert result.status is CheckStatus.FAIL and "ray start --address" in result.advice


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
