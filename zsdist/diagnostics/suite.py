"""Sequence of all checks."""

from collections.abc import Iterator
from pathlib import Path

from zsdist.config import Config
from zsdist.diagnostics import cluster, machine, parts
from zsdist.diagnostics.result import CheckResult, guarded


def run_checks(address: str | None, endpoint: str | None, tls: Path | None = None) -> Iterator[CheckResult]:
    """Run all checks, the quick ones first; an unexpected exception in a part is a failure of that part's check.

    Args:
        address: address of a Ray cluster to check; None: none is checked.
        endpoint: endpoint of the hub to check; None: the default endpoint, and only if there is an `address`.
        tls: folder of certificates to check; None: none are checked.
    """
    yield machine.check_python()
    yield from machine.check_packages()
    yield from machine.check_resources()
    yield guarded("temporary folder", machine.check_temporary)
    yield guarded("cache", machine.check_cache)
    if address is not None:
        yield cluster.check_address(address)
    if address is not None or endpoint is not None:
        yield cluster.check_endpoint(Config().transport.endpoint if endpoint is None else endpoint)
    yield guarded("camera", parts.check_camera)
    yield guarded("vision", parts.check_vision)
    yield guarded("zenoh", parts.check_zenoh)
    yield guarded("ray", parts.check_ray)
    if tls is not None:
        from zsdist.diagnostics import certificates  # imports zenoh, whose absence must not stop the checks above

        yield from certificates.check_certificates(tls, endpoint)
