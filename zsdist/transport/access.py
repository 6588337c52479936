"""Access control of a hub with certificates, in terms of `Transport`; everything that no grant allows is refused."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

EVERY_MESSAGE = (
    "put",
    "declare_subscriber",
    "query",
    "declare_queryable",
    "reply",
    "liveliness_token",
    "declare_liveliness_subscriber",
    "liveliness_query",
)
RETAINED = "@retained/"  # prefix of the tokens of keys with a retained value; `**` does not match it


@dataclass(frozen=True)
class Grant:
    """Rights of the holder of one certificate, as patterns of keys.

    A pattern in use must lie within a granted one; a pattern that reaches beyond it is refused as a whole.

    Attributes:
        name: common name of the certificate.
        publish: keys under which the holder may publish, without retained values.
        subscribe: keys to which the holder may subscribe, including retained values.
        serve: keys under which the holder may answer requests and keep retained values.
        request: keys under which the holder may send requests.
        alive: liveliness tokens that the holder may hold.
        watch: liveliness tokens that the holder may watch.
        relay: keys under which the holder, another hub, may pass on anything in both directions.
    """

    name: str
    publish: tuple[str, ...] = ()
    subscribe: tuple[str, ...] = ()
    serve: tuple[str, ...] = ()
    request: tuple[str, ...] = ()
    alive: tuple[str, ...] = ()
    watch: tuple[str, ...] = ()
    relay: tuple[str, ...] = ()


def settings(grants: Iterable[Grant]) -> dict[str, Any]:
    """Return zenoh's setting `access_control` for a hub: deny by default, a subject and a policy for each grant."""
    rules: list[dict[str, Any]] = []
    policies, subjects = [], []
    for grant in grants:
        granted = list(_rules(grant))
        rules += granted
        subjects.append({"id": grant.name, "cert_common_names": [grant.name]})
        policies.append({"rules": [rule["id"] for rule in granted], "subjects": [grant.name]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _rules(grant: Grant) -> Iterable[dict[str, Any]]:
    """Yield zenoh's rules of a grant; `ingress` is from the holder to the hub, `egress` from the hub to the holder."""
    subscribed, kept = (tuple(RETAINED + key for key in keys) for keys in (grant.subscribe, grant.serve))
    if grant.relay:
        yield {
            "id": f"{grant.name} relay",
            "permission": "allow",
            "flows": ["ingress", "egress"],  # hubs tell each other of subscribers, which clients are never told of
            "messages": list(EVERY_MESSAGE),
            "key_exprs": [*grant.relay, *(RETAINED + key for key in grant.relay)],
        }
    for flow, messages, keys in (
        ("ingress", ("put",), grant.publish),
        ("ingress", ("declare_subscriber",), grant.subscribe),
        ("egress", ("put",), grant.subscribe),
        ("ingress", ("query",), grant.request + grant.subscribe),
        ("egress", ("reply",), grant.request + grant.subscribe),
        ("ingress", ("declare_queryable", "reply"), grant.serve),
        ("egress", ("query",), grant.serve),
        ("ingress", ("liveliness_token",), grant.alive + kept),
        ("ingress", ("declare_liveliness_subscriber", "liveliness_query"), grant.watch + subscribed),
        ("egress", ("liveliness_token",), grant.watch + subscribed),
    ):
        if keys:
            yield {
                "id": f"{grant.name} {flow} {' '.join(messages)}",
                "permission": "allow",
                "flows": [flow],
                "messages": list(messages),
                "key_exprs": list(keys),
            }
