"""Node of ROS 2 on a zenoh session: publishers, subscriptions and the tokens by which other nodes discover them."""

import secrets
import threading
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import zenoh

from zsdist.common.ownership import Owned
from zsdist.errors import TransportError
from zsdist.ros2 import attachment, keys
from zsdist.ros2.attachment import GID_BYTES, Attachment
from zsdist.ros2.keys import NEWEST, Entity, EntityKind, QualityOfService, TopicType
from zsdist.transport.link import DROP, direct
from zsdist.transport.session_config import brief, session_config, split_endpoint

CONNECT_TIMEOUT_S = 5.0


class Received(NamedTuple):
    """Message as it arrived.

    Attributes:
        data: its bytes.
        attachment: its attachment; None: it had none, or an unknown one.
        arrived_s: time of arrival, `time.monotonic`.
    """

    data: bytes
    attachment: Attachment | None
    arrived_s: float


class NewestMessage:
    """Place for the newest message of a topic: a later one replaces an earlier one that nobody has taken.

    Attributes:
        count: number of messages that have arrived.
        nameless: number of those without a valid attachment, which were dropped as ROS 2 drops them.
    """

    def __init__(self, wake: Callable[[], None] = lambda: None) -> None:
        self.count = self.nameless = 0
        self._wake = wake
        self._lock = threading.Lock()
        self._waiting: Received | None = None

    def put(self, received: Received) -> None:
        """Replace what waits; called by zenoh's threads."""
        with self._lock:
            if received.attachment is None:
                self.nameless += 1
                return
            self.count += 1
            self._waiting = received
        self._wake()

    def put_any(self, received: Received) -> None:
        """Replace what waits, also by a message without an attachment."""
        with self._lock:
            self.count += 1
            self._waiting = received
        self._wake()

    def take(self) -> Received | None:
        """Return the newest message that was not yet taken; None if there is none."""
        with self._lock:
            taken, self._waiting = self._waiting, None
        return taken


class RosPublisher:
    """Publisher of one topic, which ROS 2 discovers by its token.

    Attributes:
        gid: identity of the publisher in its attachments.
    """

    def __init__(self, session: zenoh.Session, key: str, token: str, wall_ns: Callable[[], int]) -> None:
        self.gid = secrets.token_bytes(GID_BYTES)
        self._wall_ns = wall_ns
        self._sequence = 0
        self._publisher = session.declare_publisher(key, congestion_control=DROP, express=True)
        self._token = session.liveliness().declare_token(token)

    @property
    def matched(self) -> bool:
        """Return whether somebody subscribes to it."""
        status = self._publisher.matching_status
        return bool(getattr(status, "matching", status))  # an object, other than zenoh's types say

    def publish(self, data: bytes) -> None:
        """Send a message; it is dropped where the connection is down or full."""
        self._sequence += 1
        stamp = Attachment(self._sequence, self._wall_ns(), self.gid).pack()
        self._publisher.put(data, attachment=stamp)

    def close(self) -> None:
        """End the publisher; ROS 2 sees it vanish."""
        self._token.undeclare()  # type: ignore[no-untyped-call]  # zenoh declares no return type
        self._publisher.undeclare()  # type: ignore[no-untyped-call]


class Endpoints:
    """Publishers of a topic that are there, by their tokens."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._tokens: dict[str, Entity] = {}

    def changed(self, sample: zenoh.Sample) -> None:
        """Note that a token appeared or vanished; called by zenoh's threads."""
        token = str(sample.key_expr)
        entity = keys.read_token(token)
        with self._lock:
            if sample.kind == zenoh.SampleKind.PUT and entity is not None:
                self._tokens[token] = entity
            else:
                self._tokens.pop(token, None)

    def entities(self) -> list[Entity]:
        """Return those that are there now."""
        with self._lock:
            return list(self._tokens.values())


