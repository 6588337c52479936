"""Transport between processes: clients of a zenoh router that runs in Python, the hub.

A full queue drops messages instead of blocking. In zenoh's blocking mode, the connection of a stalled receiver is
closed and the waiting messages are silently lost, so the protocol above has to make up for losses in any case. Shared
memory is off, since it may silently drop messages when a receiver stalls.
"""

import ctypes
import json as json_codec
import os
import secrets
import threading
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Self

import zenoh
import zenoh.handlers

from zsdist.common.ownership import Owned
from zsdist.errors import TransportError
from zsdist.transport import access
from zsdist.transport.access import RETAINED, Grant
from zsdist.transport.base import Mailbox, Message, Transport
from zsdist.transport.certificates import Identity

CONNECT_TIMEOUT_S = 3.0
LEASE_S = 5.0  # time after which a process that hangs counts as gone; a killed one is noticed at once
PORTS_TRIED = 100
_RETRY = {"period_init_ms": 50, "period_max_ms": 500, "period_increase_factor": 1.5}
_STAMP_IDENTITY = 8  # bytes
_DROP = zenoh.CongestionControl.DROP


class ZenohHub(Owned):
    """Router to which all clients of a run connect. A hub that is dropped is closed.

    Attributes:
        endpoint: address at which it listens, such as `tcp/127.0.0.1:7447`; its port is the first free one.
    """

    def __init__(
        self,
        endpoint: str,
        identity: Identity | None = None,
        grants: Sequence[Grant] = (),
        *,
        ports_tried: int = PORTS_TRIED,
    ) -> None:
        """Listen at `endpoint`, or at the next free port above it.

        Args:
            endpoint: wanted address, such as `tcp/127.0.0.1:7447`, or `tls/HOST:7447` with an identity.
            identity: certificate of the hub; it then accepts only clients with a certificate of its authority.
            grants: rights of these clients, who have no others; without an identity all clients have all rights.
            ports_tried: number of ports to try, from that of `endpoint` on.

        Raises:
            TransportError: the endpoint is malformed or cannot be used, or none of the ports is free.
        """
        address, port = _split(endpoint)
        self._close: Callable[[], object] = lambda: None
        for candidate in range(port, min(port + ports_tried, 65_536)):
            self.endpoint = f"{address}:{candidate}"
            try:
                session = zenoh.open(_config("router", listen=self.endpoint, identity=identity, grants=grants))
                self._close = _when_dropped(self, _Link(self.endpoint, session))
                return
            except zenoh.ZError as error:
                if "in use" not in str(error):
                    raise TransportError(f"cannot listen at {self.endpoint}: {_brief(error)}") from error
        others = f" and the {ports_tried - 1} ports above it are" if ports_tried > 1 else " is"
        raise TransportError(f"cannot listen at {endpoint}: it{others} taken")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop listening; clients keep trying to connect. Closing again does nothing."""
        self._close()


class ZenohTransport(Transport):
    """Client of a hub. It reconnects by itself; while the hub is away, all messages except retained values are lost."""

    def __init__(
        self, endpoint: str, identity: Identity | None = None, *, connect_timeout_s: float = CONNECT_TIMEOUT_S
    ) -> None:
        """Connect to the hub at `endpoint`.

        Args:
            endpoint: address of the hub.
            identity: certificate of the client, for a `tls/` endpoint.
            connect_timeout_s: seconds for which the connection is tried.

        Raises:
            TransportError: no hub answers in time, the endpoint is malformed, or one side does not accept the
                certificate of the other.
        """
        _split(endpoint)
        self.endpoint = endpoint
        self._identity = secrets.token_bytes(_STAMP_IDENTITY)
        config = _config("client", connect=endpoint, connect_timeout_s=connect_timeout_s, identity=identity)
        try:
            self._link = _Link(endpoint, zenoh.open(config))
        except zenoh.ZError as error:
            shown = f", or it refuses certificate {identity.certificate}" if identity else ""
            raise TransportError(f"no hub answers at {endpoint} within {connect_timeout_s:g} s{shown}") from error
        self._session = self._link.session
        self._close = _when_dropped(self, self._link)

    def publish(self, key: str, payload: bytes, *, retained: bool = False, json: bool = False) -> None:
        """See `Transport.publish`."""
        encoding = zenoh.Encoding.APPLICATION_JSON if json else zenoh.Encoding.ZENOH_BYTES
        stamp = None
        if retained:
            kept = self._link.retained.get(key)
            number = 1 if kept is None else kept.number + 1
            stamp = self._identity + number.to_bytes(8, "big")
            self._link.retained[key] = _Retained(number, stamp, payload, encoding)
            if number == 1:
                self._keep(lambda: self._session.declare_queryable(key, _direct(self._link.reply_retained)), key)
        self._try(
            lambda: self._session.put(key, payload, encoding=encoding, attachment=stamp, congestion_control=_DROP), key
        )
        if retained and number == 1:
            self._keep(lambda: self._session.liveliness().declare_token(RETAINED + key), key)

    def subscribe(self, pattern: str, mailbox: Mailbox, *, retained: bool = False) -> None:
        """See `Transport.subscribe`."""
        link = self._link
        if not retained:

            def put(sample: zenoh.Sample) -> None:
                link.put(mailbox, Message(str(sample.key_expr), sample.payload.to_bytes()))

            self._keep(lambda: self._session.declare_subscriber(pattern, _direct(put)), pattern)
            return
        newest = _Newest()

        def arrived(sample: zenoh.Sample) -> None:
            key = str(sample.key_expr)
            if sample.attachment is None or newest.is_new(key, sample.attachment.to_bytes()):
                link.put(mailbox, Message(key, sample.payload.to_bytes()))

        def appeared(token: zenoh.Sample) -> None:  # called when a publisher exists, appears, or reconnects
            if token.kind == zenoh.SampleKind.PUT and link.open.is_set():
                key = str(token.key_expr).removeprefix(RETAINED)
                link.session.get(key, _direct(replied), congestion_control=_DROP)

        def replied(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                arrived(reply.ok)

        self._keep(lambda: self._session.declare_subscriber(pattern, _direct(arrived)), pattern)
        self._keep(
            lambda: self._session.liveliness().declare_subscriber(RETAINED + pattern, _direct(appeared), history=True),
            pattern,
        )

    def serve(self, pattern: str, mailbox: Mailbox) -> None:
        """See `Transport.serve`."""
        link = self._link

        def asked(query: zenoh.Query) -> None:
            payload = b"" if query.payload is None else query.payload.to_bytes()
            link.put(mailbox, Message(str(query.key_expr), payload, link.once(query)))

        self._keep(lambda: self._session.declare_queryable(pattern, _direct(asked)), pattern)

    def request(self, key: str, payload: bytes, mailbox: Mailbox, *, timeout_s: float) -> None:
        """See `Transport.request`."""
        link = self._link

        def answered(reply: zenoh.Reply) -> None:
            if reply.ok is not None:  # a timeout is an error, which means no reply
                link.put(mailbox, Message(key, reply.ok.payload.to_bytes()))

        self._try(
            lambda: self._session.get(
                key, _direct(answered), payload=payload, timeout=timeout_s, congestion_control=_DROP
            ),
            key,
        )

    def declare_alive(self, key: str) -> None:
        """See `Transport.declare_alive`."""
        self._keep(lambda: self._session.liveliness().declare_token(key), key)

    def watch_alive(self, pattern: str, mailbox: Mailbox) -> None:
        """See `Transport.watch_alive`."""
        link = self._link

        def changed(sample: zenoh.Sample) -> None:
            there = sample.kind == zenoh.SampleKind.PUT
            link.put(mailbox, Message(str(sample.key_expr), b"1" if there else b"0"))

        self._keep(
            lambda: self._session.liveliness().declare_subscriber(pattern, _direct(changed), history=True), pattern
        )

    def close(self) -> None:
        """See `Transport.close`."""
        self._close()

    def _keep(self, declare: Callable[[], Any], key: str) -> None:
        self._link.entities.append(self._try(declare, key))

    def _try(self, action: Callable[[], Any], key: str) -> Any:
        if self.is_foreign:
            raise TransportError(f"transport to {self.endpoint} was opened before a fork; open another one after it")
        return self._link.attempt(action, key)


class _Link:
    """Open session, and what its callbacks need. They do not refer to the transport, so that it can be dropped."""

    def __init__(self, endpoint: str, session: zenoh.Session) -> None:
        self.session = session
        self.retained: dict[str, _Retained] = {}
        self.entities: list[Any] = []  # subscribers, services and tokens, which live as long as they are referred to
        self.open = threading.Event()
        self.open.set()
        self._endpoint = endpoint
        _links.add(self)

    def close(self) -> None:
        self.open.clear()
        self.entities.clear()
        self.retained.clear()
        self.session.close()  # type: ignore[no-untyped-call]  # zenoh declares no return type

    def put(self, mailbox: Mailbox, message: Message) -> None:
        if self.open.is_set():
            mailbox.append(message)

    def once(self, query: zenoh.Query) -> Callable[[bytes], None]:
        waiting = [query]

        def reply(payload: bytes) -> None:
            if waiting:
                with waiting.pop() as open_query:  # closing the query tells the client that no further reply follows
                    self.attempt(lambda: open_query.reply(open_query.key_expr, payload), str(open_query.key_expr))

        return reply

    def reply_retained(self, query: zenoh.Query) -> None:
        kept = self.retained.get(str(query.key_expr))
        if kept is not None:
            query.reply(query.key_expr, kept.payload, encoding=kept.encoding, attachment=kept.stamp)

    def attempt(self, action: Callable[[], Any], key: str) -> Any:
        if not self.open.is_set():
            raise TransportError(f"transport to {self._endpoint} is closed; {key} cannot be used")
        try:
            return action()
        except zenoh.ZError as error:
            raise TransportError(f"{key} at {self._endpoint}: {_brief(error)}") from error


_links: weakref.WeakSet[_Link] = weakref.WeakSet()


def _abandon() -> None:
    """Keep all sessions for ever, in a forked process: their threads are missing, and closing would wait for them."""
    for link in _links:
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(link))


os.register_at_fork(after_in_child=_abandon)


def _when_dropped(owner: Owned, link: _Link) -> Callable[[], object]:
    """Return a function that closes a link once; it is called when the owner is dropped, but not at exit."""
    close = weakref.finalize(owner, _close_here, os.getpid(), link)
    close.atexit = False
    return close


def _close_here(process: int, link: _Link) -> None:
    if os.getpid() == process:
        link.close()


@dataclass(frozen=True)
class _Retained:
    """Last value of a key, and the stamp by which receivers recognise it: identity of the sender, then number."""

    number: int
    stamp: bytes
    payload: bytes
    encoding: zenoh.Encoding


class _Newest:
    """Filter that tells new retained values from known ones; zenoh's threads share it."""

    def __init__(self) -> None:
        self._stamps: dict[str, bytes] = {}
        self._lock = threading.Lock()

    def is_new(self, key: str, stamp: bytes) -> bool:
        """Return whether a value is newer than the last one of its sender; a value of another sender is always new."""
        with self._lock:
            last = self._stamps.get(key, b"")
            if last[:_STAMP_IDENTITY] == stamp[:_STAMP_IDENTITY] and stamp <= last:
                return False
            self._stamps[key] = stamp
            return True


