"""The real thing: Ray actors, PyBullet cars, zenoh; watched by a client that is not ours."""

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

pytestmark = [pytest.mark.integration, pytest.mark.slow]

LAUNCH = [sys.executable, "-m", "zsdist.launch", "--actors", "2", "--plain"]
QUICK = ["--set", "run.final_evaluation_episodes=0", "--set", "scenes.train=[singleton]", "--set", "sim.max_steps=60"]
PATIENCE_S = 100.0
RUBBISHED = (
    "push/low/actor-0/0",
    "episodes/actor-0/0",
    "ack/actor-0",
    "weights/low",
    "candidate/high/1-recent",
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


class Stranger:
    """A plain zenoh client that knows the documented keys and nothing else."""

    def __init__(self, endpoint, run):
        settings = zenoh.Config()
        settings.insert_json5("mode", '"client"')
        settings.insert_json5("connect/endpoints", json.dumps([endpoint]))
        settings.insert_json5("scouting/multicast/enabled", "false")
        self.session = zenoh.open(settings)
        self.run = run
        self.said = {}
        self.encodings = set()
        self.subscriber = self.session.declare_subscriber(f"zsdist/{run}/stats/**", self._hear)

    def _hear(self, sample):
        self.said[str(sample.key_expr).split("/stats/")[1]] = json.loads(sample.payload.to_string())
        self.encodings.add(str(sample.encoding))

    def rubbish(self):
        """Bytes that are no message of ours, wherever one is expected."""
        for key in RUBBISHED:
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
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    until((folder / "endpoint").exists, process, "the hub listens")
    return process


def summary_of(folder):
    return json.loads((folder / "summary.json").read_text())


def test_a_stranger_sees_every_role_and_a_killed_actor_hub_and_replay_are_replaced(tmp_path):
    folder = tmp_path / "watched"
    process = begin(folder, "--episodes", "20")
    stranger = Stranger((folder / "endpoint").read_text(), "watched")
    try:
        until(lambda: set(stranger.said) >= ROLES, process, "every role has spoken")
        assert stranger.alive() >= ROLES
        assert stranger.encodings == {"application/json"}
        for name, fields in stranger.said.items():
            assert f"{fields['role']}/{fields['id']}" == name
            assert {"time_s", "host", "pid"} <= set(fields)
        assert len({fields["pid"] for name, fields in stranger.said.items() if name in ROLES}) == len(ROLES)

        stranger.rubbish()
        until(lambda: stranger.said["replay/0"].get("rejected_magic", 0) > 0, process, "the rubbish is counted")

        seen = subprocess.run(
            [sys.executable, "-m", "zsdist.monitor", "--once", "--json", "--runs", str(tmp_path)],
            capture_output=True,
            text=True,
        )
        assert seen.returncode == 0, seen.stderr
        assert set(json.loads(seen.stdout)["alive"]) >= ROLES

        until(lambda: stranger.said["actor/1"].get("env_steps", 0) > 20, process, "the second actor drives")
        victim = stranger.said["actor/1"]["pid"]
        os.kill(victim, signal.SIGKILL)
        until(lambda: stranger.said["actor/1"]["pid"] != victim, process, "the actor is back")
        victim = stranger.said["hub/0"]["pid"]
        os.kill(victim, signal.SIGKILL)
        until(lambda: stranger.said["hub/0"]["pid"] != victim, process, "the hub is back")
        assert stranger.said["hub/0"]["endpoint"] == (folder / "endpoint").read_text()
        until(lambda: stranger.alive() >= ROLES, process, "every role is back at the hub")
        before = stranger.said["replay/0"]
        os.kill(before["pid"], signal.SIGKILL)
        until(lambda: stranger.said["replay/0"]["pid"] != before["pid"], process, "the replay is back")
        assert stranger.said["replay/0"]["recovered_frames"] > 0
        assert stranger.said["replay/0"]["low_stored"] >= before["low_stored"]
        family = psutil.Process(process.pid).children(recursive=True)
        output, _ = process.communicate(timeout=PATIENCE_S)
    finally:
        stranger.close()
        process.kill()
    assert process.returncode == 0, output
    assert not [child for child in family if child.is_running() and child.status() != psutil.STATUS_ZOMBIE]
    summary = summary_of(folder)
    assert summary["restarts"] == {"actor": 1, "hub": 1, "replay": 1}
    assert sorted(record["episode"] for record in episodes(folder)) == list(range(1, 21))
    for books in summary["transitions"].values():
        assert books["produced"] == books["stored"] + books["rejected"] > 0
    assert (folder / "figures" / "fig09-rewards.png").stat().st_size > 0


def test_ctrl_c_saves_and_says_how_to_go_on_and_resume_does(tmp_path):
    folder = tmp_path / "interrupted"
    process = begin(folder, "--episodes", "500", "--set", "replay.shards=2")
    try:
        until(lambda: (folder / "episodes.jsonl").exists() and len(episodes(folder)) > 2, process, "some episodes")
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
    assert process.returncode == 130, output
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
