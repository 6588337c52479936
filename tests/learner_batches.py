"""Random batches, and a mirror for their states and actions."""

import numpy as np

from zsdist.types import Batch, Mirror

STATE_SIZE, ACTIONS = 6, 5
MIRROR = Mirror(
    state_index=np.array([1, 0, 2, 3, 5, 4]),
    state_sign=np.array([1, 1, -1, 1, 1, 1], np.float32),
    action_index=np.array([0, 2, 1, 4, 3]),
)


def batch(seed, size=32):
    rng = np.random.default_rng(seed)
    masks = rng.random((size, ACTIONS)) < 0.8
    masks[:, 0] = True
    actions = np.where(masks[:, 3], 3, 0)
    return Batch(
        states=rng.normal(size=(size, STATE_SIZE)).astype(np.float32),
        actions=actions,
        rewards=rng.normal(size=size).astype(np.float32),
        discounts=np.where(rng.random(size) < 0.1, 0, 0.99).astype(np.float32),
        next_states=rng.normal(size=(size, STATE_SIZE)).astype(np.float32),
        next_masks=np.ones((size, ACTIONS), bool),
        masks=masks,
        guides=np.where(rng.random(size) < 0.5, 0, -1),
    )


def same_arrays(one, other):
    return one.keys() == other.keys() and all(np.array_equal(one[name], other[name]) for name in one)
