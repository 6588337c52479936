"""Checks of a folder of certificates."""

from collections.abc import Iterator, Mapping
from pathlib import Path

from zsdist.common import commands, folders
from zsdist.config import Config
from zsdist.diagnostics.cluster import host_of
from zsdist.diagnostics.parts import send_message
from zsdist.diagnostics.result import CheckResult, CheckStatus, guarded
from zsdist.errors import TransportError
from zsdist.roles import permissions
from zsdist.transport.certificates import AUTHORITY, Identity
from zsdist.transport.zenoh import ZenohHub, ZenohTransport

RENEW_DAYS = 30  # certificates with less time left give a warning
TLS_ENDPOINT = "tls/127.0.0.1:7447"  # for a trial of the certificates; if it is in use, the next free port is taken


def check_certificates(folder: Path, endpoint: str | None) -> Iterator[CheckResult]:
    """Check every certificate in a folder, the host of the hub's certificate, and a message over TLS.

    Args:
        folder: folder of certificates, as `transport.tls` names it.
        endpoint: endpoint of the hub; None: the default of `transport.endpoint`.
    """
    names = [path.stem for path in folders.visible(folder, "*.pem") if path.stem != AUTHORITY]
    identities: dict[str, Identity] = {}
    for name in names:
        yield _check_certificate(folder, name, identities)
    if not names:
        advice = f"Run {commands.module('zsdist.certs', folder)}"
        yield CheckResult(f"certificates {folder}", CheckStatus.FAIL, "the folder holds none", advice)
    if permissions.HUB not in identities or permissions.TRUSTED not in identities:
        return  # a machine that runs actors only does not need them
    hosts, wanted = identities[permissions.HUB].hosts(), host_of(endpoint or Config().transport.endpoint)
    status = CheckStatus.OK if wanted in hosts else CheckStatus.FAIL
    advice = "" if wanted in hosts else _renewal(folder, permissions.HUB, *hosts, wanted)
    found = f"{wanted}; the certificate is for {', '.join(hosts)}"
    yield CheckResult("certificate of the hub's host", status, found, advice)
    yield guarded("zenoh over TLS", lambda: _send_over_tls("zenoh over TLS", identities))


def _check_certificate(folder: Path, name: str, identities: dict[str, Identity]) -> CheckResult:
    """Return the result for one certificate; add its identity to `identities` where it can be loaded."""
    check = f"certificate {name}"
    renew = _renewal(folder, name)
    try:
        identity = identities[name] = Identity.load(folder, name)
    except TransportError as error:
        return CheckResult(check, CheckStatus.FAIL, str(error), renew)
    if identity.key.stat().st_mode & 0o007:
        found = f"every user of this machine may read {identity.key}"
        return CheckResult(check, CheckStatus.WARN, found, commands.quoted("chmod", "600", identity.key))
    if name == permissions.HUB:
        renew = _renewal(folder, name, *identity.hosts())
    days = identity.days_left()
    if days < RENEW_DAYS:
        return CheckResult(check, CheckStatus.WARN, f"valid for another {days} days", renew)
    return CheckResult(check, CheckStatus.OK, f"valid for another {days} days")


def _renewal(folder: Path, name: str, *hosts: str) -> str:
    """Return the commands that make a certificate anew, for the hosts of the hub."""
    words = [f"--host={host}" for host in hosts]
    number = name.removeprefix("actor-")
    if number.isdecimal():
        words.append(f"--actors={int(number) + 1}")
    old = [folder.absolute() / f"{name}.{suffix}" for suffix in ("pem", "key")]
    return f"{commands.quoted('rm', *old)} && {commands.module('zsdist.certs', folder, *words)}"


def _send_over_tls(check: str, identities: Mapping[str, Identity]) -> CheckResult:
    with ZenohHub(TLS_ENDPOINT, identities[permissions.HUB], permissions.access_list(1)) as hub:
        trusted = identities[permissions.TRUSTED]
        return send_message(check, hub.endpoint, [ZenohTransport(hub.endpoint, trusted) for _ in range(2)])
