"""Transitions encoded and decoded per CPU second, and bytes per transition, by state size and frame size.

`python benchmarks/wire.py [--quick]` prints a table, then one JSON line. The reference is pickle of the same frame
at the same zstd level: what a program without its own format would send, without any check of what it decodes.
`float32_pairs` is the uncompressed size of state and next state: a transition of 256 features has 2,048 bytes.
"""

import argparse
import os
import pickle
import statistics
import time
from collections.abc import Callable

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import zstandard
from _common import report

from zsdist.agent.features import HIGH_STATE_SIZE, LOW_STATE_SIZE
from zsdist.types import NO_GUIDE, Behaviour, Level, Trajectory
from zsdist.wire.codec import decode, encode
from zsdist.wire.messages import Push

ACTIONS = 5
LENGTH = 8  # number of transitions per trajectory
CASES = (  # name, state features, transitions per frame
    ("low_frame16", LOW_STATE_SIZE, 16),
    ("low_frame64", LOW_STATE_SIZE, 64),
    ("low_frame256", LOW_STATE_SIZE, 256),
    ("high_frame64", HIGH_STATE_SIZE, 64),
    ("features256_frame16", 256, 16),
    ("features256_frame64", 256, 64),
    ("features512_frame64", 512, 64),
    ("features512_frame256", 512, 256),
)


def main() -> None:
    """Run the cases and print their figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer repeats, within 50 s on two cores")
    repeats, target_s = (5, 0.1) if parser.parse_args().quick else (15, 0.3)
    figures: dict[str, float] = {}
    ratios: dict[str, float] = {}
    print(f"{'case':22s} {'features':>8s} {'encode/s':>10s} {'decode/s':>10s} {'bytes':>7s} {'pickle bytes':>13s}")
    for name, state_size, transitions in CASES:
        frame = make_frame(np.random.default_rng(0), state_size, transitions)
        payload, pickled = encode(frame), pickle_pairs(frame)
        functions = (
            lambda frame=frame: encode(frame),
            lambda frame=frame: pickle_pairs(frame),
            lambda payload=payload: decode(payload),
            lambda pickled=pickled: unpickle(pickled),
        )
        rates = [[rate(function, transitions, target_s) for function in functions] for _ in range(repeats + 1)][1:]
        encoded, pickle_encoded, decoded, pickle_decoded = (
            statistics.median(column) for column in zip(*rates, strict=True)
        )
        sizes = len(payload) / transitions, len(pickled) / transitions
        print(f"{name:22s} {state_size:8d} {encoded:10.0f} {decoded:10.0f} {sizes[0]:7.0f} {sizes[1]:13.0f}")
        figures[f"{name}_encode_transitions_per_s"] = round(encoded)
        figures[f"{name}_decode_transitions_per_s"] = round(decoded)
        figures[f"{name}_bytes_per_transition"] = round(sizes[0], 1)
        ratios[f"{name}_encode_vs_pickle_zstd"] = encoded / pickle_encoded
        ratios[f"{name}_decode_vs_pickle_zstd"] = decoded / pickle_decoded
        ratios[f"{name}_compactness_vs_pickle_zstd"] = sizes[1] / sizes[0]
        ratios[f"{name}_compactness_vs_float32_pairs"] = 8 * state_size / sizes[0]
    report("wire", figures, ratios)


def make_frame(rng: np.random.Generator, state_size: int, transitions: int) -> Push:
    """Return a frame of random trajectories; a third of the features are flags, the others change slowly."""
    trajectories = tuple(make_trajectory(rng, state_size) for _ in range(transitions // LENGTH))
    return Push(Level.LOW, "a0", 1, 0, transitions, False, trajectories)


def make_trajectory(rng: np.random.Generator, state_size: int) -> Trajectory:
    """Return a random trajectory of `LENGTH` transitions."""
    states = rng.normal(size=state_size) + np.cumsum(rng.normal(size=(LENGTH + 1, state_size)) * 0.05, axis=0)
    flags = state_size // 3
    states[:, :flags] = rng.random((LENGTH + 1, flags)) < 0.2
    actions, guides = rng.integers(0, ACTIONS, LENGTH), rng.integers(NO_GUIDE, ACTIONS, LENGTH)
    masks = rng.random((LENGTH + 1, ACTIONS)) < 0.8
    masks[np.arange(LENGTH), actions] = masks[np.arange(LENGTH), np.maximum(guides, 0)] = True  # allowed
    masks[LENGTH, 0] = True
    return Trajectory(
        level=Level.LOW,
        states=states.astype(np.float32),
        actions=actions.astype(np.uint8),
        rewards=rng.normal(size=LENGTH).astype(np.float32),
        discounts=np.full(LENGTH, 0.99, np.float32),
        successors=np.arange(1, LENGTH + 1, dtype=np.uint16),
        masks=masks,
        guides=guides.astype(np.int8),
        behaviours=rng.integers(0, len(Behaviour), LENGTH).astype(np.uint8),
        weight_version=3,
    )


def pickle_pairs(frame: Push) -> bytes:
    """Return the same transitions pickled and compressed: state and next state of each in float32."""
    columns = [
        np.concatenate([getattr(trajectory, name)[cut] for trajectory in frame.trajectories])
        for name, cut in (
            ("states", slice(None, -1)),
            ("states", slice(1, None)),
            ("masks", slice(None, -1)),
            ("masks", slice(1, None)),
            *((name, slice(None)) for name in ("actions", "rewards", "discounts", "guides", "behaviours")),
        )
    ]
    return zstandard.ZstdCompressor(level=1).compress(pickle.dumps(columns, protocol=5))


def unpickle(payload: bytes) -> object:
    """Return the columns that `pickle_pairs` pickled."""
    return pickle.loads(zstandard.ZstdDecompressor().decompress(payload))


def rate(function: Callable[[], object], transitions: int, target_s: float) -> float:
    """Return the transitions per CPU second of calls repeated for about `target_s`."""
    calls, started = 0, time.process_time()
    while (passed := time.process_time() - started) < target_s:
        function()
        calls += 1
    return calls * transitions / passed


if __name__ == "__main__":
    main()
