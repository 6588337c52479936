"""Cores, GPUs and labels of the shipped files: each has what its run asks for, by the launcher's own check."""

import re

import pytest
import yaml
from deployments import DEPLOY, ROOT, SIZES, groups, launched, memory_bytes, of_kind, rendered

from zsdist.config import Config
from zsdist.errors import RunError
from zsdist.run import placement

HEAD = "head"


def node(name: str, cores: float, gpus: float = 0.0, labels: dict[str, str] | None = None) -> placement.Node:
    amounts = {placement.CPU: cores, placement.GPU: gpus, placement.MEMORY: 2.0**34}
    return placement.Node(name, name, amounts, amounts, labels or {})


def started(options: str, name: str) -> placement.Node:
    """Return the node that the options of `ray start` make."""
    labels = dict(label.split("=") for label in re.findall(r"--labels=(\S+)", options))
    return node(name, float(re.search(r"--num-cpus=(\d+)", options).group(1)), labels=labels)


def of_kubernetes(size: str) -> tuple[Config, list[placement.Node]]:
    (job,) = of_kind(rendered(size), "RayJob")
    nodes = []
    for group in groups(size):
        params, name = group["rayStartParams"], group.get("groupName", HEAD)
        for number in range(group.get("replicas", 1)):
            one = node(name, float(params["num-cpus"]), float(params.get("num-gpus", 0)), group.get("labels"))
            nodes.append(
                one if name == HEAD else placement.Node(f"{name}-{number}", name, one.total, one.free, one.labels)
            )
    return launched(job["spec"]["entrypoint"]), nodes


def of_compose() -> tuple[Config, list[placement.Node]]:
    services = yaml.safe_load((DEPLOY / "compose.yaml").read_text())["services"]
    head = services[HEAD]["command"][-1]
    workers = {name: str(service.get("command")) for name, service in services.items() if name != HEAD}
    nodes = [started(command, name) for name, command in workers.items() if command.startswith("ray start")]
    return launched(head[head.index("exec python") :]), [started(head, HEAD), *nodes]


def of_machines() -> tuple[Config, list[placement.Node]]:
    """Return what `ray up` starts, and the run of the page that explains it."""
    file = yaml.safe_load((DEPLOY / "ray-cluster.yaml").read_text())
    (command,) = re.findall(
        r"python -m zsdist.launch .*--address auto(?:.*\\\n)*.*", (ROOT / "docs" / "cluster.md").read_text()
    )
    workers = [file["worker_start_ray_commands"][-1]] * len(file["provider"]["worker_ips"])
    nodes = [started(options, f"worker-{number}") for number, options in enumerate(workers)]
    return launched(command.replace("$HUB", "tls/10.0.0.10:7447")), [
        started(file["head_start_ray_commands"][-1], HEAD),
        *nodes,
    ]


def of_slurm(machines: int, cores: int) -> tuple[Config, list[placement.Node]]:
    """Return what the batch script starts on so many machines of so many cores."""
    script = (DEPLOY / "slurm.sbatch").read_text()
    (others,) = re.findall(r"actors=\$\(\(cores - (\d+)\)\)", script)
    actors = machines * cores - int(others)
    command = re.search(r"python -m zsdist.launch (?:.*\\\n)*.*", script).group(0).partition(' "$@"')[0]
    command = command.replace("$actors", str(actors)).replace("$hub", "tls/10.0.0.1:7447").replace('"', "")
    return launched(command), [node(HEAD, cores), *(node(f"worker-{number}", cores) for number in range(machines - 1))]


CASES = {
    **{f"kubernetes/{size}": (of_kubernetes, size) for size in SIZES},
    "compose": (of_compose,),
    "machines over SSH": (of_machines,),
    "slurm, as shipped": (of_slurm, 3, 8),
    "slurm, one machine": (of_slurm, 1, 8),
    "slurm, many machines": (of_slurm, 20, 64),
}


@pytest.mark.parametrize("case", CASES)
def test_the_nodes_have_what_the_run_asks_for(case):
    read, *arguments = CASES[case]
    config, nodes = read(*arguments)
    placement.plan(config, nodes, HEAD)


@pytest.mark.parametrize("case", CASES)
def test_one_more_actor_would_not_fit_so_no_core_is_idle(case):
    read, *arguments = CASES[case]
    config, nodes = read(*arguments)
    run = config.run.model_copy(update={"actors": config.run.actors + 1})
    with pytest.raises(RunError, match="with room for"):
        placement.plan(config.model_copy(update={"run": run}), nodes, HEAD)


@pytest.mark.parametrize("size", SIZES)
def test_a_pod_asks_for_at_least_the_cores_and_the_memory_that_its_ray_offers(size):
    for group in groups(size):
        (container,) = group["template"]["spec"]["containers"]
        requests = container["resources"]["requests"]
        params = group["rayStartParams"]
        assert int(params["num-cpus"]) <= int(requests["cpu"])
        assert int(params["object-store-memory"]) < memory_bytes(requests["memory"]) / 4
        gpus = container["resources"]["limits"].get("nvidia.com/gpu", "0")
        assert params.get("num-gpus", "0") == gpus


def test_the_cluster_that_was_shipped_before_is_refused():
    config, _ = of_kubernetes("base")
    with pytest.raises(RunError):
        placement.plan(config, [node(HEAD, 4), node("a", 8), node("b", 8)], HEAD)
