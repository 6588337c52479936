"""Updates a second of a learner, by network and batch size, and of both levels, compared with a plain torch loop.

`python benchmarks/learner.py [--quick]` prints a table, then one JSON line. `fused_vs_reference` is the CPU time of the
autograd reference divided by that of the fused learner, with the default configuration. The `fed` figures are of the
whole learner role, fed over zenoh by a replay in another process that always has batches to give: its updates a second,
its share of time without a batch, and the time until an actor that joins late has the weights.
"""

import argparse
import json
import os
import platform
import statistics
import threading
import time
from collections.abc import Callable

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import torch
from _replay import RUN, Actors, ReplayService

from zsdist.agent import features
from zsdist.config import Config, LevelConfig, parse
from zsdist.dqn import network, torch_network
from zsdist.dqn.fused import FusedDqnLearner
from zsdist.dqn.learner import DqnLearner
from zsdist.roles.base import Context
from zsdist.roles.learner import Learner
from zsdist.run import program
from zsdist.transport.base import Mailbox
from zsdist.transport.zenoh import ZenohTransport
from zsdist.types import Batch, Level
from zsdist.wire import keys

ACTIONS = 5
CASES = (  # name, state features, hidden, batch size
    ("features40_batch128", 40, (128, 128), 128),
    ("features120_batch128", 120, (128, 128), 128),
    ("features120_batch256", 120, (128, 128), 256),
    ("features120_batch16", 120, (128, 128), 16),
)
STORED = 4_000  # number of transitions in the replay of the fed learner
JOINERS = 9
Update = Callable[[Batch], object]


def main() -> None:
    """Run the cases and print their figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer repeats, within 50 s on two cores")
    quick = parser.parse_args().quick
    torch.set_num_threads(1)
    repeats, updates = (3, 150) if quick else (9, 400)
    device = "cuda" if torch.cuda.is_available() else "cpu"
    figures, ratios = {}, {}
    print(f"{'case':24s} {'zsdist updates/s':>18s} {'plain torch updates/s':>22s} {'ratio':>7s}")
    for name, state_size, hidden, batch_size in CASES:
        batches = make_batches(state_size, batch_size)
        config = LevelConfig(hidden=hidden)
        ours = FusedDqnLearner(state_size, ACTIONS, config, seed=0).update
        plain = plain_torch(state_size, config, device)
        pairs = [(rate(ours, batches, updates), rate(plain, batches, updates)) for _ in range(repeats + 1)][1:]
        ours_rate, plain_rate = (statistics.median(column) for column in zip(*pairs, strict=True))
        figures[f"{name}_updates_per_s"] = round(ours_rate, 1)
        ratios[f"{name}_update_vs_plain_torch"] = round(statistics.median(a / b for a, b in pairs), 3)
        print(f"{name:24s} {ours_rate:18.0f} {plain_rate:22.0f} {ours_rate / plain_rate:7.2f}")
    for name, ratio in fused_vs_reference(updates, repeats).items():
        ratios[name] = round(ratio, 3)
        print(f"{name:40s} {ratio:8.2f}")
    for name, figure in default_levels(updates, repeats).items():
        figures[name] = round(figure, 1)
        print(f"{name:40s} {figure:8.0f}")
    for name, figure in fed(updates).items():
        figures[name] = round(figure, 4)
        print(f"{name:40s} {figure:8.4g}")
    parameters = network.initial_parameters(CASES[1][1], ACTIONS, CASES[1][2], seed=0)
    for cars in (1, 4, 16):
        states = np.random.default_rng(0).normal(size=(cars, CASES[1][1])).astype(np.float32)
        started = time.perf_counter()
        for _ in range(500):
            network.apply(parameters, states)
        figures[f"act_batch{cars}_us"] = round((time.perf_counter() - started) / 500 * 1e6, 1)
        print(f"acting on {cars:2d} states: {figures[f'act_batch{cars}_us']:.0f} us")
    machine = {"cpus": os.cpu_count(), "processor": platform.machine(), "device": device, "torch": torch.__version__}
    print(json.dumps({"subject": "learner", "machine": machine, "figures": figures, "ratios": ratios}))


def fused_vs_reference(updates: int, repeats: int) -> dict[str, float]:
    """Return the CPU time of the reference divided by that of the fused learner, by level and batch size."""
    ratios, config = {}, Config()
    for level, shape in program.SHAPES.items():
        settings, mirror = config.high if level is Level.HIGH else config.low, features.mirror(level)
        fused, reference = (
            kind(shape.state_size, shape.actions, settings, seed=0, mirror=mirror)
            for kind in (FusedDqnLearner, DqnLearner)
        )
        for batch_size in (16, 128):
            batches = make_batches(shape.state_size, batch_size, shape.actions)
            pairs = [
                (cpu_s(reference.update, batches, updates), cpu_s(fused.update, batches, updates))
                for _ in range(repeats + 1)
            ][1:]
            name = f"{level}_batch{batch_size}_fused_vs_reference"
            ratios[name] = statistics.median(slow / fast for slow, fast in pairs)
    return ratios


def default_levels(updates: int, repeats: int) -> dict[str, float]:
    """Return updates a second with the default configuration: each level alone, and both in turn."""
    learners = {level: program.make_learner(Config(), level) for level in Level}
    batches = {level: make_batches(shape.state_size, 128, shape.actions) for level, shape in program.SHAPES.items()}
    rates: dict[str, list[float]] = {name: [] for name in (*Level, "both")}
    for _ in range(repeats):
        for level in Level:
            rates[level].append(rate(learners[level].update, batches[level], updates))
        in_turn = [
            pair
            for level_batches in zip(*batches.values(), strict=True)
            for pair in zip(Level, level_batches, strict=True)
        ]
        rates["both"].append(rate(lambda pair: learners[pair[0]].update(pair[1]), in_turn, updates))
    return {f"default_{name}_batch128_updates_per_s": statistics.median(each) for name, each in rates.items()}


def fed(updates: int) -> dict[str, float]:
    """Return updates a second of the low level's role, its share of time without a batch, and waits of late joiners."""
    shape = program.SHAPES[Level.LOW]
    low = {"min_size": STORED, "updates_per_insert": 10_000.0}
    config = parse({"high": {"min_size": 10**9}, "low": low, "replay": {"size_initial": STORED}})
    with ReplayService(config, shape.state_size) as service:
        transport, wake = ZenohTransport(service.endpoint), threading.Event()
        actors = Actors(transport, config, Level.LOW, {"actor-0": 1}, shape.state_size)
        service.admit({"actor-0": 1})
        while actors.produced < STORED:
            actors.run(0.1, ahead=256)
        context = Context(config, RUN, "learner", "low", 2, transport, wake)
        learner = Learner(context, Level.LOW, program.make_learner(config, Level.LOW))
        _drive(learner, wake, updates)  # by now the replay has caught up, and kernels are compiled
        before, began_s = learner.statistics(), time.monotonic()
        _drive(learner, wake, learner.updates + 3 * updates)
        wall_s, after = time.monotonic() - began_s, learner.statistics()
        joined_ms = [_join(service.endpoint) for _ in range(JOINERS)]
        transport.close()
    return {
        "fed_updates_per_s": 3 * updates / wall_s,
        "fed_waiting_share": (after["waiting_data_s"] - before["waiting_data_s"]) / wall_s,
        "late_joiner_median_ms": statistics.median(joined_ms),
        "late_joiner_worst_ms": max(joined_ms),
    }


