"""Measurement of what happens to a run on a cluster when machines of it go away and others come.

`python tests/chaos/nodes.py [--results FILE]`

The cluster is of this machine alone: a head, on which the launcher and all roles but actors live, and others with a few
of Ray's cores. Their processes believe that they are on machines of their own, so the launcher cannot look at them. All
processes of such a machine are killed at the same moment, or stopped as if its cable had been cut. What is measured, in
seconds from the blow:

| figure | event |
|---|---|
| `noticed` | the run replaces its actors (`role_replaced`) |
| `free` | their episodes are free for others (`actor_left`); where another machine has room, it may not be needed |
| `back` | the first frame of each of their successors is in a journal; from the blow, or from the start of a machine |

The run goes on through all of that, merges included. At its end it is compared with the oracle of `oracle.py`, whose
faults must all be 0.
"""

import argparse
import json
import os
import secrets
import signal
import socket
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))  # else Ray writes one into the home folder

import oracle
import psutil
import small_run
from kills import Killing
from ray.cluster_utils import Cluster
from small_run import Witness, end_cleanly

from zsdist.roles import permissions
from zsdist.transport import certificates
from zsdist.transport.certificates import Identity

PORT = 7730
ACTORS = ("actor-0", "actor-1")
HEAD_CORES = 5  # hub, scheduler, replay and two learners
WITHIN_S = 120.0
MERGES = ("merge.every_episodes=40", "merge.validation_scenes=2", "merge.drop_after_scenes=2", "merge.distil_updates=2")


