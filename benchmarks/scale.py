"""Number of actors that one replay serves, and the part that saturates first.

`python benchmarks/scale.py [--quick]` prints a table, then one JSON line. Actors are synthetic, without physics;
everything else is real. Actors push low-level trajectories as fast as their credit allows, through the outbox, codec
and transport into the replay role; a learner that does not train takes batches of the default size. Counting starts
once the actors have used up the credit that is granted ahead of the learner. All parts run in one process, so that the
CPU time of each can be measured: that of actors, replay and learner in the main thread, that of zenoh (router and all
clients) in the other threads. Transitions divided by a part's own CPU time are the rate that it could sustain on a core
of its own. The part with the lowest rate saturates first; actors do not count, because every machine brings its own.

`python benchmarks/scale.py --clients 16 64 256 --points scale.jsonl` measures many clients at one hub instead, each
with a connection of its own (`_crowd.py`), and appends a line to the file for each case that it does not hold yet.
`--fit scale.jsonl` prints what runs of 10 to 10,000 actors need by these points (`_scaling_model.py`).
"""

import argparse
import json
import os
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from _common import report
from wire import make_trajectory

from zsdist.agent.features import LOW_ACTIONS, LOW_STATE_SIZE
from zsdist.config import Config, parse
from zsdist.dqn.batches import from_stored
from zsdist.protocol.outbox import Outbox
from zsdist.roles.base import Context
from zsdist.roles.learner import BATCHES_AN_ANSWER, PREFETCH
from zsdist.roles.replay.level_replay import Shape
from zsdist.roles.replay.role import Replay
from zsdist.transport.base import Mailbox, Transport
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.transport.zenoh import ZenohHub, ZenohTransport
from zsdist.types import Level
from zsdist.wire import codec, keys
from zsdist.wire.messages import Orders, Push, SampleReply, SampleRequest

RUN = "scale"
ENDPOINT = "tcp/127.0.0.1:7600"
CASES = (  # transport, actors, updates per insert
    ("memory", 16, 1 / 32),
    ("zenoh", 1, 1 / 32),
    ("zenoh", 4, 1 / 32),
    ("zenoh", 16, 1 / 32),
    ("zenoh", 64, 1 / 32),
    ("zenoh", 256, 1 / 32),
    ("zenoh", 4, Config().low.updates_per_insert),
)
TRAJECTORIES = 64  # distinct trajectories that the actors push in turn


class Actors:
    """Synthetic actors on one transport: each has an outbox and always more trajectories to push."""

    def __init__(self, transport: Transport, config: Config, count: int) -> None:
        rng, settings = np.random.default_rng(0), config.transport
        self._transport = transport
        self._trajectories = [make_trajectory(rng, LOW_STATE_SIZE) for _ in range(TRAJECTORIES)]
        self._next = 0
        self.outboxes = {
            f"actor-{index}": Outbox(
                Level.LOW,
                f"actor-{index}",
                index + 1,
                window_frames=settings.window_frames,
                resend_after_s=settings.resend_after_s,
                give_up_after_s=settings.give_up_after_s,
                make_frame=Push,
            )
            for index in range(count)
        }
        self._acks = Mailbox(settings.mailbox_bytes)
        transport.subscribe(keys.ack(RUN, keys.ANY), self._acks)

    def step(self, now: float) -> None:
        """Process acknowledgements, and push two trajectories per actor where there is credit."""
        for message in self._acks.drain():
            ack = codec.decode(message.payload)
            self.outboxes[ack.actor].on_ack(ack, now)
        for name, outbox in self.outboxes.items():
            for _ in range(2):
                trajectory = self._trajectories[self._next % TRAJECTORIES]
                if outbox.waiting < 2 * len(trajectory) and outbox.reserve(len(trajectory)):
                    outbox.offer([trajectory])
                    self._next += 1
            for frame in outbox.poll(now):
                self._transport.publish(keys.push(RUN, Level.LOW, name, frame.epoch), codec.encode(frame))


