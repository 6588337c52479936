"""Whole runs with Ray actors, PyBullet cars and zenoh, watched by a plain zenoh client."""

import json
import os
import signal
import subprocess
import sys
import time

import psutil
import pytest
import zenoh
from rehearsal import episodes

pytestmark = [pytest.mark.integration, pytest.mark.slow, pytest.mark.alone]

LAUNCH = [sys.executable, "-m", "zsdist.launch", "--actors", "2", "--plain"]
QUICK = ["--set", "run.final_evaluation_episodes=0", "--set", "scenes.train=[singleton]", "--set", "sim.max_steps=60",
         "--set", "vision.network=student", "--set", "camera.size_px=128"]  # fmt: skip
PATIENCE_S = 100.0
GARBAGE_KEYS = (
    "push/low/actor-0/0",
    "episodes/actor-0/0",
    "ack/actor-0",
    "weights/low",
    "candidate/high/recent",
    "evaluation/actor-0",
    "control/actor",
    "control/replay",
    "control/learner",
    "control/scheduler",
    "stats/actor/0",
    "stats/stranger/0",
    "events",
)
ROLES = {"hub/0", "scheduler/0", "replay/0", "learner/high", "learner/low", "actor/0", "actor/1"}


class PlainClient:
    """A zenoh client that knows only the documented keys."""

    def __init__(self, endpoint, run):
        settings = zenoh.Config()
        settings.insert_json5("mode", '"client"')
        settings.insert_json5("connect/endpoints", json.dumps([endpoint]))
        settings.insert_json5("scouting/multicast/enabled", "false")
        self.session = zenoh.open(settings)
        self.run = run
        self.statistics = {}
        self.encodings = set()
        self.subscriber = self.session.declare_subscriber(f"zsdist/{run}/stats/**", self._keep)

    def _keep(self, sample):
        self.statistics[str(sample.key_expr).split("/stats/")[1]] = json.loads(sample.payload.to_string())
        self.encodings.add(str(sample.encoding))

    def publish_garbage(self):
        """Publishes invalid bytes under every key."""
        for key in GARBAGE_KEYS:
            for payload in (b"", b"\x00" * 64, os.urandom(500), b'{"role": 1}'):
                self.session.put(f"zsdist/{self.run}/{key}", payload)
        for key in ("sample/low", "control/replay"):
            self.session.get(f"zsdist/{self.run}/{key}", payload=os.urandom(100), timeout=0.2)

    def alive(self):
        replies = self.session.liveliness().get(f"zsdist/{self.run}/alive/**")
        return {str(reply.ok.key_expr).split("/alive/")[1] for reply in replies if reply.ok}

    def close(self):
        self.subscriber.undeclare()
        self.session.close()


def until(condition, process, what):
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        if condition():
            return
        assert process.poll() is None, f"the run ended before {what}: {process.communicate()[0]}"
        time.sleep(0.1)
    raise AssertionError(f"waited {PATIENCE_S} s for {what}")


def begin(folder, *more):
    command = [*LAUNCH, *QUICK, *more]
    if "--resume" not in more:
        command += ["--run-dir", str(folder)]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )
    until((folder / "endpoint").exists, process, "the hub listens")
    return process


def summary_of(folder):
    return json.loads((folder / "summary.json").read_text())


