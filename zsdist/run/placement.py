"""Places of a run's roles on a cluster, as decisions without Ray: what each needs, where is room, what is lacking.

Ray queues without a word what has no room, so all roles are placed on paper before anything starts. Roles that a run
cannot do without get a node; actors are counted, and Ray distributes them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from zsdist.common.placement_settings import ANY, LAUNCHER, OTHERS, RolePlace, labels_of
from zsdist.config import Config
from zsdist.errors import RunError
from zsdist.roles.replay import shards
from zsdist.run import program
from zsdist.run.program import RoleSpec

CPU, GPU, MEMORY = "CPU", "GPU", "memory"  # Ray's names of what a node has
SPARE = RoleSpec("spare", "0", 0)  # the standby process, which stays beside the hub
EXACT = 1e-4  # Ray counts in parts of this size
RAYS_OWN = "ray.io/node-id"  # label that each node has another value of


@dataclass(frozen=True)
class Node:
    """Node of a cluster.

    Attributes:
        id: identity, which a node that comes back does not have again.
        name: its address, by which people know it and which it has again.
        total: amounts that it offers, by Ray's names `CPU`, `GPU` and `memory` (bytes).
        free: the part of them that nobody has reserved.
        labels: its labels by name.
    """

    id: str
    name: str
    total: Mapping[str, float]
    free: Mapping[str, float]
    labels: Mapping[str, str]


@dataclass(frozen=True)
class Need:
    """Requirements of a role's process on a node.

    Attributes:
        node: `launcher`, `others` or `any`.
        labels: labels that the node must have.
        amounts: what it reserves there, by Ray's names; nothing is listed with 0.
    """

    node: str
    labels: Mapping[str, str]
    amounts: Mapping[str, float]

    def admits(self, node: Node, here: str) -> bool:
        """Return whether a node may be the place, whatever its room; `here` is the launching machine."""
        if self.node != ANY and (node.id == here) != (self.node == LAUNCHER):
            return False
        return self.labels.items() <= node.labels.items()

    def fits(self, room: Mapping[str, float]) -> bool:
        """Return whether there is enough of everything."""
        return all(room.get(name, 0.0) + EXACT >= amount for name, amount in self.amounts.items())

    def __str__(self) -> str:
        where = {LAUNCHER: "this machine", OTHERS: "another machine", ANY: "any machine"}[self.node]
        labels = ",".join(f"{name}={value}" for name, value in self.labels.items())
        return f"{written(self.amounts)} on {where}{f' with labels {labels}' if labels else ''}"


def place_of(role_spec: RoleSpec, config: Config) -> RolePlace:
    """Return the setting of where a role lives."""
    if role_spec.role == "hub" and role_spec.id != "0":
        labels = config.cluster.hubs[int(role_spec.id) - 1].partition("@")[2]
        return RolePlace(node="any", labels=labels)
    settings = {"learner": config.cluster.learner, shards.ROLE: config.cluster.replay, "actor": config.cluster.actor}
    return settings.get(role_spec.role, RolePlace())


def need_of(role_spec: RoleSpec, config: Config, offered: float) -> Need:
    """Return what the process of a role needs on a cluster.

    Args:
        role_spec: the role.
        config: configuration of the run.
        offered: cores of Ray that the launching machine offers. Where there are none, the roles that cannot live
            elsewhere reserve none: such a head is to be spared by the others.
    """
    place = place_of(role_spec, config)
    cpus = config.run.cpus_per_role if place.cpus is None else place.cpus
    if is_bound(role_spec) and not offered:
        cpus = 0.0
    amounts = {CPU: cpus, GPU: place.gpus, MEMORY: float(place.memory_bytes)}
    return Need(place.node, labels_of(place.labels), {name: amount for name, amount in amounts.items() if amount})


def is_bound(role_spec: RoleSpec) -> bool:
    """Return whether a role can live on the launching machine only: it has its address or the run directory."""
    return role_spec.name in ("hub-0", "scheduler-0", SPARE.name)


def lives_here(role_spec: RoleSpec, config: Config) -> bool:
    """Return whether the settings place a role on the launching machine."""
    return place_of(role_spec, config).node == LAUNCHER


@dataclass(frozen=True)
class Plan:
    """Places of the roles that a run cannot do without.

    Attributes:
        here: identity of the launching machine.
        nodes: node of each role, by the role's name.
    """

    here: str
    nodes: Mapping[str, Node]


def plan(config: Config, nodes: Sequence[Node], here: str, *, free: bool = False) -> Plan:
    """Return where the roles of a run are to live, except its actors.

    Args:
        config: configuration of the run.
        nodes: nodes of the cluster.
        here: identity of the launching machine.
        free: reckon with what is free now and without the actors, which may wait; else with all that the nodes have.

    Raises:
        RunError: the cluster lacks something; the error says for which roles, and what.
    """
    room = {node.id: dict(node.free if free else node.total) for node in nodes}
    offered = next((node.total.get(CPU, 0.0) for node in nodes if node.id == here), 0.0)
    placed: dict[str, Node] = {}
    homeless: list[RoleSpec] = []
    roles = [*needed(config), *([SPARE] if config.run.standby else [])]
    for role_spec in sorted(roles, key=lambda role_spec: _choice(need_of(role_spec, config, offered))):
        need = need_of(role_spec, config, offered)
        node = choose(need, [node for node in nodes if need.fits(room[node.id])], here, list(placed.values()), room)
        if node is None:
            homeless.append(role_spec)
            continue
        placed[role_spec.name] = node
        _take(room[node.id], need)
    problems = _why(homeless, config, nodes, here, offered, free=free)
    if not free and not homeless:
        problems += _actors_without_room(config, nodes, here, room, offered)
    if problems:
        raise RunError("; ".join(problems))
    return Plan(here, placed)


def needed(config: Config) -> list[RoleSpec]:
    """Return the roles without which a run does nothing: all but the actors."""
    roles = program.roles(config, range(program.role_count(config)))
    hubs = [RoleSpec("hub", str(index), 0) for index in range(1 + len(config.cluster.hubs))]
    return [*hubs, *(role_spec for role_spec in roles if role_spec.role != "actor")]


def choose(
    need: Need, nodes: Sequence[Node], here: str, taken: Sequence[Node], room: Mapping[str, Mapping[str, float]]
) -> Node | None:
    """Return the best of some nodes for a role: where the run's others are not, then where most memory is left.

    Args:
        need: what the role needs.
        nodes: nodes that have room for it.
        here: identity of the launching machine.
        taken: nodes of roles that have been placed, each as often as it was chosen.
        room: what is left on each node.
    """
    fitting = [node for node in nodes if need.admits(node, here)]
    counts = {node.id: sum(other.id == node.id for other in taken) for node in fitting}
    return min(fitting, key=lambda node: (counts[node.id], -room[node.id].get(MEMORY, 0.0)), default=None)


def written(amounts: Mapping[str, float]) -> str:
    """Return amounts as a phrase, such as `1 core and 0.5 GPUs`."""
    texts = []
    for name, one, many in ((CPU, "core of Ray", "cores of Ray"), (GPU, "GPU", "GPUs")):
        if name in amounts:
            texts.append(f"{amounts[name]:g} {one if amounts[name] == 1 else many}")
    if MEMORY in amounts:
        texts.append(f"{amounts[MEMORY] / 2**20:.0f} MiB of memory")
    return " and ".join(texts) or "nothing"


def _choice(need: Need) -> tuple[int, float]:
    """Return a rank by which those are placed first that have the least choice, and of these the largest."""
    return (0 if need.node == LAUNCHER else 1 if need.labels else 2), -sum(need.amounts.values())


def _take(room: dict[str, float], need: Need) -> None:
    for name, amount in need.amounts.items():
        room[name] = room.get(name, 0.0) - amount


def _why(
    homeless: Sequence[RoleSpec], config: Config, nodes: Sequence[Node], here: str, offered: float, *, free: bool
) -> list[str]:
    """Return lines that say why some roles have no place."""
    lines = []
    at_home = [role_spec for role_spec in homeless if place_of(role_spec, config).node == LAUNCHER]
    if at_home:
        lines.append(_lacking_here(config, nodes, here, offered, free=free))
    for role_spec in homeless:
        need = need_of(role_spec, config, offered)
        if role_spec in at_home:
            continue
        fitting = [node for node in nodes if need.admits(node, here)]
        found = "; ".join(f"{node.name}: {written(node.free if free else node.total)}" for node in fitting[:4])
        found = f"of the {len(fitting)} possible nodes none has as much left beside the other roles ({found})"
        if not fitting:
            labels = {f"{name}={value}" for node in nodes for name, value in node.labels.items()}
            shown = ", ".join(sorted(label for label in labels if not label.startswith(RAYS_OWN))[:8])
            others = f"of {len(nodes)} nodes none is one; their labels are {shown or 'none'}"
            found = others if need.labels else "the cluster has no node but this one"
        lines.append(f"{role_spec.name} has no place: it needs {need}; {found}; see cluster.{_setting(role_spec)}")
    return lines


def _lacking_here(config: Config, nodes: Sequence[Node], here: str, offered: float, *, free: bool) -> str:
    """Return a line about the roles that are to live on this machine and have no room there."""
    this = next(node for node in nodes if node.id == here)
    staying = [role for role in needed(config) if lives_here(role, config)]
    staying += [SPARE] if config.run.standby else []
    free_to_move = sorted({role.role for role in staying if not is_bound(role)})
    send = " and ".join(f"cluster.{role}.node=others" for role in free_to_move)
    names = ", ".join(role.name for role in staying if not (is_bound(role) and not offered))
    if not offered:
        return (
            f"this machine, {this.name}, offers Ray no cores, and {names} are to live on it; set {send} "
            "(deploy/README.md), or give it cores (ray start --num-cpus)"
        )
    wanted: dict[str, float] = {}
    for role in staying:
        for name, amount in need_of(role, config, offered).amounts.items():
            wanted[name] = wanted.get(name, 0.0) + amount
    has = written({name: (this.free if free else this.total).get(name, 0.0) for name in wanted})
    return (
        f"the roles that live on this machine ask for {written(wanted)} ({names}), {this.name} has {has}"
        f"{' free' if free else ''}; lower run.cpus_per_role, give it more (ray start --num-cpus)"
        f"{f', or set {send}' if send else ''}"
    )


def _actors_without_room(
    config: Config, nodes: Sequence[Node], here: str, room: Mapping[str, Mapping[str, float]], offered: float
) -> list[str]:
    """Return a line where the nodes have no room for all actors beside the other roles."""
    need = need_of(RoleSpec("actor", "0", 0), config, offered)
    fitting, actors = [node for node in nodes if need.admits(node, here)], config.run.actors

    def fit(left: Mapping[str, float]) -> int:
        """Return how many actors fit into what is left of a node."""
        counts = (int((left.get(name, 0.0) + EXACT) / amount) for name, amount in need.amounts.items())
        return max(0, min(counts, default=actors))

    places = [fit(room[node.id]) for node in fitting]
    if sum(places) >= actors:
        return []
    everything = need_of(SPARE, config, offered).amounts.get(CPU, 0.0) if config.run.standby else 0.0
    everything += actors * need.amounts.get(CPU, 0.0)
    everything += sum(need_of(role, config, offered).amounts.get(CPU, 0.0) for role in needed(config))
    cores = sum(node.total.get(CPU, 0.0) for node in nodes)
    return [
        f"the run asks for {everything:g} cores of Ray, the cluster has {cores:g} on {len(nodes)} nodes, with room for "
        f"{sum(places)} of {actors} actors that need {need} each; lower run.cpus_per_role or run.actors, or add nodes"
    ]


def _setting(role_spec: RoleSpec) -> str:
    """Return the name of the setting that decides where a role lives."""
    return "hubs" if role_spec.role == "hub" else role_spec.role
