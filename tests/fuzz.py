"""Fuzzer of the codec and of every mailbox, which runs until an input causes an error.

    PYTHONPATH=. python tests/fuzz.py --inputs 1000000 --state fuzz.json

Each input is a valid message with changed bits, bytes, splices, JSON or columns. In most cases its checksum is
corrected, so that the code behind it is reached; some inputs are repeated unchanged, or sent under a wrong key. Half of
them go to `codec.decode`, which may only raise `DecodeError`; every message that it accepts must be encodable again.
The others go into the mailboxes of a replay, a learner, an actor and a scheduler, which must count them or act on them
and continue. A second start with the same state file resumes the first. An input that breaks something is saved beside
that file.
"""

import argparse
import copy
import json
import random
import struct
import sys
import tempfile
import time
import zlib
from collections import Counter
from pathlib import Path

import numpy as np
from mailboxes import PARAMETERS, REPLAY, RUN, Bench
from wire_messages import ACTOR, EPISODE, JOBS, LEARNER, RESULT, SUPERVISION, batch, every_message, push

from zsdist.dqn import network
from zsdist.errors import DecodeError
from zsdist.transport.base import Message
from zsdist.types import Ack, Level, Weights
from zsdist.wire import codec, frame, keys
from zsdist.wire.messages import Candidate, Jobs, Orders, Records, SampleReply, SampleRequest, WeightsMessage

ROUND = 400  # inputs between two steps of a role
ROUNDS_A_ROLE = 50  # after which a new one replaces it
REPORT_EVERY_S = 5.0
HOSTILE = [
    None,
    True,
    False,
    0,
    -1,
    1,
    2**31,
    2**62,
    2**63,
    2**126,
    0.5,
    -1e300,
    1e300,
    "",
    "actor-0",
    "x" * 300,
    [],
    {},
]
HOSTILE += [[[]], {"": 0}, "a/b", "**", "low", "high", "episodes", "evaluation", "recent", [["recent", 0]], [1] * 300]
NUMBERS = [0, 1, -1, 2**15, 2**16 - 1, 2**31, 2**63 - 1, np.nan, np.inf, -np.inf, 1e-45, 65504.0, 1e38]


class Mutator:
    """Source of changed messages that follow from its seed."""

    def __init__(self, seed: str, corpus: list[bytes]) -> None:
        self.random = random.Random(seed)
        self.corpus = corpus

    def change(self, payload: bytes) -> bytes:
        """Return a changed form of a message."""
        kind = self.random.random()
        if kind < 0.03:
            return payload
        if kind < 0.35:
            return self._structure(payload)
        changed = self._bytes(payload[:16] if kind < 0.4 else payload, self.random.choice(self.corpus))
        if kind < 0.4:
            changed += payload[16:]
        elif kind > 0.95:
            return changed  # with a wrong checksum
        if len(changed) < 16:
            return changed
        if kind < 0.9:  # correct the declared length too
            changed = changed[:8] + struct.pack("<I", len(changed) - 16) + changed[12:]
        return changed[:12] + struct.pack("<I", zlib.crc32(changed[16:], zlib.crc32(changed[:12]))) + changed[16:]

    def text(self, payload: bytes) -> bytes:
        """Return a changed form of a JSON text."""
        if self.random.random() < 0.5:
            return self._bytes(payload, self.random.choice(self.corpus))
        return json.dumps(self._json(json.loads(payload))).encode()

    def _bytes(self, payload: bytes, other: bytes) -> bytes:
        changed, pick = bytearray(payload), self.random.randrange
        for _ in range(pick(1, 4)):
            place = pick(len(changed) + 1)
            match pick(6):
                case 0 if place < len(changed):
                    changed[place] ^= 1 << pick(8)
                case 1:
                    del changed[place : place + pick(64)]
                case 2:
                    start = pick(len(other) + 1)
                    changed[place:place] = other[start : start + pick(64)]
                case 3:
                    changed[place : place + 4] = self.random.randbytes(4)
                case 4:
                    changed[place : place + 4] = struct.pack("<I", self.random.choice([0, 1, 2**16, 2**31, 2**32 - 1]))
                case _:
                    del changed[place:]
        return bytes(changed)

    def _structure(self, payload: bytes) -> bytes:
        kind = payload[5]
        meta, columns = frame.unpack(payload, 2**28)
        if columns and self.random.random() < 0.6:
            self._columns(columns)
        else:
            meta = self._json(meta)
        try:
            return frame.pack(kind, meta, columns, 2**28, self.random.choice([frame.PLAIN, frame.ZSTD]))
        except DecodeError:  # no frame can hold it
            return payload

    def _columns(self, columns: dict[str, np.ndarray]) -> None:
        name = self.random.choice(list(columns))
        column = columns[name]
        match self.random.randrange(5):
            case 0 if column.size:
                flat = column.reshape(-1).copy()
                with np.errstate(all="ignore"):
                    flat[self.random.randrange(flat.size)] = np.array(
                        self.random.choice(NUMBERS if column.dtype.kind == "f" else NUMBERS[:7])
                    ).astype(column.dtype)
                columns[name] = flat.reshape(column.shape)
            case 1:
                with np.errstate(all="ignore"):
                    columns[name] = column.astype(self.random.choice(["uint8", "float32", "int64", "float16"]))
            case 2:
                columns[name] = column[: self.random.randrange(len(column) + 1)] if column.ndim else column[None]
            case 3:
                columns[name] = column[..., None] if self.random.random() < 0.5 else column.reshape(-1)
            case _:
                del columns[name]

    def _json(self, value: object) -> object:
        """Return a copy of `value` with one part changed at any depth."""
        value = copy.deepcopy(value)
        holder, place = None, None
        part = value
        while isinstance(part, dict | list) and part and (holder is None or self.random.random() < 0.7):
            holder = part
            place = self.random.choice(list(part) if isinstance(part, dict) else range(len(part)))
            part = holder[place]
        if holder is None:
            return value
        if isinstance(part, int | float) and self.random.random() < 0.5:
            holder[place] = part + self.random.choice([-1, 1, 0.5])
        elif self.random.random() < 0.15:
            del holder[place]
        elif self.random.random() < 0.1 and isinstance(holder, dict):
            holder["more"] = self.random.choice(HOSTILE)
        else:
            holder[place] = self.random.choice(HOSTILE)
        return value


