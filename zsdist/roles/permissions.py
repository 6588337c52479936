"""Certificates of the roles, and the permissions that the hub grants to the holder of each.

An actor's certificate is bound to its keys: it may publish only under its own name. Receivers compare the sender that a
message names with the key under which the message arrived.
"""

import re
from collections.abc import Iterable

from zsdist.transport.access import Grant
from zsdist.wire import keys
from zsdist.wire.keys import ANY

MAX_ACTORS = 4096  # at a time, and names of actors that have rights: actor-0 to actor-4095
HUB, TRUSTED, MONITOR = "hub", "trusted", "monitor"  # common names; an actor's is its role's name, such as `actor-0`
EVERYTHING = (f"{keys.ROOT}/**",)
WATCHED = (keys.stats(ANY, ANY, ANY), keys.events(ANY))  # sources of statistics and displays
TOKENS = (keys.alive(ANY, ANY, ANY),)


def certificate_of(role: str, identifier: str) -> str:
    """Return the common name of a role's certificate: one for each actor, one shared by all trusted roles."""
    if role == "actor":
        return actor_name(identifier)
    return role if role in (HUB, MONITOR) else TRUSTED


def actor_name(identifier: str | int) -> str:
    """Return the name of an actor on keys, in leases and on its certificate."""
    return f"actor-{identifier}"


def is_actor_name(name: str) -> bool:
    """Return whether a name is that of an actor with rights, `actor-0` to `actor-4095`."""
    return re.fullmatch(r"actor-(0|[1-9][0-9]{0,3})", name) is not None and actor_number(name) < MAX_ACTORS


def actor_number(name: str) -> int:
    """Return the number in the name of an actor."""
    return int(name.partition("-")[2])


def client_names(actors: int) -> list[str]:
    """Return the common names of all clients of a run; the hub's own is not among them."""
    return [TRUSTED, MONITOR, *map(actor_name, range(actors))]


def access_list(actors: int, certified: Iterable[str] = ()) -> list[Grant]:
    """Return the grants of a run; every other common name may do nothing.

    Args:
        actors: number of the run's own actors.
        certified: common names that certificates were made for; the actors among them may join the run from elsewhere.
    """
    own = list(map(actor_name, range(actors)))
    joining = sorted(set(filter(is_actor_name, certified)).difference(own), key=actor_number)
    trusted = Grant(TRUSTED, *[EVERYTHING] * 6)
    hub = Grant(HUB, publish=(keys.stats(ANY, "hub", ANY), keys.events(ANY)), alive=(keys.alive(ANY, "hub", ANY),))
    monitor = Grant(MONITOR, subscribe=(*WATCHED, keys.weights(ANY, ANY)), watch=TOKENS)
    return [trusted, hub, monitor, *map(_actor, own + joining)]


def _actor(name: str) -> Grant:
    identifier = str(actor_number(name))
    return Grant(
        name,
        publish=(
            keys.push(ANY, ANY, name, ANY),
            keys.episodes(ANY, name, ANY),
            keys.evaluation(ANY, name),
            keys.stats(ANY, "actor", identifier),
        ),
        subscribe=(
            keys.ack(ANY, name),
            keys.weights(ANY, ANY),
            keys.candidate(ANY, ANY, ANY),
            keys.control(ANY, "actor"),
            keys.evaluation(ANY, name),
        ),
        request=(keys.join(ANY, name),),
        alive=(keys.alive(ANY, "actor", identifier),),
        watch=(keys.alive(ANY, "scheduler", ANY),),
    )
