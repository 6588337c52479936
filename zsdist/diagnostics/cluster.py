"""Checks of a cluster: Ray's address and token, its nodes, and the endpoint of the hub."""

import multiprocessing
import socket
from concurrent.futures import ProcessPoolExecutor

from zsdist.diagnostics.result import CheckResult, CheckStatus
from zsdist.errors import RunError
from zsdist.run import cluster_address, placement, ray_token
from zsdist.run.placement import Node

SHOWN_NODES = 8


def check_address(address: str) -> CheckResult:
    """Check that a run on this machine can connect to a Ray cluster, by connecting to it.

    Args:
        address: `HOST[:PORT]`, `ray://HOST[:PORT]` or `auto`.
    """
    check = f"cluster {address}"
    advice = "Check that the head node runs, and that this port is open between this machine and the head node."
    try:
        host, port = cluster_address.resolve(cluster_address.named(address))
        cluster_address.check_answers(host, port)
        advice = "The token of a cluster and its version of Ray: deploy/README.md, docs/security.md."
        ray_token.check(host, port)
        advice = "Launch on a node of the cluster: ray start --address=HOST:PORT makes this machine one."
        nodes = survey(address)
    except RunError as error:
        return CheckResult(check, CheckStatus.FAIL, str(error), advice)
    shown = "; ".join(f"{node.name}: {placement.written(node.total)}" for node in nodes[:SHOWN_NODES])
    more = f"; and {len(nodes) - SHOWN_NODES} more" if len(nodes) > SHOWN_NODES else ""
    return CheckResult(
        check, CheckStatus.OK, f"{host}:{port} has accepted this machine; {len(nodes)} nodes: {shown}{more}"
    )


def survey(address: str) -> list[Node]:
    """Return the nodes of a cluster, to which a process of its own connects: this one may have used another Ray.

    Raises:
        RunError: it cannot connect.
    """
    from zsdist.run import ray_cluster

    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(ray_cluster.survey, address).result()


def check_endpoint(endpoint: str) -> CheckResult:
    """Check that the roles of a cluster can reach the hub's endpoint, and that it asks for certificates."""
    check, advice = f"endpoint {endpoint}", "Set transport.endpoint to this machine's address: tls/HOST:7447."
    host = host_of(endpoint)
    if not host:
        return CheckResult(check, CheckStatus.FAIL, "it is not of the form PROTOCOL/HOST:PORT", advice)
    try:
        addresses = {str(item[4][0]) for item in socket.getaddrinfo(host, None)}
    except OSError as error:
        return CheckResult(check, CheckStatus.FAIL, f"{host} has no address: {error}", advice)
    if any(address.startswith("127.") or address in ("::1", "0.0.0.0", "::") for address in addresses):
        return CheckResult(check, CheckStatus.FAIL, "other machines cannot reach it", advice)
    if not endpoint.startswith("tls/"):
        found = "it does not ask for certificates, so a run refuses it"
        return CheckResult(check, CheckStatus.FAIL, found, advice)
    return CheckResult(check, CheckStatus.OK, f"{', '.join(sorted(addresses))}; other machines can reach it")


def host_of(endpoint: str) -> str:
    """Return the host of `PROTOCOL/HOST:PORT`; empty where the endpoint is not of that form."""
    return endpoint.partition("/")[2].rpartition(":")[0].strip("[]")
