"""Connection to Ray, which is started for the run on this machine or is a cluster, and the nodes of its roles."""

import logging
import os
import re
import secrets
import time
from typing import Any

import ray
from ray._private.state import available_resources_per_node
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from zsdist.common import signals
from zsdist.common.allowed_resources import allowed_cores
from zsdist.common.placement_settings import LAUNCHER, OTHERS
from zsdist.config import Config
from zsdist.errors import RunError
from zsdist.roles.replay import shards
from zsdist.run import cluster_address, local_ray, placement, ray_lean, ray_token
from zsdist.run.placement import CPU, GPU, MEMORY, Need, Node, Plan
from zsdist.run.program import RoleSpec

OBJECT_STORE_BYTES = 256 * 2**20  # it carries settings and checkpoints at the start, and nothing afterwards
STARTS_TRIED = 3  # of Ray on this machine, whose own limit of 30 s a busy machine may exceed
FREE_WITHIN_S = 5.0  # time for what an earlier run has reserved to become free
OWN_TOKEN = secrets.token_hex(32)  # of a Ray that this process starts; Ray reads its token once in a process
NODE_ID = "ray.io/node-id"  # label that Ray gives each node


class NodeAwayError(RunError):
    """Absence of the only node on which a role can live, since its files are there."""


def connect(config: Config) -> Plan:
    """Start Ray on this machine, or connect to the cluster of the configuration; `ray.shutdown` ends both.

    Ray's processes do not react to signals that ask this one to stop, and its handlers do not stay in this one.

    Returns:
        Where the roles are to live.

    Raises:
        RunError: the cluster cannot be reached or has no room for the run, or Ray cannot be started here.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # else roles that reserve no GPU cannot see one
    address = config.run.address
    what = "Ray cannot be started here" if address is None else f"Ray cluster {address!r} cannot be used"
    for tries_left in reversed(range(STARTS_TRIED)):
        try:
            # Where Ray starts no process, a signal may end a long wait.
            with signals.kept() if address is not None else signals.withheld(), ray_lean.lean():
                _init(config)
            break
        except Exception as error:  # Ray raises errors of a dozen classes, also built-in ones
            ray.shutdown()
            slow = address is None and "timed out" in str(error)
            if slow and tries_left:
                continue
            busy = f"this machine was too busy {STARTS_TRIED} times; try again later, or use --single-process: "
            raise RunError(f"{what}: {busy if slow else ''}{_summary(error)}") from error
    try:
        return Plan("", {}) if address is None else _planned(config)
    except RunError:
        ray.shutdown()
        raise


def try_start() -> None:
    """Start Ray on this machine and end it at once; raise `RunError` where it cannot be started."""
    connect(Config())
    ray.shutdown()


def survey(address: str) -> list[Node]:
    """Connect to a cluster as a run does, in a process that uses Ray for nothing else, and return its nodes.

    Raises:
        RunError: it cannot be reached, or this machine is none of its nodes.
    """
    named = cluster_address.named(address)
    try:
        ray.init(address=named, log_to_driver=False, logging_level=logging.ERROR)
        return nodes()
    except Exception as error:
        raise RunError(f"Ray cluster {address!r} cannot be used: {_summary(error)}") from error
    finally:
        ray.shutdown()


def nodes() -> list[Node]:
    """Return the nodes of the cluster that are there."""
    free = available_resources_per_node()
    return [
        Node(node["NodeID"], node["NodeName"], node["Resources"], free.get(node["NodeID"], {}), node.get("Labels", {}))
        for node in ray.nodes()
        if node["Alive"]
    ]


def here() -> str:
    """Return the identity of the node on this machine."""
    return str(ray.get_runtime_context().get_node_id())


def _init(config: Config) -> None:
    if config.run.address is not None:
        ray.init(address=cluster_address.named(config.run.address), log_to_driver=False, logging_level=logging.ERROR)
        return
    # Ray's processes inherit it. Otherwise Ray takes one from the home folder, or writes one there for all users.
    os.environ.setdefault(ray_token.TOKEN, OWN_TOKEN)
    ray.init(
        address="local",  # a cluster of its own, also where RAY_ADDRESS names another
        num_cpus=local_ray.logical_cores(config, allowed_cores()),
        object_store_memory=OBJECT_STORE_BYTES,
        include_dashboard=False,
        log_to_driver=False,
        logging_level=logging.ERROR,
        _node_ip_address="127.0.0.1",  # one machine: no other one needs to reach it
    )


def _planned(config: Config) -> Plan:
    """Return where the roles are to live on the cluster; raise `RunError` where it lacks room, now or altogether."""
    placement.plan(config, nodes(), here())
    give_up_s = time.monotonic() + FREE_WITHIN_S
    while True:
        try:
            return placement.plan(config, nodes(), here(), free=True)
        except RunError as error:
            if time.monotonic() > give_up_s:
                raise RunError(f"others use the cluster: {error}; or wait until they have ended") from error
        time.sleep(0.2)


def _summary(error: Exception) -> str:
    """Return one of Ray's errors as one line without its colours."""
    return " ".join(re.sub(r"\x1b\[[0-9;]*m", "", str(error)).split()) or type(error).__name__