def seeds() -> dict[str, list[tuple[str, bytes]]]:
    """Valid messages for every mailbox of every role, by role, with the keys under which they arrive."""
    rng = np.random.default_rng(0)
    of_actor = {"actor": "actor-0", "epoch": 7}
    weights = WeightsMessage(1, 0, network.sha256(PARAMETERS), 1.0, Weights(Level.LOW, 1, PARAMETERS))
    candidate = Candidate(1, Level.LOW, 1, "recent", PARAMETERS)
    statistics = {"time_s": 1.0, "role": "actor", "id": "0", "host": "h", "pid": 1, "epoch": 7, "env_steps": 9}
    level_replay = {
        "time_s": 1.0,
        "role": "replay",
        "id": "0",
        "low_samples_per_insert": 3.0,
        "low_sampled": 3,
        "low_stored": 1,
    }
    found: dict[str, list[tuple[str, object]]] = {
        "replay-0": [
            (keys.control(RUN, "replay"), Orders(1, "replay", REPLAY)),
            (keys.push(RUN, "low", "actor-0", 7), push(rng, sequence=0, produced=21, **of_actor)),
            (keys.push(RUN, "low", "actor-0", 7), push(rng, sequence=1, produced=42, **of_actor)),
            (keys.push(RUN, "high", "actor-0", 7), push(rng, Level.HIGH, sequence=0, produced=21, **of_actor)),
            (keys.sample(RUN, "low"), SampleRequest(1, Level.LOW, 0)),
            (keys.control(RUN, "replay"), Orders(1, "replay", {"ask": "state"})),
        ],
        "learner-low": [
            (keys.control(RUN, "learner"), Orders(1, "learner", LEARNER)),
            (keys.control(RUN, "learner-low"), Orders(1, "learner-low", {"ask": "state"})),
            (keys.sample(RUN, "low"), SampleReply(Level.LOW, batch(rng), 100, 0.0)),
            (keys.sample(RUN, "low"), SampleReply(Level.LOW, None, 0, 2.0)),
        ],
        "actor-0": [
            (keys.control(RUN, "actor"), Orders(1, "actor", ACTOR)),
            (keys.evaluation(RUN, "actor-0"), Jobs(1, "actor-0", JOBS | {"epoch": 9})),
            (keys.ack(RUN, "actor-0"), Ack(1, "actor-0", 9, "low", 0, 100)),
            (keys.ack(RUN, "actor-0"), Ack(1, "actor-0", 9, "episodes", 0, None)),
            (keys.weights(RUN, "low"), weights),
            (keys.candidate(RUN, "low", "recent"), candidate),
        ],
        "scheduler-0": [
            (keys.control(RUN, "scheduler"), Orders(1, "scheduler", SUPERVISION | {"epochs": {"actor-0": 7}})),
            (keys.episodes(RUN, "actor-0", 7), Records("episodes", "actor-0", 7, 0, 1, False, (EPISODE,))),
            (keys.evaluation(RUN, "actor-0"), Records("evaluation", "actor-0", 7, 0, 1, False, (RESULT,))),
            (keys.weights(RUN, "low"), weights),
            (keys.candidate(RUN, "low", "recent"), candidate),
            (keys.stats(RUN, "actor", "0"), json.dumps(statistics).encode()),
            (keys.stats(RUN, "replay", "0"), json.dumps(level_replay).encode()),
        ],
    }
    return {
        role: [(key, message if isinstance(message, bytes) else codec.encode(message)) for key, message in pairs]
        for role, pairs in found.items()
    }


