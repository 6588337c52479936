"""Settings of zenoh sessions: a router without discovery, and clients of it, with or without certificates."""

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import zenoh

from zsdist.errors import TransportError
from zsdist.transport import access, dead_peers
from zsdist.transport.access import Grant

if TYPE_CHECKING:  # a robot's driver needs no certificates, and no package for them
    from zsdist.transport.certificates import Identity

LEASE_S = 5.0  # time after which a process that hangs counts as gone; a killed one is noticed at once
MAX_WHOLE_BYTES = 4 * 2**20  # largest message that is sent whole
MAX_MESSAGE_BYTES = MAX_WHOLE_BYTES + 64 * 1024  # limit of the connections: a message with its key and headers
MAX_SESSIONS = 8192  # clients of a hub; zenoh's own limit of 1000 would refuse the others
MAX_PENDING = 1000  # of them that connect at the same moment, as all actors of a large run do; zenoh's own is 100
_RETRY = {"period_init_ms": 50, "period_max_ms": 500, "period_increase_factor": 1.5}


def session_config(
    mode: str,
    *,
    connect: str | Sequence[str] = (),
    listen: str | None = None,
    connect_timeout_s: float = 0.0,
    identity: "Identity | None" = None,
    grants: Sequence[Grant] = (),
) -> zenoh.Config:
    """Return the configuration of a session.

    Args:
        mode: `client`, or `router` for a hub.
        connect: endpoint of the hub, or several, of which a client uses the first that answers. A hub that connects to
            another one, as a branch of a tree, tries until it can.
        listen: endpoint at which a hub listens.
        connect_timeout_s: seconds for which a client tries to connect.
        identity: certificate; None: without.
        grants: rights of a hub's clients.

    Raises:
        TransportError: endpoint and identity do not fit.
    """
    targets = [connect] if isinstance(connect, str) else list(connect)
    for endpoint in [*targets, *([] if listen is None else [listen])]:
        if (identity is not None) != endpoint.startswith("tls/"):
            raise TransportError(
                f"endpoint is {endpoint!r}; allowed is tls/HOST:PORT with certificates, tcp/HOST:PORT without"
            )
    is_branch = bool(targets) and listen is not None
    settings = {
        "mode": mode,
        "listen/endpoints": [] if listen is None else [listen],
        "connect/endpoints": targets,
        "connect/timeout_ms": -1 if is_branch else int(1000 * connect_timeout_s),
        "connect/exit_on_failure": not is_branch,
        "connect/retry": _RETRY,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/unicast/max_sessions": MAX_SESSIONS,
        "transport/unicast/accept_pending": MAX_PENDING,
        "transport/link/tx/lease": int(1000 * LEASE_S),
        "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES,
        "transport/link/tx/queue/size/data": 16,  # batches of 64 KiB; zenoh allows no more
        "transport/link/tcp/so_sndbuf": dead_peers.SEND_BUFFER_BYTES,
        "transport/shared_memory/enabled": False,
        "adminspace/enabled": False,
        **_secure(identity, grants, [*(["connect"] if targets else []), *(["listen"] if listen is not None else [])]),
    }
    config = zenoh.Config()
    for key, value in settings.items():
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:
            raise TransportError(f"transport setting {key} is {value!r}: {brief(error)}") from error
    return config


def _secure(identity: "Identity | None", grants: Sequence[Grant], ends: Sequence[str]) -> dict[str, Any]:
    """Return settings with which each end checks the other's certificate; the hub's must be for the hub's host."""
    if identity is None:
        return {}
    tls = {
        "root_ca_certificate": str(identity.authority),
        "enable_mtls": True,
        **{f"{end}_certificate": str(identity.certificate) for end in ends},
        **{f"{end}_private_key": str(identity.key) for end in ends},
        "verify_name_on_connect": True,
        "close_link_on_expiration": True,
        "so_sndbuf": dead_peers.SEND_BUFFER_BYTES,
    }
    listening = {"access_control": access.settings(grants)} if "listen" in ends else {}
    return {"transport/link/protocols": ["tls"], "transport/link/tls": tls, **listening}


def split_endpoint(endpoint: str) -> tuple[str, int]:
    """Return the address (protocol and host) and the port of an endpoint."""
    address, _, port = endpoint.rpartition(":")
    if "/" not in address or not port.isascii() or not port.isdigit() or not 0 < int(port) < 65_536:
        raise TransportError(f"endpoint is {endpoint!r}; allowed is PROTOCOL/HOST:PORT, such as tcp/127.0.0.1:7447")
    return address, int(port)


def brief(error: Exception) -> str:
    """Return zenoh's message without the positions in its source code."""
    return str(error).split(" at /")[0].strip()
