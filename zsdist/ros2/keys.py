"""Keys of topics and liveliness tokens of nodes, publishers and subscriptions, as rmw_zenoh writes them."""

import re
from dataclasses import dataclass
from enum import StrEnum

ADMIN = "@ros2_lv"
ROOT_NAMESPACE = "/"
DEFAULT_DEPTH = 42  # what rmw_zenoh reads where a token leaves the depth out
MOST_DOMAIN = 232
_TOPIC = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_NODE_PARTS, _ENDPOINT_PARTS = 9, 13


class EntityKind(StrEnum):
    """Kind of an entity in a token."""

    NODE = "NN"
    PUBLISHER = "MP"
    SUBSCRIPTION = "MS"
    SERVICE = "SS"
    CLIENT = "SC"


@dataclass(frozen=True)
class QualityOfService:
    """Part of ROS 2's quality of service that is not the default here: volatile, automatic, without deadlines.

    Attributes:
        depth: number of messages that are kept.
        reliable: whether lost messages are sent again.
    """

    depth: int = 10
    reliable: bool = True

    def token(self) -> str:
        """Return its part of a token; what is rmw_zenoh's default is left out."""
        reliability = "" if self.reliable else "2"
        depth = "" if self.depth == DEFAULT_DEPTH else str(self.depth)
        return f"{reliability}::,{depth}:,:,:,,"


SENSOR_DATA = QualityOfService(depth=5, reliable=False)
NEWEST = QualityOfService(depth=1, reliable=False)


@dataclass(frozen=True)
class TopicType:
    """Type of a topic's messages.

    Attributes:
        name: name such as `geometry_msgs/msg/Twist`.
        hash: hash of its definition, `RIHS01_` and 64 hexadecimal digits.
    """

    name: str
    hash: str

    @property
    def dds_name(self) -> str:
        """Name as it stands in keys, such as `geometry_msgs::msg::dds_::Twist_`."""
        package, kind, name = self.name.split("/")
        return f"{package}::{kind}::dds_::{name}_"


@dataclass(frozen=True)
class Entity:
    """Node, or endpoint of a node, as its token describes it.

    Attributes:
        domain: domain of ROS 2.
        session: identity of the zenoh session that holds the token.
        kind: kind of the entity.
        node: name of the node, with its namespace, such as `/zsdist_driver`.
        topic: name of the topic with its slash; empty for a node.
        dds_type: type as it stands in keys; empty for a node.
        hash: hash of the type; empty for a node.
    """

    domain: int
    session: str
    kind: str
    node: str
    topic: str = ""
    dds_type: str = ""
    hash: str = ""


def absolute_topic(name: str) -> str:
    """Return a topic's name with its leading slash.

    Raises:
        ValueError: it is no name of a topic.
    """
    if _TOPIC.fullmatch(name) is None:
        raise ValueError(
            f"topic is {name!r}; allowed are letters, digits and underscores, with slashes between, such as /cmd_vel"
        )
    return name if name.startswith("/") else f"/{name}"


def topic_key(domain: int, topic: str, kind: TopicType) -> str:
    """Return the key under which messages of a topic travel: `<domain>/<topic>/<type>/<hash>`."""
    return f"{domain}/{topic.strip('/')}/{kind.dds_name}/{kind.hash}"


def any_hash_key(domain: int, topic: str, kind: TopicType) -> str:
    """Return the pattern of a topic's messages of one type, whichever hash their publisher writes."""
    return f"{domain}/{topic.strip('/')}/{kind.dds_name}/*"


def any_type_key(domain: int, topic: str) -> str:
    """Return the pattern of all messages of a topic."""
    return f"{domain}/{topic.strip('/')}/*/*"


def node_token(domain: int, session: str, node_id: int, node: str, namespace: str = ROOT_NAMESPACE) -> str:
    """Return the token of a node."""
    return "/".join(
        [ADMIN, str(domain), session, str(node_id), str(node_id), EntityKind.NODE, *_names(node, namespace)]
    )


def endpoint_token(
    domain: int,
    session: str,
    node_id: int,
    entity_id: int,
    kind: EntityKind,
    node: str,
    topic: str,
    message: TopicType,
    quality: QualityOfService,
    namespace: str = ROOT_NAMESPACE,
) -> str:
    """Return the token of a publisher or a subscription."""
    return "/".join(
        [
            *(ADMIN, str(domain), session, str(node_id), str(entity_id), kind, *_names(node, namespace)),
            *(_mangled(topic), _mangled(message.dds_name), message.hash, quality.token()),
        ]
    )


def endpoints_of(domain: int, kind: EntityKind, topic: str) -> str:
    """Return the pattern of the tokens of all publishers or subscriptions of a topic."""
    return f"{ADMIN}/{domain}/*/*/*/{kind}/*/*/*/{_mangled(topic)}/**"


def read_token(token: str) -> Entity | None:
    """Return the entity that a token describes; None if it is none. Newer releases may append further parts."""
    parts = token.split("/")
    if len(parts) < _NODE_PARTS or parts[0] != ADMIN or not parts[1].isdecimal():
        return None
    domain, session, kind = int(parts[1]), parts[2], parts[5]
    namespace, node = _demangled(parts[7]), _demangled(parts[8])
    full_name = f"{namespace.rstrip('/')}/{node}"
    if kind == EntityKind.NODE:
        return Entity(domain, session, kind, full_name)
    if len(parts) < _ENDPOINT_PARTS or kind not in list(EntityKind):
        return None
    return Entity(domain, session, kind, full_name, *(_demangled(part) for part in parts[9:12]))


def _names(node: str, namespace: str) -> tuple[str, str, str]:
    enclave = ROOT_NAMESPACE
    return _mangled(enclave), _mangled(namespace), _mangled(node)


def _mangled(name: str) -> str:
    return name.replace("/", "%")


def _demangled(name: str) -> str:
    return name.replace("%", "/")