def _config(
    mode: str,
    *,
    connect: str | None = None,
    listen: str | None = None,
    connect_timeout_s: float = 0.0,
    identity: Identity | None = None,
    grants: Sequence[Grant] = (),
) -> zenoh.Config:
    """Return the configuration of a session; raise `TransportError` if endpoint and identity do not fit."""
    if (identity is not None) != (connect or listen or "").startswith("tls/"):
        raise TransportError(
            f"endpoint is {connect or listen!r}; allowed is tls/HOST:PORT with certificates, tcp/HOST:PORT without"
        )
    settings = {
        "mode": mode,
        "listen/endpoints": [] if listen is None else [listen],
        "connect/endpoints": [] if connect is None else [connect],
        "connect/timeout_ms": int(1000 * connect_timeout_s),
        "connect/exit_on_failure": True,
        "connect/retry": _RETRY,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/tx/lease": int(1000 * LEASE_S),
        "transport/link/tx/queue/size/data": 16,  # batches of 64 KiB; zenoh allows no more
        "transport/shared_memory/enabled": False,
        "adminspace/enabled": False,
        **_secure(identity, grants, "connect" if listen is None else "listen"),
    }
    config = zenoh.Config()
    for key, value in settings.items():
        try:
            config.insert_json5(key, json_codec.dumps(value))
        except zenoh.ZError as error:
            raise TransportError(f"transport setting {key} is {value!r}: {_brief(error)}") from error
    return config