def _drive(learner: Learner, wake: threading.Event, updates: int) -> None:
    while learner.updates < updates:
        due_s = learner.step(time.time())
        wake.wait(max(0.0, due_s - time.time()))
        wake.clear()


def _join(endpoint: str) -> float:
    """Return the milliseconds from subscribing to the arrival of weights that were published before."""
    transport, come = ZenohTransport(endpoint), threading.Event()
    began_s = time.perf_counter()
    transport.subscribe(keys.weights(RUN, Level.LOW), Mailbox(1 << 26, come.set), retained=True)
    if not come.wait(10.0):
        raise SystemExit("no weights arrived within 10 s")
    joined_ms = (time.perf_counter() - began_s) * 1e3
    transport.close()
    return joined_ms


def make_batches(state_size: int, batch_size: int, actions: int = ACTIONS) -> list[Batch]:
    """Return 16 random batches of these shapes."""
    rng = np.random.default_rng(0)
    return [
        Batch(
            states=rng.normal(size=(batch_size, state_size)).astype(np.float32),
            actions=rng.integers(0, actions, batch_size),
            rewards=rng.normal(size=batch_size).astype(np.float32),
            discounts=np.full(batch_size, 0.99, np.float32),
            next_states=rng.normal(size=(batch_size, state_size)).astype(np.float32),
            next_masks=np.ones((batch_size, actions), bool),
            masks=np.ones((batch_size, actions), bool),
            guides=rng.integers(-1, actions, batch_size),
        )
        for _ in range(16)
    ]


def rate(update: Callable, batches: list, updates: int) -> float:
    """Return updates a second, measured over `updates` of them."""
    started = time.perf_counter()
    for i in range(updates):
        update(batches[i % len(batches)])
    return updates / (time.perf_counter() - started)


def cpu_s(update: Update, batches: list[Batch], updates: int) -> float:
    """Return the CPU seconds of `updates` updates."""
    started = time.process_time()
    for i in range(updates):
        update(batches[i % len(batches)])
    return time.process_time() - started


def plain_torch(state_size: int, config: LevelConfig, device: str) -> Update:
    """Return the same update in its usual form: default Adam, `clip_grad_norm_`, and a soft copy tensor by tensor."""
    parameters = network.initial_parameters(state_size, ACTIONS, config.hidden, seed=0)
    online = torch_network.policy_network(parameters).to(device)
    target = torch_network.target_network(parameters).to(device)
    optimiser = torch.optim.Adam(online.parameters(), lr=config.learning_rate)

    def update(batch: Batch) -> float:
        columns = {
            name: torch.from_numpy(column).to(device) for name, column in vars(batch).items() if column is not None
        }
        with torch.no_grad():
            chosen = online(columns["next_states"]).masked_fill(~columns["next_masks"], -torch.inf).argmax(1)
            following = target(columns["next_states"]).gather(1, chosen[:, None])[:, 0]
            targets = columns["rewards"] + columns["discounts"] * following
        columns |= {"q": online(columns["states"])}
        values = columns["q"].gather(1, columns["actions"][:, None])[:, 0]
        loss = torch.nn.functional.smooth_l1_loss(values, targets)
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(online.parameters(), config.max_gradient_norm)
        optimiser.step()
        with torch.no_grad():
            for old, new in zip(target.parameters(), online.parameters(), strict=True):
                old.lerp_(new, config.target_tau)
        return loss.item()

    return update


if __name__ == "__main__":
    main()
