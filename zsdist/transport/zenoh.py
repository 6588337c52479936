"""The transport between processes: clients of a zenoh router that runs in Python, the hub.

Everything is sent so that a full pipe drops rather than blocks: with zenoh's blocking mode a receiver that stalls gets
its connection closed and loses what waited, in silence, so loss is made good by the protocol above in any case.
Shared memory is off: it can drop in silence when a receiver stalls.
"""

import json as json_codec
import threading
from collections.abc import Callable
from typing import Any

import zenoh
import zenoh.ext

from zsdist.errors import TransportError
from zsdist.transport.base import Mailbox, Message, Transport

CONNECT_TIMEOUT_S = 3.0
LEASE_S = 5.0  # after which a stopped process counts as gone; a killed one is gone at once
PORTS_TRIED = 100
_RETRY = {"period_init_ms": 50, "period_max_ms": 500, "period_increase_factor": 1.5}
_DROP = zenoh.CongestionControl.DROP


class ZenohHub:
    """Where all clients of a run connect.

    Attributes:
        endpoint: where it listens, such as `tcp/127.0.0.1:7447`; another port than asked for where that was taken.
    """

    def __init__(self, endpoint: str) -> None:
        """Listens at `endpoint`, or at the next free port above it.

        Raises:
            TransportError: the endpoint is malformed, cannot be listened at, or no port above it is free.
        """
        address, port = _split(endpoint)
        self._session: zenoh.Session | None = None
        for candidate in range(port, min(port + PORTS_TRIED, 65_536)):
            self.endpoint = f"{address}:{candidate}"
            try:
                self._session = zenoh.open(_config("router", listen=self.endpoint))
                return
            except zenoh.ZError as error:
                if "in use" not in str(error):
                    raise TransportError(f"cannot listen at {self.endpoint}: {_brief(error)}") from error
        raise TransportError(f"cannot listen at {endpoint}: it and the {PORTS_TRIED - 1} ports above it are taken")

    def close(self) -> None:
        """Stops listening; clients go on trying to connect."""
        if self._session is not None:
            self._session.close()
            self._session = None


