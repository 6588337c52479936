"""Ray on this machine without the processes that a run does not use.

`ray.init` also starts an autoscaler, a log monitor, a server for usage reports and two agents, each a Python process
that imports Ray; it waits for most of them. They have no switch. Here their starts are left out in the releases of Ray
with which that was tried; other releases start whole.
"""

import contextlib
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import ray
from ray._private import node, ray_constants, services
from ray._raylet import persist_port  # type: ignore[attr-defined]  # compiled

from zsdist.run import nursery, nursery_shim, ray_agent

RELEASES = ("2.60.",)  # beginnings of their versions
_NO_PORT = -1  # as Ray's own agents say that they do not listen
_PORTS = ("metrics_agent_port", "metrics_export_port", "dashboard_agent_listen_port", "runtime_env_agent_port")


def is_tried() -> bool:
    """Return whether the installed release of Ray is one of those that are started without unused processes."""
    return ray.__version__.startswith(RELEASES)


@contextlib.contextmanager
def lean() -> Iterator[None]:
    """Let `ray.init` start only what a run uses meanwhile."""
    if not is_tried():
        yield
        return
    with contextlib.ExitStack() as replaced:
        for owner, name, substitute in (
            (node.Node, "start_monitor", _nothing),
            (node.Node, "start_log_monitor", _nothing),
            (node.Node, "start_api_server", _no_server),
            (services, "start_ray_process", _started(services.start_ray_process)),
        ):
            replaced.callback(setattr, owner, name, getattr(owner, name))
            setattr(owner, name, substitute)
        yield


def _nothing(self: node.Node) -> None:
    """Start nothing."""


def _no_server(self: node.Node, **options: Any) -> None:
    """Start no server, and say that it has no address, as Ray does where it shows no dashboard."""
    self._webui_url = ""


def _started(start: Callable[..., Any]) -> Callable[..., Any]:
    """Return `services.start_ray_process` with another command for the raylet."""

    def substitute(command: list[str], process_type: str, *others: Any, **options: Any) -> Any:
        if process_type == ray_constants.PROCESS_TYPE_RAYLET:
            command = raylet_command(command)
        return start(command, process_type, *others, **options)

    return substitute


def raylet_command(command: list[str]) -> list[str]:
    """Return the raylet's command with stand-ins for its agents and, where there is a nursery, workers from there."""
    given = dict(argument.removeprefix("--").split("=", 1) for argument in command if "=" in argument)
    for name in _PORTS:
        persist_port(given["session_dir"], given["node_id"], name, _NO_PORT)
    stand_in = subprocess.list2cmdline([sys.executable, "-I", "-S", str(Path(ray_agent.__file__))])
    new = {"dashboard_agent_command": stand_in, "runtime_env_agent_command": stand_in}
    if nursery.is_employed():
        setup = str(Path(services.__file__).parent / "workers" / nursery_shim.SETUP)
        new["python_worker_command"] = given["python_worker_command"].replace(setup, nursery_shim.__file__, 1)
    return [
        f"--{name}={new[name]}" if (name := argument.removeprefix("--").partition("=")[0]) in new else argument
        for argument in command
    ]