@pytest.mark.timeout(300)
def test_another_client_sees_every_role_and_a_killed_actor_hub_and_replay_are_replaced(tmp_path):
    folder = tmp_path / "watched"
    process = begin(folder, "--episodes", "2000")  # more than any machine drives before the last one is replaced
    client = PlainClient((folder / "endpoint").read_text(), "watched")
    try:
        until(lambda: set(client.statistics) >= ROLES, process, "every role has published statistics")
        assert client.alive() >= ROLES
        assert client.encodings == {"application/json"}
        for name, fields in client.statistics.items():
            assert f"{fields['role']}/{fields['id']}" == name
            assert {"time_s", "host", "pid"} <= set(fields)
        assert len({fields["pid"] for name, fields in client.statistics.items() if name in ROLES}) == len(ROLES)

        client.publish_garbage()
        until(lambda: client.statistics["replay/0"].get("rejected_magic", 0) > 0, process, "the garbage is counted")

        seen = subprocess.run(
            [sys.executable, "-m", "zsdist.monitor", "--once", "--json", "--runs", str(tmp_path)],
            capture_output=True,
            text=True,
        )
        assert seen.returncode == 0, seen.stderr
        assert set(json.loads(seen.stdout)["alive"]) >= ROLES

        until(lambda: client.statistics["actor/1"].get("env_steps", 0) > 20, process, "the second actor drives")
        victim = client.statistics["actor/1"]["pid"]
        os.kill(victim, signal.SIGKILL)
        until(lambda: client.statistics["actor/1"]["pid"] != victim, process, "the actor is back")
        victim = client.statistics["hub/0"]["pid"]
        os.kill(victim, signal.SIGKILL)
        until(lambda: client.statistics["hub/0"]["pid"] != victim, process, "the hub is back")
        assert client.statistics["hub/0"]["endpoint"] == (folder / "endpoint").read_text()
        until(lambda: client.alive() >= ROLES, process, "every role is back at the hub")
        before = client.statistics["replay/0"]
        os.kill(before["pid"], signal.SIGKILL)
        until(lambda: client.statistics["replay/0"]["pid"] != before["pid"], process, "the replay is back")
        assert client.statistics["replay/0"]["recovered_frames"] > 0
        assert client.statistics["replay/0"]["low_stored"] >= before["low_stored"]
        driven = len(episodes(folder))
        until(lambda: len(episodes(folder)) >= driven + 4, process, "episodes go on")
        family = psutil.Process(process.pid).children(recursive=True)
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=PATIENCE_S)
    finally:
        client.close()
        process.kill()
    assert process.returncode == 130, output
    assert not [child for child in family if child.is_running() and child.status() != psutil.STATUS_ZOMBIE]
    summary = summary_of(folder)
    assert summary["restarts"] == {"actor": 1, "hub": 1, "replay": 1}
    assert len({record["episode"] for record in episodes(folder)}) == len(episodes(folder)) == summary["episodes"]
    for books in summary["transitions"].values():
        assert books["produced"] == books["stored"] + books["rejected"] > 0
    assert (folder / "figures" / "fig09-rewards.png").stat().st_size > 0


@pytest.mark.timeout(300)
def test_sigterm_to_the_whole_process_group_saves_and_names_the_command_that_resumes(tmp_path):
    folder = tmp_path / "interrupted"
    process = begin(folder, "--episodes", "500", "--set", "replay.shards=2")
    try:
        until(lambda: (folder / "episodes.jsonl").exists() and len(episodes(folder)) > 2, process, "some episodes")
        second = subprocess.run(
            [*LAUNCH, "--resume", str(folder)], capture_output=True, text=True, timeout=PATIENCE_S, check=False
        )
        assert second.returncode == 2, second.stderr
        assert f"run directory {folder} is in use by process {process.pid} on " in second.stderr
        os.killpg(process.pid, signal.SIGTERM)
        output, _ = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
    assert process.returncode == 143, output
    assert f"--resume {folder}" in output
    assert "Traceback" not in output
    before = summary_of(folder)
    assert len(list(max(folder.glob("checkpoints/*")).glob("replay*.state"))) == 2
    assert before["ended"] == "interrupted"
    assert before["episodes"] == len(episodes(folder))

    process = begin(folder, "--resume", str(folder), "--episodes", str(before["episodes"] + 2))
    output, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, output
    after = summary_of(folder)
    assert after["episodes"] == before["episodes"] + 2
    assert after["learner_updates"]["low"] >= before["learner_updates"]["low"]
    assert len({record["episode"] for record in episodes(folder)}) == len(episodes(folder)) == after["episodes"]
    for books in after["transitions"].values():
        assert books["produced"] == books["stored"] + books["rejected"]
