"""The page on clusters of PCs, followed to the letter on hosts of namespaces, with real cars.

Commands are read from the documents and from `deploy/ray-cluster.yaml`. Only addresses and sizes are others. Each host
has its own folder `tls` at the same path, as the page wants it.
"""

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import textwrap
import time
from pathlib import Path

import pytest
import yaml
from documented import ROOT
from network_hosts import Network, missing

pytestmark = [
    pytest.mark.timeout(900),
    pytest.mark.skipif(sys.platform != "linux" or missing() is not None, reason=str(missing())),
]
HEAD, WORKERS, SPARE = "head", ("one", "two"), "spare"
WITHIN_S = 240.0  # compiling included
SMALL = (
    "--actors 2 --plain --set run.cars_per_actor=1 --set run.final_evaluation_episodes=0 "
    "--set vision.network=student --set camera.size_px=128 --set run.standby=false --set merge.every_episodes=0"
)
PAGE, DEPLOY = "docs/cluster.md", "deploy/README.md"
MONITOR = "python -m zsdist.monitor --connect"


def block(document: str, beginning: str, containing: str = "") -> str:
    """Return the first indented commands of a document that begin so and contain something."""
    text = (ROOT / document).read_text()
    for found in re.findall(r"^(?: {4,}.*\n)+", text, re.MULTILINE):
        if (commands := textwrap.dedent(found)).startswith(beginning) and containing in commands:
            return commands
    raise AssertionError(f"{document} has no commands that begin with {beginning!r} and contain {containing!r}")


class Lab:
    """Hosts with the certificates and the token of the pages.

    Args:
        folder: folder with a short name, in which every host works.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.network = Network([HEAD, *WORKERS, SPARE])
        self.address = self.network.address(HEAD)
        kept = {name: value for name, value in os.environ.items() if not name.startswith("RAY_")}
        own = {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "RAY_TMPDIR": str(folder)}
        self.environment = kept | own | {"HOME": str(folder), "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
        self.nodes = yaml.safe_load((ROOT / "deploy" / "ray-cluster.yaml").read_text())
        options = [option for option in self.nodes["docker"]["run_options"] if option.startswith("--env ")]
        named = dict(option.removeprefix("--env ").split("=") for option in options)
        assert named == {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN_PATH": "/run/secrets/ray-token"}
        self.environment |= named | {"RAY_AUTH_TOKEN_PATH": str(folder / "ray-token")}
        for name in ("configs", "deploy"):
            (folder / name).symlink_to(ROOT / name)

    def addressed(self, commands: str) -> str:
        """Return commands of a page with the address of this head."""
        return commands.replace("10.0.0.10", self.address)

    def begin(self, host: str, commands: str, tls: str | None = None, **more: str) -> subprocess.Popen:
        """Start commands in a shell of a host, where `tls` is the folder of certificates of its own."""
        own = "true" if tls is None else f"mount --bind {tls} tls"
        words = self.network.command(host, ["sh", "-c", f"{own} && set -e\n{commands}"])
        return subprocess.Popen(
            words,
            cwd=self.folder,
            env=self.environment | more,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def run(self, host: str, commands: str, tls: str | None = None, **more: str) -> str:
        """Run commands on a host to their end, and return what they print; they must succeed."""
        process = self.begin(host, commands, tls, **more)
        printed, _ = process.communicate(timeout=WITHIN_S)
        assert process.returncode == 0, printed
        return printed

    def start_ray(self, host: str, which: str, tls: str) -> None:
        """Start the node of a host as `deploy/ray-cluster.yaml` has it."""
        (start,) = (line for line in self.nodes[which] if "ray start" in line)
        start = start.replace("--autoscaling-config=~/ray_bootstrap_config.yaml ", "")  # a file that `ray up` sends
        less = f"--node-ip-address={self.network.address(host)} --object-store-memory=80000000"
        self.run(host, f"{start} {less}", tls, RAY_HEAD_IP=self.address)


@pytest.fixture(scope="module")
def lab():
    with tempfile.TemporaryDirectory(prefix="zp-", dir="/tmp") as folder:
        made = Lab(Path(folder))
        try:
            made.run(HEAD, made.addressed(block(DEPLOY, "python -m zsdist.certs").replace("--actors 32", "--actors 3")))
            made.run(HEAD, block(DEPLOY, "python -c"))
            made.start_ray(HEAD, "head_start_ray_commands", "tls-head")
            for worker in WORKERS:
                made.start_ray(worker, "worker_start_ray_commands", "tls-actors")
            yield made
        finally:
            made.network.close()


def episodes(lab: Lab) -> int:
    file = lab.folder / "runs" / "first" / "episodes.jsonl"
    return file.read_text().count("\n") if file.exists() else 0


def await_episodes(lab: Lab, count: int, run: subprocess.Popen) -> None:
    end_s = time.monotonic() + WITHIN_S
    while episodes(lab) < count:
        assert run.poll() is None, run.communicate()[0]
        assert time.monotonic() < end_s, f"{episodes(lab)} episodes, no {count}"
        time.sleep(0.2)


def snapshot(lab: Lab) -> dict:
    watch = lab.addressed(block(PAGE, MONITOR).splitlines()[0])
    return json.loads(lab.run(SPARE, f"{watch} --once --json 2> /dev/null", "tls-monitor"))


def metrics(lab: Lab, run: subprocess.Popen) -> str:
    """Return the page for Prometheus, from the page's command on the spare host."""
    process = lab.begin(SPARE, f"exec {lab.addressed(block(PAGE, MONITOR, '--prometheus'))}", "tls-monitor")
    try:
        assert "metrics at" in process.stdout.readline()
        read = "import urllib.request; print(urllib.request.urlopen('http://127.0.0.1:9464/metrics').read().decode())"
        end_s = time.monotonic() + WITHIN_S
        while "zsdist_actor_env_steps_total" not in (page := lab.run(SPARE, f'python -c "{read}"')):
            assert run.poll() is None and time.monotonic() < end_s, page
            time.sleep(0.5)
        return page
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(WITHIN_S)