class RosNode(Owned):
    """Node in a zenoh session of its own. Use it as a context, or close it.

    Attributes:
        domain: domain of ROS 2.
        name: name of the node.
        session_id: identity of its session, as it stands in its tokens.
        endpoint: endpoint of the router.
    """

    def __init__(
        self,
        name: str,
        *,
        connect: str | None = None,
        listen: str | None = None,
        domain: int = 0,
        timeout_s: float = CONNECT_TIMEOUT_S,
        wall_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        """Connect to a router, or open one.

        Args:
            name: name of the node.
            connect: endpoint of a router, such as `tcp/127.0.0.1:7447`; it is connected to again whenever it was lost.
            listen: endpoint at which to open a router instead.
            domain: domain of ROS 2.
            timeout_s: seconds for which the first connection is tried.
            wall_ns: clock of attachments, nanoseconds since 1970.

        Raises:
            TransportError: an endpoint is malformed, no router answers, or the port is taken.
        """
        self.endpoint = listen or connect or ""
        split_endpoint(self.endpoint)
        self.domain, self.name = domain, name
        self._is_router = listen is not None
        self._wall_ns = wall_ns
        self._entities: list[Any] = []
        self._next_id = 1
        mode = "router" if self._is_router else "client"
        config = session_config(mode, connect=connect or (), listen=listen, connect_timeout_s=timeout_s)
        if self._is_router:  # nodes of ROS 2 are peers, which find one another by the router's gossip, as at rmw_zenohd
            config.insert_json5("scouting/gossip/enabled", "true")
        try:
            self._session = zenoh.open(config)
        except zenoh.ZError as error:
            if listen is not None:
                raise TransportError(f"cannot open a router at {listen}: {brief(error)}") from error
            raise TransportError(
                f"no zenoh router answers at {connect} within {timeout_s:g} s; start one (ros2 run rmw_zenoh_cpp "
                "rmw_zenohd, or zsdist robot SCENE --listen ENDPOINT), or check --connect"
            ) from error
        self.session_id = str(self._session.info.zid())
        token = keys.node_token(domain, self.session_id, 0, name)
        self._entities.append(self._session.liveliness().declare_token(token))

    def __enter__(self) -> "RosNode":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def connected(self) -> bool:
        """True while a router, or a peer in its place, is connected; a node that is a router itself always is."""
        info = self._session.info
        return self._is_router or bool(info.routers_zid() or info.peers_zid())

    def publisher(self, topic: str, kind: TopicType, quality: QualityOfService) -> RosPublisher:
        """Return a publisher of a topic."""
        key = keys.topic_key(self.domain, topic, kind)
        token = self._token(EntityKind.PUBLISHER, topic, kind, quality)
        made = RosPublisher(self._session, key, token, self._wall_ns)
        self._entities.append(made)
        return made

    def subscribe(self, topic: str, kind: TopicType, put: Callable[[Received], None]) -> None:
        """Subscribe to a topic, whichever hash of the type its publisher writes.

        Args:
            topic: name of the topic.
            kind: type of its messages.
            put: called with each message on zenoh's own thread: it may only put it somewhere.
        """
        self._receive(keys.any_hash_key(self.domain, topic, kind), put, zenoh.Locality.ANY)
        token = self._token(EntityKind.SUBSCRIPTION, topic, kind, NEWEST)
        self._entities.append(self._session.liveliness().declare_token(token))

    def overhear(self, topic: str, put: Callable[[Received], None]) -> None:
        """Receive what other sessions publish on a topic, of any type, without a token."""
        self._receive(keys.any_type_key(self.domain, topic), put, zenoh.Locality.REMOTE)

    def publishers_of(self, topic: str) -> Endpoints:
        """Return the publishers of a topic, kept up to date."""
        found = Endpoints()
        pattern = keys.endpoints_of(self.domain, EntityKind.PUBLISHER, topic)
        self._entities.append(
            self._session.liveliness().declare_subscriber(pattern, direct(found.changed), history=True)
        )
        return found

    def close(self) -> None:
        """End the node and its session; closing again does nothing."""
        self._entities.clear()
        if not self._session.is_closed():
            self._session.close()  # type: ignore[no-untyped-call]  # zenoh declares no return type

    def _receive(self, pattern: str, put: Callable[[Received], None], origin: zenoh.Locality) -> None:
        def arrived(sample: zenoh.Sample) -> None:
            about = None if sample.attachment is None else attachment.unpack(sample.attachment.to_bytes())
            put(Received(sample.payload.to_bytes(), about, time.monotonic()))

        self._entities.append(self._session.declare_subscriber(pattern, direct(arrived), allowed_origin=origin))

    def _token(self, kind: EntityKind, topic: str, message: TopicType, quality: QualityOfService) -> str:
        entity_id, self._next_id = self._next_id, self._next_id + 1
        return keys.endpoint_token(self.domain, self.session_id, 0, entity_id, kind, self.name, topic, message, quality)