def _secure(identity: Identity | None, grants: Sequence[Grant], end: str) -> dict[str, Any]:
    """Return settings with which each end checks the other's certificate; the hub's must be for the hub's host."""
    if identity is None:
        return {}
    tls = {
        "root_ca_certificate": str(identity.authority),
        "enable_mtls": True,
        f"{end}_certificate": str(identity.certificate),
        f"{end}_private_key": str(identity.key),
        "verify_name_on_connect": True,
        "close_link_on_expiration": True,
    }
    listening = {"access_control": access.settings(grants)} if end == "listen" else {}
    return {"transport/link/protocols": ["tls"], "transport/link/tls": tls, **listening}


def _direct(callback: Callable[[Any], None]) -> "zenoh.handlers.Callback[Any]":
    """Return a handler that is called on zenoh's own thread; `callback` may only fill a mailbox.

    By default, each callback has an unbounded queue and a Python thread that keeps the process from ending.
    """
    return zenoh.handlers.Callback(callback, indirect=False)


def _split(endpoint: str) -> tuple[str, int]:
    """Return the address (protocol and host) and the port of an endpoint."""
    address, _, port = endpoint.rpartition(":")
    if "/" not in address or not port.isascii() or not port.isdigit() or not 0 < int(port) < 65_536:
        raise TransportError(f"endpoint is {endpoint!r}; allowed is PROTOCOL/HOST:PORT, such as tcp/127.0.0.1:7447")
    return address, int(port)


def _brief(error: Exception) -> str:
    """Return zenoh's message without the positions in its source code."""
    return str(error).split(" at /")[0].strip()