class Places:
    """Nodes on which the roles of a run live, from its start to its end.

    Args:
        config: configuration of the run.
        plan: places at the start.
    """

    def __init__(self, config: Config, plan: Plan) -> None:
        self._config = config
        self._is_cluster = config.run.address is not None
        self._homes = dict(plan.nodes)
        self._here = here()
        self._offered = next((node.total.get(CPU, 0.0) for node in self._homes.values() if node.id == self._here), 0.0)

    def options(self, role_spec: RoleSpec) -> dict[str, Any]:
        """Return Ray's options for the process of a role: what it reserves, and where it may be.

        Raises:
            NodeAwayError: the only node on which it can live is not there.
        """
        if not self._is_cluster:
            return {"num_cpus": self._config.run.cpus_per_role, **self._on(self._here)}
        need = self._need(role_spec)
        reserved: dict[str, Any] = {"num_cpus": need.amounts.get(CPU, 0.0)}
        for name, option in ((GPU, "num_gpus"), (MEMORY, "memory")):
            if name in need.amounts:
                reserved[option] = need.amounts[name]
        if need.node == LAUNCHER:
            return reserved | self._on(self._here)
        if role_spec.role == "actor":
            return reserved | self._anywhere(need)
        if (home := self._homes.pop(role_spec.name, None)) is not None and role_spec.role != shards.ROLE:
            return reserved | self._on(home.id)  # as planned; a successor looks anew for a place
        present = nodes()
        if home is not None:  # of a shard, whose journal is on the disk of its first node
            self._homes[role_spec.name] = home
            back = [node for node in present if node.id == home.id or node.name == home.name]
            if not back:
                raise NodeAwayError(f"{role_spec.name} has its journal on {home.name}, which is not in the cluster")
            return reserved | self._on(max(back, key=lambda node: node.id == home.id).id)
        room = {node.id: node.free for node in present}
        chosen = placement.choose(need, [node for node in present if need.fits(node.free)], self._here, (), room)
        return reserved | (self._anywhere(need) if chosen is None else self._on(chosen.id))

    def lives_here(self, role_spec: RoleSpec) -> bool:
        """Return whether a role lives on this machine."""
        return not self._is_cluster or placement.lives_here(role_spec, self._config)

    def spare_serves(self, role_spec: RoleSpec) -> bool:
        """Return whether the standby process may take the place of a role: it is here and has reserved as much."""
        same = not self._is_cluster or self._need(role_spec) == self._need(placement.SPARE)
        return self.lives_here(role_spec) and same

    def have_room(self, role_spec: RoleSpec) -> bool:
        """Return whether a node has room for one more process of a role."""
        need = self._need(role_spec)
        return any(need.admits(node, self._here) and need.fits(node.free) for node in nodes())

    def lack(self, role_spec: RoleSpec) -> str:
        """Return in a few words what a role needs whose process does not start, and what the nodes have left."""
        if not self._is_cluster:
            return "; this machine may be busy"
        need = self._need(role_spec)
        possible = [node for node in nodes() if need.admits(node, self._here)]
        free = "; ".join(f"{node.name} has {_left(need, node)}" for node in possible[:4])
        return f"; it needs {need}; {free or 'no node of the cluster is one'}"

    def _need(self, role_spec: RoleSpec) -> Need:
        return placement.need_of(role_spec, self._config, self._offered)

    def _on(self, node: str) -> dict[str, Any]:
        return {"scheduling_strategy": NodeAffinitySchedulingStrategy(node, soft=False)}

    def _anywhere(self, need: Need) -> dict[str, Any]:
        labels = dict(need.labels) | ({NODE_ID: f"!{self._here}"} if need.node == OTHERS else {})
        return {"label_selector": labels} if labels else {}


def _left(need: Need, node: Node) -> str:
    """Return what a node has left of all that a role needs."""
    return placement.written({name: node.free.get(name, 0.0) for name in need.amounts}) + " free"
