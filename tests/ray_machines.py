"""A Ray cluster of several nodes on this machine, in a process of its own: `python tests/ray_machines.py NODES`.

NODES is JSON: arguments of `ray.cluster_utils.Cluster.add_node` by the names of the nodes, the head first. Processes of
a node, the head's apart, take its name for that of their host. The cluster asks for the token in RAY_AUTH_TOKEN. Its
address is printed once all nodes are there. A line with a name on standard input kills all processes of that node. At
the end of the input all are ended.
"""

import json
import os
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

HERE = Path(__file__).parent
CHAOS = HERE / "chaos"
PATHS = (CHAOS, HERE, HERE.parent)  # in which all processes find modules
MACHINE = "ZSDIST_CHAOS_MACHINE"  # as in tests/chaos/small_run.py
START_WITHIN_S = 90.0


def environment(folder: Path, token: str) -> dict[str, str]:
    """Return the environment of the cluster, and of what knows its token."""
    paths = os.pathsep.join([*map(str, PATHS), os.environ.get("PYTHONPATH", "")])
    own = {"RAY_TMPDIR": str(folder), "RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": token, "PYTHONPATH": paths}
    kept = {name: value for name, value in os.environ.items() if not name.startswith("RAY_")}
    # A busy machine takes longer than Ray's own 30 s, and starves workers that are nice to all others.
    patient = {"RAY_raylet_start_wait_time_s": "300", "RAY_worker_niceness": "0"}
    return kept | own | patient | {"RAY_USAGE_STATS_ENABLED": "0", "OMP_NUM_THREADS": "1"}


class Machines:
    """Cluster as others see it.

    Attributes:
        address: address of its head.
    """

    def __init__(self, process: subprocess.Popen, address: str) -> None:
        self.address = address
        self._process = process

    def kill(self, name: str) -> None:
        """Kill all processes of a node at once."""
        self._process.stdin.write(f"{name}\n")
        self._process.stdin.flush()
        assert self._process.stdout.readline() == f"{name} is gone\n"


@contextmanager
def machines(folder: Path, token: str, nodes: dict[str, dict]):
    """Yield a cluster; `None` where it cannot start."""
    process = subprocess.Popen(
        [sys.executable, __file__, json.dumps(nodes)],
        env=environment(folder, token),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=(folder / "machines.log").open("wb"),
        text=True,
        start_new_session=True,
    )
    try:
        first = process.stdout.readline()
        yield Machines(process, first.split()[1]) if first.startswith("ready ") else None
    finally:
        process.stdin.close()
        process.wait(START_WITHIN_S)


def main() -> None:
    """Start the cluster, and kill the nodes that are named."""
    import psutil
    from ray.cluster_utils import Cluster

    cluster, nodes = None, {}
    try:
        for name, arguments in json.loads(sys.argv[1]).items():
            if cluster is None:
                head = {"include_dashboard": False, "node_name": name, **arguments}
                cluster = Cluster(initialize_head=True, head_node_args=head)
            else:
                os.environ[MACHINE] = name
                nodes[name] = cluster.add_node(node_name=name, wait=False, **arguments)
        cluster.wait_for_nodes(START_WITHIN_S)
        print(f"ready {cluster.address}", flush=True)
        for line in sys.stdin:
            name = line.strip()
            tops = [psutil.Process(info[0].process.pid) for info in nodes[name].all_processes.values()]
            for process in [process for top in tops for process in [*top.children(recursive=True), top]]:
                process.kill()
            cluster.remove_node(nodes.pop(name), allow_graceful=False)
            print(f"{name} is gone", flush=True)
    finally:
        if cluster is not None:
            cluster.shutdown()


if __name__ == "__main__":
    main()
