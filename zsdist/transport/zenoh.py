"""Transport between processes: clients of a zenoh router that runs in Python, the hub.

A full queue drops messages instead of blocking. In zenoh's blocking mode, the connection of a stalled receiver is
closed and the waiting messages are silently lost, so the protocol above has to make up for losses in any case. Shared
memory is off, since it may silently drop messages when a receiver stalls.

What is too large for a slow link travels in pieces that its receiver asks for, see `zsdist.transport.pieces`: retained
values and replies, whose keys their receivers may query. Everything else is sent whole and is small. No end of a
connection accepts a message above `MAX_MESSAGE_BYTES`, so that nobody can fill its memory.
"""

import os
import secrets
import time
import weakref
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Self

import zenoh

from zsdist.common.ownership import Owned
from zsdist.errors import TransportError
from zsdist.transport import dead_peers
from zsdist.transport.access import RETAINED, Grant
from zsdist.transport.base import Mailbox, Message, Transport
from zsdist.transport.certificates import Identity
from zsdist.transport.link import DROP, STAMP, STAMP_IDENTITY, Link, Newest, direct
from zsdist.transport.pieces import Manifest
from zsdist.transport.session_config import LEASE_S, MAX_WHOLE_BYTES, brief, session_config, split_endpoint

CONNECT_TIMEOUT_S = 3.0
PORTS_TRIED = 100
TRY_PORT_EVERY_S = 0.05
BRANCHES_FORGET_S = 0.5  # time in which the branches of a tree of hubs forget a root that has died, and its routes


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
        patience_s: float = 0.0,
        root: str | None = None,
        succeeds_root: bool = False,
    ) -> None:
        """Listen at `endpoint`, or at the next free port above it.

        Args:
            endpoint: wanted address, such as `tcp/127.0.0.1:7447`, or `tls/HOST:7447` with an identity.
            identity: certificate of the hub; it then accepts only clients with a certificate of its authority.
            grants: rights of these clients, who have no others; without an identity all clients have all rights.
            ports_tried: number of ports to try, from that of `endpoint` on.
            patience_s: time for which they are tried again if none is free; a process that was killed may hold its port
                for a moment longer.
            root: endpoint of another hub, whose clients and this one's are to reach each other; it may come later.
            succeeds_root: whether this hub takes the place of one that has just died and was the root of others. It
                then waits before it listens: zenoh works out its routes 0.1 s after a change, and a branch that finds
                the new root before it has forgotten the old one stays connected to it for good without any route.

        Raises:
            TransportError: the endpoint is malformed or cannot be used, or none of the ports is free.
        """
        address, port = split_endpoint(endpoint)
        self._close: Callable[[], object] = lambda: None
        if succeeds_root:
            time.sleep(BRANCHES_FORGET_S)
        give_up_s, roots = time.monotonic() + patience_s, root or ()
        for candidate in _repeated(range(port, min(port + ports_tried, 65_536)), give_up_s):
            self.endpoint = f"{address}:{candidate}"
            try:
                session = zenoh.open(
                    session_config("router", listen=self.endpoint, connect=roots, identity=identity, grants=grants)
                )
                self._close = _when_dropped(self, Link(self.endpoint, session))
                dead_peers.give_up_after(candidate, LEASE_S + 1.0)
                return
            except zenoh.ZError as error:
                if "in use" not in str(error):
                    raise TransportError(f"cannot listen at {self.endpoint}: {brief(error)}") from error
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
        self,
        endpoint: str,
        identity: Identity | None = None,
        *,
        connect_timeout_s: float = CONNECT_TIMEOUT_S,
        others: Sequence[str] = (),
    ) -> None:
        """Connect to the hub at `endpoint`.

        Args:
            endpoint: address of the hub.
            others: addresses of other hubs of its tree, one of which is used while it does not answer.
            identity: certificate of the client, for a `tls/` endpoint.
            connect_timeout_s: seconds for which the connection is tried.

        Raises:
            TransportError: no hub answers in time, the endpoint is malformed, or one side does not accept the
                certificate of the other.
        """
        split_endpoint(endpoint)
        self.endpoint = endpoint
        self._identity = secrets.token_bytes(STAMP_IDENTITY)
        targets = [endpoint, *others]
        config = session_config("client", connect=targets, connect_timeout_s=connect_timeout_s, identity=identity)
        try:
            self._link = Link(endpoint, zenoh.open(config))
        except zenoh.ZError as error:
            shown = f", or it refuses certificate {identity.certificate}" if identity else ""
            raise TransportError(f"no hub answers at {endpoint} within {connect_timeout_s:g} s{shown}") from error
        self._session = self._link.session
        self._close = _when_dropped(self, self._link)

    def publish(self, key: str, payload: bytes, *, retained: bool = False, json: bool = False) -> None:
        """See `Transport.publish`."""
        encoding = zenoh.Encoding.APPLICATION_JSON if json else zenoh.Encoding.ZENOH_BYTES
        if not retained:
            self._put(key, payload, encoding)
            return
        kept = self._link.retain(key, payload, self._identity, encoding)
        if kept is None:
            return
        if kept.number == 1:
            self._keep(lambda: self._session.declare_queryable(key, direct(self._link.reply_retained)), key)
        self._put(key, kept.payload, encoding, kept.stamp)
        if kept.number == 1:
            self._keep(lambda: self._session.liveliness().declare_token(RETAINED + key), key)

    def subscribe(self, pattern: str, mailbox: Mailbox, *, retained: bool = False) -> None:
        """See `Transport.subscribe`."""
        link = self._link
        if not retained:

            def put(sample: zenoh.Sample) -> None:
                link.put(mailbox, Message(str(sample.key_expr), sample.payload.to_bytes()))

            self._keep(lambda: self._session.declare_subscriber(pattern, direct(put)), pattern)
            return
        newest = Newest()

        def arrived(sample: zenoh.Sample) -> None:
            key = str(sample.key_expr)
            stamp = b"" if sample.attachment is None else sample.attachment.to_bytes()
            if not stamp or newest.is_new(key, stamp[:STAMP]):
                link.receive(mailbox, key, sample.payload, Manifest.unpack(stamp[STAMP:]), is_reply=False)

        def appeared(token: zenoh.Sample) -> None:  # called when a publisher exists, appears, or reconnects
            if token.kind == zenoh.SampleKind.PUT and link.open.is_set():
                key = str(token.key_expr).removeprefix(RETAINED)
                link.session.get(key, direct(replied), congestion_control=DROP)

        def replied(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                arrived(reply.ok)

        self._keep(lambda: self._session.declare_subscriber(pattern, direct(arrived)), pattern)
        self._keep(
            lambda: self._session.liveliness().declare_subscriber(RETAINED + pattern, direct(appeared), history=True),
            pattern,
        )

    def serve(self, pattern: str, mailbox: Mailbox) -> None:
        """See `Transport.serve`."""
        link = self._link

        def asked(query: zenoh.Query) -> None:
            if query.attachment is not None:
                link.answer_piece(query, link.replies)
                return
            payload = b"" if query.payload is None else query.payload.to_bytes()
            link.put(mailbox, Message(str(query.key_expr), payload, link.once(query)))

        self._keep(lambda: self._session.declare_queryable(pattern, direct(asked)), pattern)

    def request(self, key: str, payload: bytes, mailbox: Mailbox, *, timeout_s: float) -> None:
        """See `Transport.request`."""
        link = self._link

        def answered(reply: zenoh.Reply) -> None:
            if reply.ok is not None:  # a timeout is an error, which means no reply
                about = b"" if reply.ok.attachment is None else reply.ok.attachment.to_bytes()
                link.receive(mailbox, key, reply.ok.payload, Manifest.unpack(about), is_reply=True)

        if link.fetcher.fetching(key, id(mailbox)):
            return  # the reply is on its way
        self._try(
            lambda: self._session.get(
                key, direct(answered), payload=payload, timeout=timeout_s, congestion_control=DROP
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
            lambda: self._session.liveliness().declare_subscriber(pattern, direct(changed), history=True), pattern
        )

    def close(self) -> None:
        """See `Transport.close`."""
        self._close()

    def _put(self, key: str, payload: bytes, encoding: zenoh.Encoding, stamp: bytes | None = None) -> None:
        if len(payload) > MAX_WHOLE_BYTES:
            raise TransportError(f"{key}: a message has {len(payload)} bytes; allowed are {MAX_WHOLE_BYTES}")
        self._try(
            lambda: self._session.put(key, payload, encoding=encoding, attachment=stamp, congestion_control=DROP), key
        )

    def _keep(self, declare: Callable[[], Any], key: str) -> None:
        self._link.entities.append(self._try(declare, key))

    def _try(self, action: Callable[[], Any], key: str) -> Any:
        if self.is_foreign:
            raise TransportError(f"transport to {self.endpoint} was opened before a fork; open another one after it")
        return self._link.attempt(action, key)


def _repeated(ports: range, give_up_s: float) -> Iterator[int]:
    """Yield the ports in order, and again after a pause until a time, `time.monotonic`, has come."""
    yield from ports
    while time.monotonic() < give_up_s:
        time.sleep(TRY_PORT_EVERY_S)
        yield from ports


def _when_dropped(owner: Owned, link: Link) -> Callable[[], object]:
    """Return a function that closes a link once; it is called when the owner is dropped, but not at exit."""
    close = weakref.finalize(owner, _close_here, os.getpid(), link)
    close.atexit = False
    return close


def _close_here(process: int, link: Link) -> None:
    if os.getpid() == process:
        link.close()
