"""Measurement of a run across hosts, which are network namespaces of this machine, against one on a single machine.

`python tests/chaos/hosts.py [--cases WORD ...] [--seconds 60] [--cuts 20] [--results FILE]`, as root

| case | what |
|---|---|
| alone | the run on this machine, by loopback, without certificates |
| hosts | Ray's head, the hub and all roles but the actors on one host, two actors on two others; token and TLS |
| delay | the same, 10 ms each way between the actors and the head |
| loss | the same, 1% of the frames lost |
| narrow | the same, 10 Mbit/s to each host with an actor |
| cuts | one of these hosts is cut off for 30 s, again and again |

Only the cars are kinematic. Rates are actions that the cars have counted themselves. At the end of each run the counts
of `tests/chaos/oracle.py` must show no fault. A finished case adds a line of JSON to FILE, and is not run again.
"""

import argparse
import contextlib
import json
import os
import secrets
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import oracle
from oracle import Tail
from small_run import HERE, Launcher, Witness, actions, end_cleanly, wait_for

from zsdist.roles import permissions
from zsdist.transport import certificates
from zsdist.transport.certificates import Identity

sys.path.insert(0, str(HERE.parent))

from network_hosts import Network, RayHosts, missing
from ray_machines import environment

HEAD, ACTORS = "head", ("one", "two")
CORES = {HEAD: 8, **dict.fromkeys(ACTORS, 1)}
PATIENT = {"RAY_health_check_failure_threshold": "20"}  # as docs/cluster.md has it
START_WITHIN_S = 300.0
CUT_S, BACK_WITHIN_S, CALM_S = 30.0, 60.0, 10.0
LINKS: dict[str, Callable[[Network, str], None]] = {
    "hosts": lambda network, name: None,
    "delay": lambda network, name: network.delay(name, 0.01),
    "loss": lambda network, name: network.delay(name, 0.0, lost=0.01),
    "narrow": lambda network, name: network.limit(name, 10e6),
    "cuts": lambda network, name: None,
}


class HostsRun:
    """Run of kinematic cars, alone on this machine or across hosts, with all that is known of it.

    Args:
        root: folder for the run, with a short name.
        hosts: network and cluster; None: the run is on this machine.
        settings: settings of the run.
    """

    def __init__(self, root: Path, hosts: tuple[Network, RayHosts] | None, *settings: str) -> None:
        settings, identity, command = ("run.actors=2", "run.standby=false", *settings), None, None
        if hosts is not None:
            network, cluster = hosts
            tls = root / "tls"
            certificates.make(tls, permissions.HUB, permissions.client_names(4), [network.address(HEAD)], 1)
            identity = Identity.load(tls, permissions.TRUSTED)
            settings += (f"run.address={cluster.address}", f"transport.tls={tls}", "cluster.actor.node=others")
            settings += (f"transport.endpoint=tls/{network.address(HEAD)}:7447", "run.cpus_per_role=1")
            command = network.command(HEAD, [sys.executable, str(HERE / "launcher.py"), str(root / "run"), *settings])
        self.launcher = Launcher(root, *settings, command=command)
        self.tail, self.witness = Tail(self.launcher.folder), Witness(self.launcher, identity)

    def until(self, condition: Callable[[], bool], what: str, patience_s: float = START_WITHIN_S) -> float:
        """Wait until a condition holds; return the seconds that it took."""
        return wait_for(condition, patience_s, what, self._poll)

    def rest(self, seconds: float) -> None:
        """Let time pass."""
        end_s = time.time() + seconds
        self.until(lambda: time.time() > end_s, "the end of a pause", seconds + 60.0)

    def await_flow(self, names: tuple[str, ...] = ("actor-0", "actor-1")) -> None:
        """Wait until frames of some actors arrive."""
        before = len(self.tail.arrivals)
        self.until(lambda: all(self.frames(name, before) > 2 for name in names), f"frames of {names}")

    def frames(self, name: str, since: int) -> int:
        """Return the number of frames of the newest known incarnation of an actor, from frame `since` on."""
        newest = self.witness.statistics.get(name, {}).get("epoch")
        return sum(epoch == newest for _, epoch in self.tail.arrivals[since:])

    def at(self, host: str) -> str:
        """Return the name of the actor on a host."""
        (found,) = [name for name in self.witness.name_of("actor") if self.witness.statistics[name]["host"] == host]
        return found

    def driven(self, name: str | None = None) -> int:
        """Return the number of actions of an actor's cars so far, or of all cars."""
        pids = [pid for (who, _), pid in self.witness.pids.items() if name in (who, None)]
        return sum(actions(self.launcher.root / "steps", pid) for pid in pids)

    def weight_version(self) -> int:
        """Return the version of the low level's weights with which the first actor acts."""
        return self.witness.statistics["actor-0"].get("low_weight_version", 0)

    def rate(self, seconds: float) -> float:
        """Return the actions a second over some time."""
        before, start_s = self.driven(), time.time()
        self.rest(seconds)
        return (self.driven() - before) / (time.time() - start_s)

    def finish(self) -> dict:
        """Interrupt the run, and return all counts."""
        status = self.launcher.stop()
        assert status == 130, f"exit status {status}: {self.launcher.last_words()}"
        self.tail.close()
        self.witness.close()
        return oracle.verdict(
            self.launcher, self.tail, self.witness, json.loads((self.launcher.folder / "summary.json").read_text())
        )

    def abandon(self) -> None:
        """Kill what is left of the run on the launcher's machine."""
        self.witness.close()
        self.launcher.kill(alone=False)

    def _poll(self) -> None:
        self.witness.poll()
        self.launcher.require_running()


