"""Who may do what at a hub that asks for certificates, in the words of `Transport`; what no grant names is refused."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

RETAINED = "@retained/"  # prefix of the tokens of keys with a retained value; no `**` of anybody's covers it


@dataclass(frozen=True)
class Grant:
    """What the holder of one certificate may do, as patterns of keys.

    A pattern that is used must lie within one that is granted; one that reaches beyond is refused wholly.

    Attributes:
        name: common name of the certificate.
        publish: keys it may publish under, without retained values.
        subscribe: keys it may hear, retained values included.
        serve: keys under which it may answer requests and keep retained values.
        request: keys under which it may ask.
        alive: tokens it may hold.
        watch: tokens it may see.
    """

    name: str
    publish: tuple[str, ...] = ()
    subscribe: tuple[str, ...] = ()
    serve: tuple[str, ...] = ()
    request: tuple[str, ...] = ()
    alive: tuple[str, ...] = ()
    watch: tuple[str, ...] = ()


def settings(grants: Iterable[Grant]) -> dict[str, Any]:
    """Zenoh's `access_control` for a hub: default deny, one subject and one policy for each grant."""
    rules, policies, subjects = [], [], []
    for grant in grants:
        mine = list(_rules(grant))
        rules += mine
        subjects.append({"id": grant.name, "cert_common_names": [grant.name]})
        policies.append({"rules": [rule["id"] for rule in mine], "subjects": [grant.name]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _rules(grant: Grant) -> Iterable[dict[str, Any]]:
    """A grant as zenoh's rules; `ingress` is what the hub hears from the holder, `egress` what it passes on to it."""
    heard, kept = (tuple(RETAINED + key for key in keys) for keys in (grant.subscribe, grant.serve))
    for flow, messages, keys in (
        ("ingress", ("put",), grant.publish),
        ("ingress", ("declare_subscriber",), grant.subscribe),
        ("egress", ("put",), grant.subscribe),
        ("ingress", ("query",), grant.request + grant.subscribe),
        ("egress", ("reply",), grant.request + grant.subscribe),
        ("ingress", ("declare_queryable", "reply"), grant.serve),
        ("egress", ("query",), grant.serve),
        ("ingress", ("liveliness_token",), grant.alive + kept),
        ("ingress", ("declare_liveliness_subscriber", "liveliness_query"), grant.watch + heard),
        ("egress", ("liveliness_token",), grant.watch + heard),
    ):
        if keys:
            yield {
                "id": f"{grant.name} {flow} {' '.join(messages)}",
                "permission": "allow",
                "flows": [flow],
                "messages": list(messages),
                "key_exprs": list(keys),
            }
