"""A run across hosts: network namespaces with names and addresses, Ray with its token, a hub with certificates.

`make cluster-test` runs it. It takes root and minutes.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import hosts
import oracle
import pytest
from hosts import ACTORS, HEAD, HostsRun, opened
from network_hosts import Network, missing

from zsdist.roles import permissions
from zsdist.transport import certificates

pytestmark = [
    pytest.mark.timeout(900),
    pytest.mark.skipif(sys.platform != "linux" or missing() is not None, reason=str(missing())),
]
WITHIN_S = 120.0  # on a busy machine; `tests/chaos/hosts.py` measures how long it takes
OUTSIDE = "outside"  # host that is no node


@pytest.fixture(scope="module")
def cluster():
    with tempfile.TemporaryDirectory(prefix="zh-", dir="/tmp") as folder, opened(Path(folder), OUTSIDE) as found:
        yield *found, Path(folder)


def on(network: Network, name: str, *words: str, without: tuple[str, ...] = ()) -> subprocess.CompletedProcess:
    """Run a command of this Python on a host to its end."""
    unset = [part for variable in without for part in ("-u", variable)]
    command = network.command(name, ["env", *unset, sys.executable, "-m", *words])
    return subprocess.run(command, capture_output=True, text=True, timeout=WITHIN_S)


def error_line(ended: subprocess.CompletedProcess) -> str:
    """Return the last line that a command has written as an error."""
    assert ended.returncode != 0, ended.stdout
    return ended.stderr.strip().splitlines()[-1]


def test_a_run_survives_a_cut_and_a_lost_host(cluster):
    network, ray, root = cluster  # cars of all hosts count their actions below it
    run = HostsRun(root, (network, ray))
    try:
        run.await_flow()
        assert {run.witness.statistics[name]["host"] for name in run.witness.name_of("actor")} == set(ACTORS)
        others = [about for name, about in run.witness.statistics.items() if not name.startswith("actor")]
        assert {about["host"] for about in others} == {HEAD}

        lost, stays = run.at(ACTORS[0]), run.at(ACTORS[1])
        epoch = run.witness.statistics[lost]["epoch"]
        network.cut(ACTORS[0])
        before = len(run.tail.arrivals)
        run.rest(hosts.CUT_S)
        assert run.frames(stays, before) > 0  # the other one goes on
        network.mend(ACTORS[0])
        since = len(run.tail.arrivals)
        run.until(lambda: run.frames(lost, since) > 0, "the actor that was cut off is back", WITHIN_S)
        assert run.witness.statistics[lost]["epoch"] == epoch  # the same process: nothing had to start

        network.kill(ACTORS[1])
        run.until(lambda: not ray.runs(ACTORS[1]), "the host is gone", WITHIN_S)
        ray.start(ACTORS[1])
        since = len(run.tail.arrivals)
        run.until(lambda: run.frames(stays, since) > 0, "the actor of the lost host is back", WITHIN_S)

        found = run.finish()
        assert {name: found[name] for name in oracle.FAULTS} == dict.fromkeys(oracle.FAULTS, 0)
        summary = json.loads((run.launcher.folder / "summary.json").read_text())
        assert summary["ended"] == "interrupted" and summary["learner_updates"]["low"] > 0
    finally:
        run.abandon()


@pytest.mark.parametrize(
    ("token", "words"), [(None, "there is none in RAY_AUTH_TOKEN"), ("f" * 64, "refuses the token")]
)
def test_a_driver_without_the_token_is_told_so_and_the_doctor_says_it_before(
    cluster, tmp_path, monkeypatch, token, words
):
    network, ray, _ = cluster
    certificates.make(tmp_path / "tls", permissions.HUB, permissions.client_names(1), [network.address(HEAD)], 1)
    monkeypatch.setenv("HOME", str(tmp_path))  # Ray would look there for a token
    without = ("RAY_AUTH_TOKEN", "RAY_AUTH_MODE") if token is None else ()
    if token is not None:
        monkeypatch.setenv("RAY_AUTH_TOKEN", token)
    run = [
        "zsdist.launch",
        "--address",
        ray.address,
        "--run-dir",
        str(tmp_path / "run"),
        "--tls",
        str(tmp_path / "tls"),
    ]
    run += ["--set", f"transport.endpoint=tls/{network.address(HEAD)}:7447"]
    assert words in error_line(on(network, HEAD, *run, without=without)) and not (tmp_path / "run").exists()
    asked = on(network, HEAD, "zsdist.doctor", "--address", ray.address, without=without)
    assert asked.returncode != 0 and words in " ".join(asked.stdout.split())


def test_a_node_without_the_token_does_not_join(cluster):
    network, ray, _ = cluster
    words = ["ray.scripts.scripts", "start", f"--address={ray.address}"]
    words += [f"--node-ip-address={network.address(OUTSIDE)}", "--num-cpus=1"]
    ended = on(network, OUTSIDE, *words, without=("RAY_AUTH_TOKEN",))
    assert ended.returncode != 0 and "token" in (ended.stdout + ended.stderr).lower()