class Mailboxes:
    """Role that gets inputs; a new one replaces it from time to time, and when it has finished."""

    def __init__(self, name: str, pairs: list[tuple[str, bytes]], mutator: Mutator) -> None:
        self.name, self.pairs, self.mutator = name, pairs, mutator
        self.refused: Counter[str] = Counter()
        self._folder: tempfile.TemporaryDirectory | None = None
        self._asked = None
        self._rounds = ROUNDS_A_ROLE

    def fire(self, count: int) -> list[tuple[str, bytes]]:
        """Send inputs and let the role take a step; return the inputs if it raises an error."""
        if self._rounds >= ROUNDS_A_ROLE:
            self._begin()
        self._rounds += 1
        sent = []
        for _ in range(count):
            key, payload = self.mutator.random.choice(self.pairs)
            payload = self.mutator.text(payload) if "/stats/" in key else self.mutator.change(payload)
            if self.mutator.random.random() < 0.05:
                key = self.mutator.random.choice(self.pairs)[0]
            sent.append((key, payload))
            self._send(key, payload)
        try:
            self.bench.now += 0.5
            if self.bench.role.step(self.bench.now) is None:
                self._rounds = ROUNDS_A_ROLE
            self.bench.stats.drain()
            self.bench.answers.drain()
        except Exception:
            return sent
        return []

    def _begin(self) -> None:
        self._close()
        self._folder = tempfile.TemporaryDirectory()
        self.bench = Bench(self.name, Path(self._folder.name) / "journal")
        if self.name.startswith("learner"):
            self.bench.others.serve(keys.sample(RUN, "low"), self.bench.answers)
            self.bench.role.step(0.0)
        for key, payload in self.pairs[:1]:
            self._send(key, payload)
        self.bench.role.step(0.1)
        self._rounds = 0

    def _send(self, key: str, payload: bytes) -> None:
        if self.name.startswith("learner") and "/sample/" in key:
            self.bench.role._batches.append(Message(key, payload))  # a reply goes only to the sender of the request
            return
        self.bench.others.publish(key, payload)
        self.bench.others.request(key, payload, self.bench.answers, timeout_s=1.0)

    def _close(self) -> None:
        if self._folder is not None:
            self.refused += self.bench.role._refused
            self._folder.cleanup()


def survives_decoding(payload: bytes, refused: Counter[str]) -> bool:
    """Return whether the codec refuses these bytes by `DecodeError`, or accepts what can be encoded again."""
    try:
        codec.encode(codec.decode(payload))
    except DecodeError as error:
        refused[error.reason] += 1
    except Exception:
        return False
    return True


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=100_000, help="total, earlier sessions included")
    parser.add_argument("--state", type=Path, required=True, help="file with the state; made if it does not exist")
    parser.add_argument("--seed", type=int, default=0, help="so that several processes try different inputs")
    options = parser.parse_args()
    state = json.loads(options.state.read_text()) if options.state.exists() else {"inputs": 0, "refused": {}}
    refused = Counter(state["refused"])
    pairs = seeds()
    corpus = [codec.encode(message) for message in every_message(np.random.default_rng(0))]
    corpus += [payload for role in pairs.values() for key, payload in role if "/stats/" not in key]
    mutator = Mutator(f"{options.seed}/{state['inputs']}", corpus)
    mailboxes = [Mailboxes(name, messages, mutator) for name, messages in pairs.items()]
    broken, reported_s = [], time.monotonic()
    while state["inputs"] < options.inputs and not broken:
        for box in mailboxes:
            for _ in range(ROUND):
                payload = mutator.change(mutator.random.choice(corpus))
                if not survives_decoding(payload, refused):
                    broken.append(("codec", payload))
            broken += box.fire(ROUND)
            state["inputs"] += 2 * ROUND
        if time.monotonic() - reported_s > REPORT_EVERY_S or state["inputs"] >= options.inputs or broken:
            reported_s = time.monotonic()
            by_role = sum((box.refused for box in mailboxes), Counter(refused))
            options.state.write_text(json.dumps({"inputs": state["inputs"], "refused": by_role}, indent=1))
            print(f"{state['inputs']} inputs, {by_role.total()} refusals, {len(by_role)} reasons", flush=True)
    for index, (key, payload) in enumerate(broken):
        place = options.state.with_suffix(f".broken-{index}")
        place.write_bytes(key.encode() + b"\n" + payload)
    if broken:
        print(f"broken by one of {len(broken)} inputs, left beside {options.state}", file=sys.stderr)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
