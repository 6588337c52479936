"""Measurement of the memory of a run that is flooded by clients that may do nothing, or little.

`python tests/chaos/floods.py [--mib 1024]`

A run with certificates goes on while two clients send: one whose certificate no grant names, and one with the
certificate of an actor, under keys that this actor may use. Each sends so many MiB, as large messages, as messages of
the largest size that a connection accepts, and as small ones. The actor also sends records, and well-formed frames that
arrive early, so that their receiver holds them. The resident memory of hub, replay and scheduler is sampled 20 times a
second. The goal is that none grows by more than 64 MiB. The figures are the last line of the output.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import psutil
import zenoh
from small_run import Launcher, Witness, end_cleanly, wait_for

from zsdist.roles import permissions
from zsdist.roles.shapes import SHAPES
from zsdist.transport import certificates
from zsdist.transport.certificates import Identity
from zsdist.transport.session_config import MAX_WHOLE_BYTES, session_config
from zsdist.types import NO_GUIDE, Level, Trajectory
from zsdist.wire import codec, keys
from zsdist.wire.messages import EPISODES, Push, Records

HOST, PORT = "127.0.0.1", 7720
STRANGER, ACTOR = "stranger", "actor-1"
WATCHED = ("hub-0", "replay-0", "scheduler-0")
MIB = 2**20
SIZES = {"large": 64 * MIB, "largest": MAX_WHOLE_BYTES, "small": 16 * 1024}
START_WITHIN_S = 240.0
DRIVEN = 500  # actions before the first flood
SETTLE_S = 3.0
ALLOWED_MIB = 64.0


class Victims:
    """Resident memory of the processes that are watched.

    Args:
        witness: listener that knows them.
    """

    def __init__(self, witness: Witness) -> None:
        self._witness = witness
        self.most: dict[str, float] = {}
        self._next_s = 0.0

    def sample(self) -> dict[str, float]:
        """Return the MiB of each now, and keep the most."""
        self._witness.poll()
        found = {
            name: psutil.Process(self._witness.statistics[name]["pid"]).memory_info().rss / MIB for name in WATCHED
        }
        self.most = {name: max(value, self.most.get(name, 0.0)) for name, value in found.items()}
        return found

    def poll(self) -> None:
        """Take a sample where one is due."""
        if time.time() >= self._next_s:
            self._next_s = time.time() + 0.05
            self.sample()


class Client:
    """Client that sends as fast as its connection takes it, and connects again when the hub has closed it.

    Args:
        endpoint: endpoint of the hub.
        identity: its certificate.
    """

    def __init__(self, endpoint: str, identity: Identity) -> None:
        config = session_config("client", connect=endpoint, connect_timeout_s=5.0, identity=identity)
        self._session = zenoh.open(config)

    def send(self, messages: Iterator[tuple[str, bytes]], mib: int, poll: Callable[[], None]) -> float:
        """Send messages of so many MiB in all; return the MiB that were given to zenoh."""
        sent = 0
        for key, payload in messages:
            self._session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK)
            sent += len(payload)
            poll()
            if sent >= mib * MIB:
                break
        return sent / MIB

    def close(self) -> None:
        """Close the connection."""
        self._session.close()


def rubbish(key: str, size: int) -> Iterator[tuple[str, bytes]]:
    """Yield messages of random bytes."""
    payload = np.random.default_rng(0).integers(0, 256, size, np.uint8).tobytes()
    while True:
        yield key, payload


def early_frames(run: str, actor: str, epoch: int) -> Iterator[tuple[str, bytes]]:
    """Yield well-formed frames that all lack the one before them, so that none can be stored."""
    shape, rng = SHAPES[Level.LOW], np.random.default_rng(0)
    length = 8000
    trajectory = Trajectory(
        Level.LOW,
        rng.normal(size=(length + 1, shape.state_size)).astype(np.float32),
        np.zeros(length, np.uint8),
        np.zeros(length, np.float32),
        np.full(length, 0.9, np.float32),
        np.arange(1, length + 1, dtype=np.uint16),
        np.ones((length + 1, shape.actions), bool),
        np.full(length, NO_GUIDE, np.int8),
        np.zeros(length, np.uint8),
        0,
    )
    for sequence in range(10**6, 10**7):
        frame = Push(Level.LOW, actor, epoch, sequence % 250 + 5, (sequence + 1) * length, False, (trajectory,))
        yield keys.push(run, Level.LOW, actor, epoch), codec.encode(frame)


def early_records(run: str, actor: str, epoch: int) -> Iterator[tuple[str, bytes]]:
    """Yield frames of records that lack the ones before them."""
    records = ({"text": "x" * 100_000},)
    for number in range(10**9):
        frame = Records(EPISODES, actor, epoch, number % 250 + 5, number + 1, False, records)
        yield keys.episodes(run, actor, epoch), codec.encode(frame)


def flood(root: Path, mib: int) -> dict:
    """Flood a run in all ways, and return the growth of each process in each."""
    tls = root / "tls"
    certificates.make(tls, permissions.HUB, [*permissions.client_names(2), STRANGER], [HOST], 1)
    settings = (f"transport.tls={tls}", f"transport.endpoint=tls/{HOST}:{PORT}", "run.actors=2", "run.standby=false")
    launcher = Launcher(root, *settings)
    witness = Witness(launcher, Identity.load(tls, permissions.TRUSTED))
    found: dict[str, dict] = {}
    try:
        names = (*WATCHED, "actor-0", ACTOR)
        wait_for(lambda: set(names) <= set(witness.statistics), START_WITHIN_S, "statistics of all roles", witness.poll)
        wait_for(
            lambda: witness.statistics["actor-0"].get("env_steps", 0) > DRIVEN, START_WITHIN_S, "driving", witness.poll
        )
        run = launcher.folder.name
        endpoint = (launcher.folder / "endpoint").read_text()
        epoch = witness.statistics[ACTOR]["epoch"]
        push = keys.push(run, Level.LOW, ACTOR, epoch)
        floods = {
            f"{who} {name}": (who, rubbish(push, size)) for who in (STRANGER, ACTOR) for name, size in SIZES.items()
        }
        floods[f"{ACTOR} records"] = (ACTOR, rubbish(keys.episodes(run, ACTOR, epoch), SIZES["largest"]))
        floods[f"{ACTOR} early frames"] = (ACTOR, early_frames(run, ACTOR, epoch))
        floods[f"{ACTOR} early records"] = (ACTOR, early_records(run, ACTOR, epoch))
        for name, (who, messages) in floods.items():
            victims = Victims(witness)
            before = victims.sample()
            client = Client(endpoint, Identity.load(tls, who))
            sent = client.send(messages, mib, victims.poll)
            until_s = time.time() + SETTLE_S
            wait_for(lambda until_s=until_s: time.time() > until_s, 10 * SETTLE_S, "settling", victims.poll)
            client.close()
            growth = {role: round(victims.most[role] - before[role], 1) for role in WATCHED}
            found[name] = {"sent_mib": round(sent), **growth}
            print(f"{name:24}{sent:7.0f} MiB sent; growth in MiB: {growth}", file=sys.stderr, flush=True)
            launcher.require_running()
        return found
    finally:
        witness.close()
        launcher.kill(alone=False)


def main() -> None:
    """Flood a run, and print the growth of its processes."""
    end_cleanly()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mib", type=int, default=1024, help="MiB that each client sends in each way")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="floods-") as root:
        found = flood(Path(root), options.mib)
    most = {role: max(of[role] for of in found.values()) for role in WATCHED}
    print(json.dumps({"floods": found, "most_mib": most}))
    sys.exit(any(value > ALLOWED_MIB for value in most.values()))


if __name__ == "__main__":
    main()
