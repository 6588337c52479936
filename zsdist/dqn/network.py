"""Q-network in numpy, used by actors; `torch_network` has the form used by learners.

Shapes: `B` states, `D` features, `A` actions. Each hidden layer is linear, layer-normalised, then ReLU. With the
paper's learning rate of 0.002 the normalisation bounds activations, and so values far from the data.
"""

import hashlib
from collections.abc import Sequence

import numpy as np

from zsdist.common import random_streams
from zsdist.errors import WeightsError
from zsdist.types import Parameters

NORM_EPSILON = 1e-5
_OUTPUT_SCALE = 0.1  # initial values near zero, so that the first targets are the rewards


def initial_parameters(state_size: int, actions: int, hidden: Sequence[int], seed: int) -> Parameters:
    """Return initial parameters: He-uniform weights, zero biases, a small output layer; equal for equal seeds."""
    rng = random_streams.initial_weights(seed)
    parameters: Parameters = {}
    fan_in = state_size
    for i, width in enumerate(hidden):
        parameters[f"hidden{i}.weight"] = _he_uniform(rng, width, fan_in)
        parameters[f"hidden{i}.bias"] = np.zeros(width, np.float32)
        parameters[f"hidden{i}.norm_scale"] = np.ones(width, np.float32)
        parameters[f"hidden{i}.norm_shift"] = np.zeros(width, np.float32)
        fan_in = width
    parameters["output.weight"] = _he_uniform(rng, actions, fan_in) * np.float32(_OUTPUT_SCALE)
    parameters["output.bias"] = np.zeros(actions, np.float32)
    return parameters


def apply(parameters: Parameters, states: np.ndarray) -> np.ndarray:
    """Return the values `(B, A)` float32 of `states` `(B, D)` float32, without torch."""
    x = states
    for i in range(depth(parameters)):
        x = x @ parameters[f"hidden{i}.weight"].T
        x += parameters[f"hidden{i}.bias"]
        x -= _row_means(x)
        x /= np.sqrt(_row_means(x * x) + np.float32(NORM_EPSILON))
        x *= parameters[f"hidden{i}.norm_scale"]
        x += parameters[f"hidden{i}.norm_shift"]
        np.maximum(x, 0, out=x)
    return x @ parameters["output.weight"].T + parameters["output.bias"]


def greedy(q: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return the best allowed action of each row, `(B,)` int64; the lowest number wins a tie.

    Args:
        q: `(B, A)` values.
        mask: `(B, A)` bool, allowed actions; each row must allow one.

    Raises:
        ValueError: a row allows no action.
    """
    if not mask.any(axis=1).all():
        raise ValueError(f"row {int(np.argmin(mask.any(axis=1)))} of the mask allows no action; at least one is needed")
    best: np.ndarray = np.where(mask, q, -np.inf).argmax(axis=1)
    return best


def check(parameters: Parameters, state_size: int, actions: int) -> None:
    """Check that these are finite float32 weights of a network from `state_size` features to `actions` values.

    Raises:
        WeightsError: a weight is missing, superfluous, misshapen or not finite float32; the message names the first.
    """
    expected = _shapes(parameters, state_size, actions)
    if set(parameters) != set(expected):
        raise WeightsError(f"network weights are named {sorted(parameters)}; allowed are exactly {sorted(expected)}")
    for name, shape in expected.items():
        value = parameters[name]
        if value.shape != shape or value.dtype != np.float32:
            raise WeightsError(
                f"network weight {name} is {value.dtype} of shape {value.shape}; allowed is float32 of shape {shape}"
            )
        if not np.isfinite(value).all():
            raise WeightsError(f"network weight {name} holds values that are not finite; allowed are finite ones")


def sha256(parameters: Parameters) -> str:
    """Return the hex digest of the parameters' names, shapes and values, whatever the order of names."""
    digest = hashlib.sha256()
    for name in sorted(parameters):
        value = np.ascontiguousarray(parameters[name], dtype="<f4")
        digest.update(f"{name}{value.shape}".encode())
        digest.update(value.tobytes())
    return digest.hexdigest()


def _he_uniform(rng: np.random.Generator, fan_out: int, fan_in: int) -> np.ndarray:
    bound = np.sqrt(6.0 / fan_in)
    return rng.uniform(-bound, bound, (fan_out, fan_in)).astype(np.float32)


def _row_means(x: np.ndarray) -> np.ndarray:
    """Return the mean of each row, `(B, 1)`, without the checks of `np.mean`, which take longer than the sum."""
    return np.add.reduce(x, 1, keepdims=True) / np.float32(x.shape[1])


def depth(parameters: Parameters) -> int:
    """Return the number of hidden layers of a network."""
    return sum(name.endswith(".norm_scale") for name in parameters)


def _shapes(parameters: Parameters, state_size: int, actions: int) -> dict[str, tuple[int, ...]]:
    """Return the names and shapes of a network with these hidden layers; the sizes of its biases give the widths."""
    shapes: dict[str, tuple[int, ...]] = {}
    fan_in = state_size
    for i in range(depth(parameters)):
        width = np.size(parameters.get(f"hidden{i}.bias", ()))
        shapes[f"hidden{i}.weight"] = (width, fan_in)
        shapes |= {f"hidden{i}.{part}": (width,) for part in ("bias", "norm_scale", "norm_shift")}
        fan_in = width
    return shapes | {"output.weight": (actions, fan_in), "output.bias": (actions,)}