def launching(lab: Lab, count: int) -> str:
    """Return the page's commands that check the cluster and train on it, for so many episodes of a small run."""
    commands = lab.addressed(block(PAGE, "HUB=tls"))
    assert "zsdist.doctor" in commands and "--auto-resume" in commands
    return f"{commands.rstrip()} {SMALL} --episodes {count}".replace(
        "python -m zsdist.launch", "exec python -m zsdist.launch"
    )


def test_the_page_leads_to_a_run_that_others_watch_and_join(lab):
    run = lab.begin(HEAD, launching(lab, 5000), "tls-head")
    try:
        await_episodes(lab, 2, run)
        seen = snapshot(lab)
        assert {"actor/0", "actor/1", "hub/0", "learner/low"} <= set(seen["alive"])
        end_s = time.monotonic() + WITHIN_S
        while not {"actor/0", "actor/1", "learner/low"} <= set(seen["roles"]):  # one glance hears some of the reports
            assert time.monotonic() < end_s, seen["roles"]
            seen = snapshot(lab)
        hosts = {name: fields["host"] for name, fields in seen["roles"].items()}
        assert {hosts["actor/0"], hosts["actor/1"]} <= set(WORKERS) and hosts["learner/low"] == HEAD
        page = metrics(lab, run)
        assert 'host="one"' in page or 'host="two"' in page

        (lab.folder / "tls-spare").mkdir()
        for name in ("ca.pem", "actor-2.pem", "actor-2.key"):  # the files of a further name, as the page says
            (lab.folder / "tls-spare" / name).write_bytes((lab.folder / "tls" / name).read_bytes())
            (lab.folder / "tls-spare" / name).chmod(0o600)
        join = lab.addressed(block(PAGE, "python -m zsdist.launch --join").replace("--actors 8", "--actors 1"))
        guest = lab.begin(SPARE, f"exec {join.partition('#')[0]}", "tls-spare")
        end_s = time.monotonic() + WITHIN_S
        while "actor/2" not in snapshot(lab)["alive"]:
            assert guest.poll() is None and time.monotonic() < end_s, guest.communicate()[0]
            time.sleep(0.5)
        guest.send_signal(signal.SIGINT)  # Ctrl-C takes them away again
        assert guest.wait(WITHIN_S) == 130, guest.communicate()[0]
        run.send_signal(signal.SIGINT)
        printed, _ = run.communicate(timeout=WITHIN_S)
        assert run.returncode == 130, printed
    finally:
        run.kill()
    driven = episodes(lab)
    lab.run(HEAD, launching(lab, driven + 2), "tls-head")  # the same command goes on with the run
    assert episodes(lab) == driven + 2
    assert "nothing is left to do" in lab.run(HEAD, launching(lab, driven + 2), "tls-head")
