"""Transport within one process: when a call returns, its messages are in the mailboxes, in a fixed order."""

import weakref
from collections.abc import Callable
from functools import lru_cache

from zsdist.common.ownership import Owned
from zsdist.errors import TransportError
from zsdist.transport.base import Mailbox, Message, Transport


class MemoryBroker(Owned):
    """Connection of the memory transports of one process, for one thread. It delivers in the order of subscription."""

    def __init__(self) -> None:
        """Make a broker without transports."""
        self._transports: list[weakref.ref[MemoryTransport]] = []

    @property
    def transports(self) -> "list[MemoryTransport]":
        """Open transports, in the order of their connection."""
        return [transport for reference in self._transports if (transport := reference()) is not None]

    def connect(self, transport: "MemoryTransport") -> Callable[[], object]:
        """Add a transport; return a function that removes it, which is called when the transport is dropped too."""
        reference = weakref.ref(transport)
        self._transports.append(reference)
        disconnect = weakref.finalize(transport, self._disconnect, reference, transport.tokens)
        disconnect.atexit = False
        return disconnect

    def announce(self, key: str, payload: bytes) -> None:
        """Tell all that watch a liveliness token whether it is there, `b"1"`, or not, `b"0"`."""
        for transport in self.transports:
            _deliver(transport.watches, Message(key, payload))

    def _disconnect(self, reference: "weakref.ref[MemoryTransport]", tokens: list[str]) -> None:
        self._transports.remove(reference)
        for key in tokens:
            self.announce(key, b"0")

    def retained(self, pattern: str) -> list[Message]:
        """Return the last retained value of each matching key, in the order of their first publication."""
        last: dict[str, Message] = {}
        for transport in self.transports:
            last |= {key: message for key, message in transport.kept.items() if matches(pattern, key)}
        return list(last.values())


class MemoryTransport(Transport):
    """Access of one role to a `MemoryBroker`.

    Attributes:
        name: name of the role, for error messages.
        kept: last retained message by key.
        tokens: keys of the liveliness tokens that the role holds.
        subscriptions, services, watches: patterns with their mailboxes.
    """

    def __init__(self, broker: MemoryBroker, name: str = "") -> None:
        """Connect to a broker."""
        self.name = name
        self.kept: dict[str, Message] = {}
        self.tokens: list[str] = []
        self.subscriptions: list[tuple[str, Mailbox]] = []
        self.services: list[tuple[str, Mailbox]] = []
        self.watches: list[tuple[str, Mailbox]] = []
        self._broker = broker
        self._open = True
        self._disconnect = broker.connect(self)

    def publish(self, key: str, payload: bytes, *, retained: bool = False, json: bool = False) -> None:
        """See `Transport.publish`; `json` has no effect."""
        self._require_open()
        message = Message(key, bytes(payload))
        if retained:
            self.kept[key] = message
        for transport in self._broker.transports:
            _deliver(transport.subscriptions, message)

    def subscribe(self, pattern: str, mailbox: Mailbox, *, retained: bool = False) -> None:
        """See `Transport.subscribe`."""
        self._require_open()
        if retained:
            for message in self._broker.retained(pattern):
                mailbox.append(message)
        self.subscriptions.append((pattern, mailbox))

    def serve(self, pattern: str, mailbox: Mailbox) -> None:
        """See `Transport.serve`."""
        self._require_open()
        self.services.append((pattern, mailbox))

    def request(self, key: str, payload: bytes, mailbox: Mailbox, *, timeout_s: float) -> None:
        """See `Transport.request`. There is no clock, so a late reply still arrives."""
        self._require_open()
        message = Message(key, bytes(payload), self._once(key, mailbox))
        for transport in self._broker.transports:
            if _deliver(transport.services, message, first=True):
                return

    def declare_alive(self, key: str) -> None:
        """See `Transport.declare_alive`."""
        self._require_open()
        self.tokens.append(key)
        self._broker.announce(key, b"1")

    def watch_alive(self, pattern: str, mailbox: Mailbox) -> None:
        """See `Transport.watch_alive`."""
        self._require_open()
        for transport in self._broker.transports:
            for key in transport.tokens:
                if matches(pattern, key):
                    mailbox.append(Message(key, b"1"))
        self.watches.append((pattern, mailbox))

    def close(self) -> None:
        """See `Transport.close`."""
        self._open = False
        self._disconnect()

    def _once(self, key: str, mailbox: Mailbox) -> Callable[[bytes], None]:
        waiting = [mailbox]

        def reply(payload: bytes) -> None:
            if waiting and self._open:
                waiting.pop().append(Message(key, bytes(payload)))

        return reply

    def _require_open(self) -> None:
        if not self._open:
            raise TransportError(f"memory transport {self.name!r} is closed")


@lru_cache(maxsize=65_536)
def matches(pattern: str, key: str) -> bool:
    """Return whether a key expression matches a key."""
    return _match_parts(pattern.split("/"), key.split("/"))


def _match_parts(pattern: list[str], parts: list[str]) -> bool:
    if not pattern:
        return not parts
    if pattern[0] == "**":
        return any(_match_parts(pattern[1:], parts[skipped:]) for skipped in range(len(parts) + 1))
    return bool(parts) and pattern[0] in ("*", parts[0]) and _match_parts(pattern[1:], parts[1:])


def _deliver(entries: list[tuple[str, Mailbox]], message: Message, *, first: bool = False) -> bool:
    """Put a message into all matching mailboxes, or the first one; return whether there is any."""
    found = False
    for pattern, mailbox in entries:
        if matches(pattern, message.key):
            mailbox.append(message)
            found = True
            if first:
                break
    return found
