"""Transport within one process: when a call returns, its messages are in the mailboxes, in a fixed order."""

import weakref
from collections.abc import Callable
from functools import lru_cache

from zsdist.common.ownership import Owned
from zsdist.errors import TransportError
from zsdist.transport.base import Mailbox, Message, Transport

Entries = list[tuple[str, Mailbox]]  # patterns with their mailboxes
Place = tuple[int, int]  # number of a transport, and of one of its patterns


class PatternTree:
    """Mailboxes by pattern. Those of a key are found in a time that does not grow with the number of patterns."""

    def __init__(self) -> None:
        self._children: dict[str, PatternTree] = {}
        self._ends: dict[Place, Mailbox] = {}  # mailboxes of the pattern that ends here

    def add(self, pattern: str, place: Place, mailbox: Mailbox) -> None:
        """Add a mailbox at a place in the order in which `find` returns them."""
        node = self
        for part in pattern.split("/"):
            node = node._children.setdefault(part, PatternTree())
        node._ends[place] = mailbox

    def remove(self, pattern: str, place: Place) -> None:
        """Remove what was added, and all that is empty then."""
        way, parts = [self], pattern.split("/")
        for part in parts:
            way.append(way[-1]._children[part])
        del way[-1]._ends[place]
        for part in reversed(parts):
            child = way.pop()
            if child._ends or child._children:
                return
            del way[-1]._children[part]

    def find(self, key: str) -> list[Mailbox]:
        """Return the mailboxes of all patterns that match a key, in the order of their places."""
        found: dict[Place, Mailbox] = {}
        self._collect(key.split("/"), 0, found)
        return [found[place] for place in sorted(found)]

    def _collect(self, parts: list[str], at: int, found: dict[Place, Mailbox]) -> None:
        if "**" in self._children:
            for behind in range(at, len(parts) + 1):
                self._children["**"]._collect(parts, behind, found)
        if at == len(parts):
            found |= self._ends
            return
        for part in (parts[at], "*"):
            if part in self._children:
                self._children[part]._collect(parts, at + 1, found)


class MemoryBroker(Owned):
    """Connection of the memory transports of one process, for one thread. It delivers in the order of subscription.

    Attributes:
        subscriptions, services, watches: mailboxes of all transports by pattern.
        kept: retained messages of each transport that has any, by its number.
    """

    def __init__(self) -> None:
        """Make a broker without transports."""
        self.subscriptions, self.services, self.watches = PatternTree(), PatternTree(), PatternTree()
        self.kept: dict[int, dict[str, Message]] = {}
        self._transports: dict[int, weakref.ref[MemoryTransport]] = {}
        self._connected = 0  # transports so far

    @property
    def transports(self) -> "list[MemoryTransport]":
        """Open transports, in the order of their connection."""
        return [transport for reference in self._transports.values() if (transport := reference()) is not None]

    def connect(self, transport: "MemoryTransport") -> tuple[int, Callable[[], object]]:
        """Add a transport; return its number and a function that removes it, which is called too when it is dropped."""
        number, self._connected = self._connected, self._connected + 1
        self._transports[number] = weakref.ref(transport)
        held = (transport.tokens, transport.subscriptions, transport.services, transport.watches)
        disconnect = weakref.finalize(transport, self._disconnect, number, *held)
        disconnect.atexit = False
        return number, disconnect

    def announce(self, key: str, payload: bytes) -> None:
        """Tell all that watch a liveliness token whether it is there, `b"1"`, or not, `b"0"`."""
        for mailbox in self.watches.find(key):
            mailbox.append(Message(key, payload))

    def _disconnect(
        self, number: int, tokens: list[str], subscriptions: Entries, services: Entries, watches: Entries
    ) -> None:
        del self._transports[number]
        self.kept.pop(number, None)
        trees = ((self.subscriptions, subscriptions), (self.services, services), (self.watches, watches))
        for tree, entries in trees:
            for index, (pattern, _) in enumerate(entries):
                tree.remove(pattern, (number, index))
        for key in tokens:
            self.announce(key, b"0")

    def retained(self, pattern: str) -> list[Message]:
        """Return the last retained value of each matching key, in the order of their first publication."""
        last: dict[str, Message] = {}
        for _, kept in sorted(self.kept.items()):
            if "*" in pattern:
                last |= {key: message for key, message in kept.items() if matches(pattern, key)}
            elif pattern in kept:
                last[pattern] = kept[pattern]
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
        self.subscriptions: Entries = []
        self.services: Entries = []
        self.watches: Entries = []
        self._broker = broker
        self._open = True
        self._number, self._disconnect = broker.connect(self)

    def publish(self, key: str, payload: bytes, *, retained: bool = False, json: bool = False) -> None:
        """See `Transport.publish`; `json` has no effect."""
        self._require_open()
        message = Message(key, bytes(payload))
        if retained:
            self.kept[key] = message
            self._broker.kept[self._number] = self.kept
        for mailbox in self._broker.subscriptions.find(key):
            mailbox.append(message)

    def subscribe(self, pattern: str, mailbox: Mailbox, *, retained: bool = False) -> None:
        """See `Transport.subscribe`."""
        self._require_open()
        if retained:
            for message in self._broker.retained(pattern):
                mailbox.append(message)
        self._enter(self._broker.subscriptions, self.subscriptions, pattern, mailbox)

    def serve(self, pattern: str, mailbox: Mailbox) -> None:
        """See `Transport.serve`."""
        self._require_open()
        self._enter(self._broker.services, self.services, pattern, mailbox)

    def request(self, key: str, payload: bytes, mailbox: Mailbox, *, timeout_s: float) -> None:
        """See `Transport.request`. There is no clock, so a late reply still arrives."""
        self._require_open()
        message = Message(key, bytes(payload), self._once(key, mailbox))
        for server in self._broker.services.find(key)[:1]:
            server.append(message)

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
        self._enter(self._broker.watches, self.watches, pattern, mailbox)

    def close(self) -> None:
        """See `Transport.close`."""
        self._open = False
        self._disconnect()

    def _enter(self, tree: PatternTree, entries: Entries, pattern: str, mailbox: Mailbox) -> None:
        tree.add(pattern, (self._number, len(entries)), mailbox)
        entries.append((pattern, mailbox))

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
