"""Certificates of the roles, and the permissions that the hub grants to the holder of each.

An actor's certificate is bound to its keys: it may publish only under its own name. Receivers compare the sender that a
message names with the key under which the message arrived.
"""

import re
from collections.abc import Iterable
from dataclasses import replace

from zsdist.transport.access import Grant
from zsdist.types import Level
from zsdist.wire import keys
from zsdist.wire.keys import ANY

MAX_ACTORS = 4096  # at a time, and names of actors that have rights: actor-0 to actor-4095
HUB, TRUSTED, MONITOR, REPLAY = "hub", "trusted", "monitor", "replay"  # common names; that of an actor or a learner is
# its role's name, such as `actor-0` or `learner-low`
EVERYTHING = (f"{keys.ROOT}/**",)
WATCHED = (keys.stats(ANY, ANY, ANY), keys.events(ANY))  # sources of statistics and displays
TOKENS = (keys.alive(ANY, ANY, ANY),)


def certificate_of(role: str, identifier: str) -> str:
    """Return the common name of a role's certificate.

    Each actor and each learner has one, all shards of the replay share one, and so do the scheduler and the launcher.
    """
    if role == "actor":
        return actor_name(identifier)
    if role == "learner":
        return learner_name(identifier)
    return role if role in (HUB, MONITOR, REPLAY) else TRUSTED


def learner_name(level: str) -> str:
    """Return the name of a learner on keys and on its certificate."""
    return f"learner-{level}"


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
    return [TRUSTED, MONITOR, REPLAY, *map(learner_name, Level), *map(actor_name, range(actors))]


def access_list(actors: int, certified: Iterable[str] = (), *, shards: int = 1, hubs: int = 1) -> list[Grant]:
    """Return the grants of a run; every other common name may do nothing.

    Args:
        actors: number of the run's own actors.
        certified: common names that certificates were made for; the actors among them may join the run from elsewhere.
        shards: number of shards of the replay.
        hubs: number of hubs; where there are several, each passes on what the clients of the others send.
    """
    own = list(map(actor_name, range(actors)))
    joining = sorted(set(filter(is_actor_name, certified)).difference(own), key=actor_number)
    trusted = Grant(TRUSTED, *[EVERYTHING] * 6)
    hub = Grant(HUB, publish=(keys.stats(ANY, "hub", ANY), keys.events(ANY)), alive=(keys.alive(ANY, "hub", ANY),))
    hub = replace(hub, relay=EVERYTHING) if hubs > 1 else hub
    subscribed = (*WATCHED, keys.weights(ANY, ANY))
    monitor = Grant(MONITOR, subscribe=subscribed, request=(keys.view(ANY, ANY, ANY),), watch=TOKENS)
    return [trusted, hub, monitor, _replay(shards), *map(_learner, Level), *map(_actor, own + joining)]


def _replay(shards: int) -> Grant:
    answered = [keys.control(ANY, REPLAY), *(keys.control(ANY, f"{REPLAY}-{index}") for index in range(1, shards))]
    return Grant(
        REPLAY,
        publish=(keys.ack(ANY, ANY), keys.stats(ANY, REPLAY, ANY), keys.events(ANY)),
        subscribe=(
            keys.push(ANY, ANY, ANY, ANY),
            keys.control(ANY, REPLAY),
            keys.priority(ANY, ANY),
            keys.priority(ANY, ANY, ANY),
        ),
        serve=(keys.sample(ANY, ANY), keys.sample(ANY, ANY, ANY), *answered),
        alive=(keys.alive(ANY, REPLAY, ANY),),
    )


def _learner(level: Level) -> Grant:
    published = (keys.weights(ANY, level), keys.candidate(ANY, level, ANY))
    return Grant(
        learner_name(level),
        publish=(
            *published,
            keys.priority(ANY, level),
            keys.priority(ANY, level, ANY),
            keys.stats(ANY, "learner", level),
            keys.events(ANY),
        ),
        subscribe=(keys.control(ANY, "learner"),),
        serve=(*published, keys.control(ANY, learner_name(level))),
        request=(keys.sample(ANY, level), keys.sample(ANY, level, ANY)),
        alive=(keys.alive(ANY, "learner", level),),
    )


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
        serve=(keys.view(ANY, name, ANY),),
        request=(keys.join(ANY, name),),
        alive=(keys.alive(ANY, "actor", identifier),),
        watch=(keys.alive(ANY, "scheduler", ANY),),
    )