class Sampler:
    """Learner that receives batches and does not train on them."""

    def __init__(self, transport: Transport, mailbox_bytes: int) -> None:
        self.batches = 0
        self._transport = transport
        self._asked = 0
        self._box = Mailbox(mailbox_bytes)

    def step(self) -> None:
        """Decode the batches that have arrived, and request more."""
        for message in self._box.drain():
            reply = codec.decode(message.payload)
            self._asked -= BATCHES_AN_ANSWER
            if isinstance(reply, SampleReply) and reply.batch is not None:
                from_stored(reply.batch)  # as a learner does
                self.batches += reply.batches
        while self._asked + BATCHES_AN_ANSWER <= PREFETCH:
            request = codec.encode(SampleRequest(1, Level.LOW, self.batches, BATCHES_AN_ANSWER))
            self._transport.request(keys.sample(RUN, Level.LOW), request, self._box, timeout_s=10.0)
            self._asked += BATCHES_AN_ANSWER


def main() -> None:
    """Measure what the options say, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="shorter cases; ends within 50 s on two cores")
    parser.add_argument("--clients", type=int, nargs="+", metavar="N", help="measure so many clients at one hub")
    parser.add_argument("--processes", type=int, default=64, metavar="N", help="most processes that clients share")
    parser.add_argument("--shards", type=int, nargs="+", default=[1], metavar="N", help="shards of the replay")
    parser.add_argument("--rate", type=float, default=100.0, metavar="N", help="transitions a second of each client")
    parser.add_argument("--seconds", type=float, default=10.0, metavar="S", help="duration of each case")
    parser.add_argument("--points", type=Path, default=Path("scale.jsonl"), metavar="FILE", help="file of the figures")
    parser.add_argument("--fit", type=Path, metavar="FILE", help="print what runs need by the points of a file")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="with --fit: write a picture too")
    options = parser.parse_args()
    if options.fit is not None:
        fit(options.fit, options.plot)
    elif options.clients:
        measure_crowds(options)
    else:
        measure_parts(quick=options.quick)


def measure_crowds(options: argparse.Namespace) -> None:
    """Measure clients with a connection each, in every combination of numbers of clients and shards."""
    import _crowd  # forks, so nothing else may have been opened

    cases = [
        _crowd.Case(clients, min(clients, options.processes), shards, options.rate, options.seconds)
        for clients in options.clients
        for shards in options.shards
        if shards <= clients
    ]
    _crowd.run(cases, options.points, ENDPOINT)


def fit(file: Path, picture: Path | None) -> None:
    """Print the costs of each part by the points of a file, and what runs of several sizes need."""
    import _crowd
    import _scaling_model as model

    points = [json.loads(line) for line in file.read_text().splitlines()]
    figures: dict[str, float] = {}
    for part in model.COSTS:
        costs = model.fit(points, part)
        error = costs.pop("error")
        print(f"{part}: CPU microseconds, error {100 * error:.0f}%")
        print("".join(f"  {name:20}{1e6 * value:12.3g}\n" for name, value in costs.items()), end="")
        figures |= {f"{part}_{name}_us": 1e6 * value for name, value in costs.items()} | {f"{part}_error": error}
    if picture is not None:
        import _scaling_plot

        _scaling_plot.draw(points, _crowd.WEIGHTS_BYTES, picture)
    rate = points[-1]["rate"]
    for clients in (10, 100, 1000, 10000):
        needed = model.needs(points, clients, rate, 1 / _crowd.WEIGHTS_EVERY_S, _crowd.WEIGHTS_BYTES)
        figures |= {f"{name}_of_{clients}_actors": value for name, value in needed.items()}
    report("scale", figures, {})


def measure_parts(*, quick: bool) -> None:
    """Run the cases in one process and print their figures."""
    warm_up_s, measured_s = (0.5, 2.5) if quick else (2.0, 10.0)
    figures: dict[str, float] = {}
    ratios: dict[str, float] = {}
    print("transitions per second, and those that each part could sustain on a core of its own")
    print(f"{'case':34}{'all in one':>11}{'actors':>9}{'replay':>9}{'learner':>9}{'zenoh':>9}  saturates first")
    for kind, actors, updates_per_insert in CASES:
        name = f"{kind}_{actors}_actors_{updates_per_insert:.2g}_updates_an_insert".replace(".", "p")
        measured = run_case(kind, actors, updates_per_insert, warm_up_s, measured_s)
        cores = {part: measured["transitions"] / spent_s for part, spent_s in measured["cpu_s"].items()}
        first = min((part for part in cores if part != "actors"), key=cores.__getitem__)
        rate = measured["transitions"] / measured["wall_s"]
        columns = "".join(f"{cores[part]:9.0f}" if part in cores else f"{'-':>9}" for part in PARTS)
        print(f"{name.removesuffix('_updates_an_insert'):34}{rate:11.0f}{columns}  {first}")
        figures |= {f"{name}_transitions_per_s": rate, f"{name}_samples_per_insert": measured["samples_per_insert"]}
        figures |= {f"{name}_resent_frames": measured["resent_frames"]}
        figures |= {f"{name}_{part}_transitions_per_cpu_s": value for part, value in cores.items()}
    few, many = (f"zenoh_{actors}_actors_0p031_updates_an_insert_replay_transitions_per_cpu_s" for actors in (1, 256))
    ratios["replay_256_actors_vs_1"] = figures[many] / figures[few]
    report("scale", figures, ratios)


PARTS = ("actors", "replay", "learner", "zenoh")


def run_case(kind: str, actors: int, updates_per_insert: float, warm_up_s: float, measured_s: float) -> dict:
    """Return the number of transitions stored in `measured_s`, and the CPU seconds of each part for them."""
    config = parse({"run": {"actors": actors}, "low": {"updates_per_insert": updates_per_insert}})
    folder = tempfile.TemporaryDirectory()
    hub = ZenohHub(ENDPOINT) if kind == "zenoh" else None
    broker = MemoryBroker()
    transports = [MemoryTransport(broker) if hub is None else ZenohTransport(hub.endpoint) for _ in range(4)]
    try:
        replay_side, actor_side, learner_side, scheduler_side = transports
        context = Context(config, RUN, "replay", "0", 1, replay_side, threading.Event())
        replay = Replay(context, {Level.LOW: Shape(LOW_STATE_SIZE, LOW_ACTIONS)}, Path(folder.name))
        synthetic = Actors(actor_side, config, actors)
        sampler = Sampler(learner_side, config.transport.mailbox_bytes)
        orders = {
            "epochs": {name: outbox.epoch for name, outbox in synthetic.outboxes.items()},
            "buffer_size": config.replay.size_initial,
            "batch_size": config.replay.batch_initial,
            "stop": False,
        }
        key = keys.control(RUN, "replay")
        scheduler_side.publish(key, codec.encode(Orders(1, "replay", orders)), retained=True)
        steps: dict[str, Callable[[float], object]] = {
            "actors": synthetic.step,
            "replay": replay.step,
            "learner": lambda now: sampler.step(),
        }
        level_replay = replay.level_replays[Level.LOW]
        granted = config.agent.option_max_steps * config.run.cars_per_actor * actors  # credit ahead of the learner
        while level_replay.stored < granted:
            _step_in_turn(steps, warm_up_s)
        stored, sampled, began_s = level_replay.stored, level_replay.sampled, time.monotonic()
        cpu_s = _step_in_turn(steps, measured_s)
        if hub is None:
            del cpu_s["zenoh"]
        return {
            "transitions": level_replay.stored - stored,
            "samples_per_insert": (level_replay.sampled - sampled) / (level_replay.stored - stored),
            "resent_frames": sum(box.statistics()["resent_frames"] for box in synthetic.outboxes.values()),
            "wall_s": time.monotonic() - began_s,
            "cpu_s": cpu_s,
        }
    finally:
        folder.cleanup()
        for transport in transports:
            transport.close()
        if hub is not None:
            hub.close()


def _step_in_turn(steps: dict[str, Callable[[float], object]], seconds: float) -> dict[str, float]:
    """Step all parts in turn for `seconds`; return the CPU seconds of each, and of all other threads as `zenoh`."""
    spent_s = dict.fromkeys(steps, 0.0)
    process_s, thread_s = time.process_time(), time.thread_time()
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        for name, step in steps.items():
            began_s = time.thread_time()
            step(time.time())
            spent_s[name] += time.thread_time() - began_s
    others_s = time.process_time() - process_s - (time.thread_time() - thread_s)
    return spent_s | {"zenoh": others_s}


if __name__ == "__main__":
    main()