class ZenohTransport(Transport):
    """A client of a hub. It reconnects by itself; what is sent while the hub is away is lost, retained values aside."""

    def __init__(self, endpoint: str, *, mode: str = "client", connect_timeout_s: float = CONNECT_TIMEOUT_S) -> None:
        """Connects to the hub at `endpoint`.

        Raises:
            TransportError: nobody listens there within `connect_timeout_s`, or the endpoint is malformed.
        """
        _split(endpoint)
        self.endpoint = endpoint
        self._retained: dict[str, Any] = {}  # advanced publishers, each with the last value of its key
        self._entities: list[Any] = []  # subscribers, services and tokens live as long as they are referred to
        self._open = threading.Event()
        try:
            self._session = zenoh.open(_config(mode, connect=endpoint, connect_timeout_s=connect_timeout_s))
        except zenoh.ZError as error:
            raise TransportError(f"no hub answers at {endpoint} within {connect_timeout_s:g} s") from error
        self._open.set()

    def publish(self, key: str, payload: bytes, *, retained: bool = False, json: bool = False) -> None:
        """See `Transport.publish`."""
        encoding = zenoh.Encoding.APPLICATION_JSON if json else zenoh.Encoding.ZENOH_BYTES
        if not retained:
            self._try(lambda: self._session.put(key, payload, encoding=encoding, congestion_control=_DROP), key)
            return
        if key not in self._retained:
            self._retained[key] = self._try(lambda: self._declare_retained(key), key)
        self._try(lambda: self._retained[key].put(payload, encoding=encoding), key)

    def subscribe(self, pattern: str, mailbox: Mailbox, *, retained: bool = False) -> None:
        """See `Transport.subscribe`."""

        def arrived(sample: zenoh.Sample) -> None:
            self._put(mailbox, Message(str(sample.key_expr), sample.payload.to_bytes()))

        if retained:  # asks publishers for their last values, now and whenever one appears or comes back
            history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
            self._keep(
                lambda: zenoh.ext.declare_advanced_subscriber(self._session, pattern, arrived, history=history), pattern
            )
        else:
            self._keep(lambda: self._session.declare_subscriber(pattern, arrived), pattern)

    def serve(self, pattern: str, mailbox: Mailbox) -> None:
        """See `Transport.serve`."""

        def asked(query: zenoh.Query) -> None:
            payload = b"" if query.payload is None else query.payload.to_bytes()
            self._put(mailbox, Message(str(query.key_expr), payload, self._once(query)))

        self._keep(lambda: self._session.declare_queryable(pattern, asked), pattern)

    def request(self, key: str, payload: bytes, mailbox: Mailbox, *, timeout_s: float) -> None:
        """See `Transport.request`."""

        def answered(reply: zenoh.Reply) -> None:
            if reply.ok is not None:  # a timeout comes as an error, and means no answer
                self._put(mailbox, Message(key, reply.ok.payload.to_bytes()))

        self._try(
            lambda: self._session.get(key, answered, payload=payload, timeout=timeout_s, congestion_control=_DROP), key
        )

    def declare_alive(self, key: str) -> None:
        """See `Transport.declare_alive`."""
        self._keep(lambda: self._session.liveliness().declare_token(key), key)

    def watch_alive(self, pattern: str, mailbox: Mailbox) -> None:
        """See `Transport.watch_alive`."""

        def changed(sample: zenoh.Sample) -> None:
            there = sample.kind == zenoh.SampleKind.PUT
            self._put(mailbox, Message(str(sample.key_expr), b"1" if there else b"0"))

        self._keep(lambda: self._session.liveliness().declare_subscriber(pattern, changed, history=True), pattern)

    def close(self) -> None:
        """See `Transport.close`."""
        if self._open.is_set():
            self._open.clear()
            self._entities.clear()
            self._retained.clear()
            self._session.close()

    def _put(self, mailbox: Mailbox, message: Message) -> None:
        if self._open.is_set():
            mailbox.append(message)

    def _once(self, query: zenoh.Query) -> Callable[[bytes], None]:
        waiting = [query]

        def reply(payload: bytes) -> None:
            if waiting:
                with waiting.pop() as open_query:  # leaving it tells the asker that there is no more to come
                    self._try(lambda: open_query.reply(open_query.key_expr, payload), str(open_query.key_expr))

        return reply

    def _declare_retained(self, key: str) -> Any:
        cache = zenoh.ext.CacheConfig(max_samples=1)
        return zenoh.ext.declare_advanced_publisher(
            self._session, key, cache=cache, publisher_detection=True, congestion_control=_DROP
        )

    def _keep(self, declare: Callable[[], Any], key: str) -> None:
        self._entities.append(self._try(declare, key))

    def _try(self, action: Callable[[], Any], key: str) -> Any:
        if not self._open.is_set():
            raise TransportError(f"transport to {self.endpoint} is closed; {key} cannot be used")
        try:
            return action()
        except zenoh.ZError as error:
            raise TransportError(f"{key} at {self.endpoint}: {_brief(error)}") from error


def _config(
    mode: str, *, connect: str | None = None, listen: str | None = None, connect_timeout_s: float = 0.0
) -> zenoh.Config:
    settings = {
        "mode": mode,
        "listen/endpoints": [] if listen is None else [listen],
        "connect/endpoints": [] if connect is None else [connect],
        "connect/timeout_ms": int(1000 * connect_timeout_s),
        "connect/exit_on_failure": True,
        "connect/retry": _RETRY,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "timestamping/enabled": True,  # by which a retained value is told from one already had
        "transport/link/tx/lease": int(1000 * LEASE_S),
        "transport/link/tx/queue/size/data": 16,  # batches of 64 KiB; the most that zenoh allows
        "transport/shared_memory/enabled": False,
    }
    config = zenoh.Config()
    for key, value in settings.items():
        try:
            config.insert_json5(key, json_codec.dumps(value))
        except zenoh.ZError as error:
            raise TransportError(f"transport setting {key} is {value!r}: {_brief(error)}") from error
    return config


def _split(endpoint: str) -> tuple[str, int]:
    address, _, port = endpoint.rpartition(":")
    if "/" not in address or not port.isascii() or not port.isdigit() or not 0 < int(port) < 65_536:
        raise TransportError(f"endpoint is {endpoint!r}; allowed is PROTOCOL/HOST:PORT, such as tcp/127.0.0.1:7447")
    return address, int(port)


def _brief(error: Exception) -> str:
    """zenoh's own words without the places in its sources."""
    return str(error).split(" at /")[0].strip()