@contextlib.contextmanager
def opened(root: Path, *more: str) -> Iterator[tuple[Network, RayHosts]]:
    """Yield a network of hosts with a Ray cluster on them; `more` are hosts outside the cluster."""
    os.environ.update(environment(root, secrets.token_hex(32)) | PATIENT)
    network = Network([*CORES, *more])
    try:
        cluster = RayHosts(network, CORES, root / "ray", os.environ)
        for name in ACTORS:
            cluster.start(name)
        yield network, cluster
    finally:
        network.close()


def measure(case: str, seconds: float, cuts: int) -> dict:
    """Run one case, and return its figures."""
    with tempfile.TemporaryDirectory(prefix="zh-", dir="/tmp") as folder, contextlib.ExitStack() as held:
        root = Path(folder)
        hosts = None if case == "alone" else held.enter_context(opened(root))
        run = HostsRun(root, hosts)
        held.callback(run.abandon)
        run.await_flow()
        found: dict = {"case": case}
        if hosts is not None:
            for name in ACTORS:
                LINKS[case](hosts[0], name)
            run.await_flow()
        if hosts is not None and case == "cuts":
            found |= cut_again_and_again(run, hosts[0], cuts)
        else:
            before = run.weight_version()
            found["env_steps_per_s"] = round(run.rate(seconds), 1)
            found["new_weights"] = run.weight_version() - before
        return found | run.finish()


def cut_again_and_again(run: HostsRun, network: Network, cuts: int) -> dict:
    """Cut one host off so many times; return when its actor was back, and how the other one went on meanwhile."""
    back_s, shares = [], []
    for _ in range(cuts):
        lost, stays = run.at(ACTORS[0]), run.at(ACTORS[1])
        run.await_flow()
        before, start_s = run.driven(stays), time.time()
        run.rest(CALM_S)
        calm = (run.driven(stays) - before) / (time.time() - start_s)
        network.cut(ACTORS[0])
        before, start_s = run.driven(stays), time.time()
        run.rest(CUT_S)
        shares.append(round((run.driven(stays) - before) / (time.time() - start_s) / calm, 3))
        network.mend(ACTORS[0])
        since = len(run.tail.arrivals)
        took_s = run.until(lambda name=lost, since=since: run.frames(name, since) > 0, f"{lost} is back", BACK_WITHIN_S)
        back_s.append(round(took_s, 2))
        print(f"back after {took_s:.2f} s; the other one at {shares[-1]:.2f}", file=sys.stderr, flush=True)
    return {"back_s": back_s, "others_share": shares, "back_median_s": statistics.median(back_s)}


def main() -> None:
    """Run the cases that have no line yet, and print all lines."""
    end_cleanly()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", nargs="+", choices=("alone", *LINKS), default=["alone", *LINKS])
    parser.add_argument("--seconds", type=float, default=60.0, help="for which a rate is measured")
    parser.add_argument("--cuts", type=int, default=20)
    parser.add_argument("--results", type=Path, default=Path("runs/hosts.jsonl"), help="appended to")
    options = parser.parse_args()
    if reason := missing():
        sys.exit(f"hosts.py: {reason}")
    options.results.parent.mkdir(parents=True, exist_ok=True)
    lines = options.results.read_text().splitlines() if options.results.exists() else []
    rows = {row["case"]: row for row in map(json.loads, lines)}
    for case in options.cases:
        if case not in rows:
            rows[case] = measure(case, options.seconds, options.cuts)
            with options.results.open("a") as file:
                file.write(json.dumps(rows[case]) + "\n")
        print(json.dumps(rows[case]), flush=True)
    sys.exit(any(row[name] for row in rows.values() for name in oracle.FAULTS))


if __name__ == "__main__":
    main()