def address_of_this_machine() -> str | None:
    """Return the address at which others reach this machine; None: it has none."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # sends nothing
        except OSError:
            return None
        found = probe.getsockname()[0]
    return None if found.startswith("127.") else found


class Machines:
    """Cluster whose machines can be killed or stopped.

    Args:
        folder: folder of Ray.
        steps: folder in which cars count their actions.
    """

    def __init__(self, folder: Path, steps: Path) -> None:
        os.environ |= {"RAY_TMPDIR": str(folder), small_run.STEPS: str(steps)}
        os.environ["PYTHONPATH"] = os.pathsep.join([*small_run.PATHS, os.environ.get("PYTHONPATH", "")])
        self.cluster = Cluster(
            initialize_head=True, head_node_args={"num_cpus": HEAD_CORES, "include_dashboard": False}
        )
        self.nodes: dict[str, object] = {}

    def add(self, name: str, cores: int) -> None:
        """Start a machine, whose processes take its name for that of their host."""
        os.environ[small_run.MACHINE] = name
        self.nodes[name] = self.cluster.add_node(num_cpus=cores)
        del os.environ[small_run.MACHINE]

    def strike(self, name: str, number: int = signal.SIGKILL) -> list[psutil.Process]:
        """Kill or stop all processes of a machine at once, and return them."""
        tops = [psutil.Process(info[0].process.pid) for info in self.nodes[name].all_processes.values()]
        found = [process for top in tops for process in [top, *top.children(recursive=True)]]
        for process in found:
            process.send_signal(number)
        return found

    def forget(self, name: str) -> None:
        """Remove what is left of a machine."""
        self.cluster.remove_node(self.nodes.pop(name), allow_graceful=False)

    def close(self) -> None:
        """End all machines."""
        self.cluster.shutdown()


class Journey:
    """Run on a cluster whose machines go away and come back.

    Args:
        killing: run, with all that is known of it.
        machines: cluster that it runs on.
    """

    def __init__(self, killing: Killing, machines: Machines) -> None:
        self.killing, self.machines = killing, machines
        self.witness: Witness = killing.witness
        self.found: dict[str, dict[str, float]] = {}
        self.lost = 0

    def where(self, name: str) -> str:
        """Return the machine of a role."""
        return self.witness.statistics[name]["host"]

    def on(self, machine: str) -> list[str]:
        """Return the actors on a machine."""
        return [name for name in ACTORS if name in self.witness.statistics and self.where(name) == machine]

    def epochs(self) -> dict[str, int]:
        """Return the newest epoch of each actor."""
        return {name: self.witness.statistics[name]["epoch"] for name in ACTORS}

    def merges(self) -> int:
        """Return the number of merges."""
        return int(self.witness.statistics["scheduler-0"]["merges"])

    def first_frame(self, name: str, newer_than: int) -> float | None:
        """Return the time of the first frame of a newer incarnation of an actor; None: there is none yet."""
        epochs = {epoch for who, epoch in self.witness.pids if who == name and epoch > newer_than}
        return next((time_s for time_s, epoch in self.killing.tail.arrivals if epoch in epochs), None)

    def blow(self, case: str, machine: str, number: int = signal.SIGKILL) -> tuple[dict[str, int], float]:
        """Strike a machine; return the epochs of the actors that it had, and the time."""
        before = {name: epoch for name, epoch in self.epochs().items() if name in self.on(machine)}
        events, struck_s = len(self.witness.events), time.time()
        struck = self.machines.strike(machine, number)

        def replaced() -> list[float]:
            news = self.witness.events[events:]
            return [event["time_s"] for event in news if event["event"] == "role_replaced" and event["name"] in before]

        self.killing.wait_for(lambda: len(replaced()) >= len(before), f"{case}: replacements", WITHIN_S)
        self.found[case] = {"noticed": round(max(replaced()) - struck_s, 2)}
        self.lost += len(before)
        if number == signal.SIGKILL:
            self.machines.forget(machine)
        print(f"{case}: {self.found[case]}; {len(before)} actors", file=sys.stderr, flush=True)
        self.struck = struck
        return before, struck_s

    def left(self, case: str, names: list[str], since_s: float) -> None:
        """Wait until the scheduler has given up actors that have no place."""

        def gone() -> dict[str, float]:
            news = [event for event in self.witness.events if event["time_s"] > since_s]
            return {event["actor"]: event["time_s"] for event in news if event["event"] == "actor_left"}

        self.killing.wait_for(lambda: set(names) <= set(gone()), f"{case}: actors that leave", WITHIN_S)
        self.found[case]["free"] = round(max(gone().values()) - since_s, 2)

    def back(self, case: str, before: dict[str, int], since_s: float, wanted: int) -> list[str]:
        """Wait until so many actors drive again, and return their names."""

        def again() -> dict[str, float]:
            times = {name: self.first_frame(name, epoch) for name, epoch in before.items()}
            return {name: time_s for name, time_s in times.items() if time_s is not None}

        self.killing.wait_for(lambda: len(again()) >= wanted, f"{case}: {wanted} actors that are back", WITHIN_S)
        times = again()
        self.found.setdefault(case, {})["back"] = round(max(times.values()) - since_s, 2)
        print(f"{case}: {self.found[case]}", file=sys.stderr, flush=True)
        return list(times)

    def merge_meanwhile(self, case: str) -> None:
        """Require that a merge ends from here on."""
        before = self.merges()
        begun_s = time.time()
        self.killing.wait_for(lambda: self.merges() > before + 1, f"{case}: merges", WITHIN_S)
        self.found[case]["two_merges"] = round(time.time() - begun_s, 2)


def travel(root: Path, address: str) -> dict:
    """Run once through all cases, and return what happened."""
    tls = root / "tls"
    certificates.make(tls, permissions.HUB, permissions.client_names(len(ACTORS)), [address], 1)
    (root / "steps").mkdir()
    machines = Machines(root, root / "steps")
    killing = None
    try:
        machines.add("first", 2)
        machines.add("second", 2)
        settings = (
            f"run.address={machines.cluster.address}",
            f"transport.tls={tls}",
            f"transport.endpoint=tls/{address}:{PORT}",
            f"run.actors={len(ACTORS)}",
            "run.cpus_per_role=1",
            "run.standby=false",
            *MERGES,
        )
        killing = Killing(root, 0, *settings, identity=Identity.load(tls, permissions.TRUSTED))
        journey = Journey(killing, machines)
        killing.wait_for(lambda: set(ACTORS) <= set(killing.witness.statistics), "two actors", 240.0)
        killing.await_calm(standby=False)

        case, machine = "room elsewhere", journey.where("actor-0")
        before, struck_s = journey.blow(case, machine)
        journey.back(case, before, struck_s, len(before))

        case, (machine,) = "no room at all", machines.nodes
        killing.await_calm(standby=False)
        before, struck_s = journey.blow(case, machine)
        journey.left(case, list(before), struck_s)
        waits = lambda: {event["name"] for event in killing.witness.events if event["event"] == "role_waits"}  # noqa: E731
        killing.wait_for(lambda: waits() >= set(before), "news of those that wait", WITHIN_S)

        case, added_s = "a small machine comes", time.time()
        machines.add("third", 1)
        (present,) = journey.back(case, before, added_s, 1)
        (absent,) = set(before) - {present}
        journey.merge_meanwhile(case)
        assert journey.on("third") == [present]

        case, added_s = "another one comes", time.time()
        machines.add("fourth", 1)
        journey.back(case, {absent: before[absent]}, added_s, 1)

        case = "cut off"
        killing.await_calm(standby=False)
        machine = journey.where("actor-0")
        before, struck_s = journey.blow(case, machine, signal.SIGSTOP)
        journey.left(case, list(before), struck_s)
        journey.merge_meanwhile(case)
        machines.add("fifth", 1)
        journey.back(case, before, struck_s, 1)
        for process in journey.struck:  # it wakes, and does no harm
            if process.is_running():
                process.send_signal(signal.SIGCONT)
        found = killing.finish()
        assert found["restarts"] == {"actor": journey.lost}, f"{found['restarts']}, and {journey.lost} actors were lost"
        return found | {"cases": journey.found}
    finally:
        if killing is not None:
            killing.abandon()
        machines.close()


def main() -> None:
    """Run, add the result to a file, and print it; say so where this machine cannot do it."""
    end_cleanly()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path, default=Path("runs/nodes.jsonl"), help="appended to")
    options = parser.parse_args()
    options.results.parent.mkdir(parents=True, exist_ok=True)
    if (address := address_of_this_machine()) is None:
        print("skipped: a run on a cluster needs an address other than loopback, and this machine has none")
        return
    with tempfile.TemporaryDirectory(prefix="nodes-") as root:
        row = travel(Path(root), address)
    with options.results.open("a") as file:
        file.write(json.dumps(row) + "\n")
    print(json.dumps(row))
    sys.exit(any(row[name] for name in oracle.FAULTS))


if __name__ == "__main__":
    main()
