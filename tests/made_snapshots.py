"""Snapshots of runs that tests of the display are made with."""

import json
from functools import cache

from zsdist.telemetry.snapshot import Snapshot
from zsdist.transport.base import Message
from zsdist.wire import keys

RUN = "test"


def report(role, identifier, time_s=1.0, **fields):
    content = {"time_s": time_s, "role": role, "id": identifier, "epoch": 1} | fields
    return Message(keys.stats(RUN, role, identifier), json.dumps(content).encode())


def alive(role, identifier):
    return Message(keys.alive(RUN, role, identifier), b"1")


def made(*messages):
    snapshot = Snapshot()
    snapshot.update(messages)
    return snapshot


@cache
def extreme():
    """Return the snapshot of a run with 100,000 episodes and 4,096 actors, in which every role waits."""
    snapshot = Snapshot()
    for second in range(2):
        snapshot.update([
            report("scheduler", "0", second, stage="train", episodes=99_999, episodes_target=100_000,
                   recent_success=0.5, mean_return=-12345.67, drives_left=4096, success=99_999,
                   states_awaited=" ".join(f"actor-{number}" for number in range(20))),
            *(report("learner", level, second, waiting_data_s=1.0 * second, learner_updates=10**9 * (second + 1))
              for level in ("high", "low")),
            *(report("actor", str(number), second, waiting_credit_s=1.0 * second, env_steps=10**9 * (second + 1))
              for number in range(4096)),
        ])  # fmt: skip
    snapshot.update([alive("actor", str(number)) for number in range(4096)])
    return snapshot
