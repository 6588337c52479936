"""One deep Q-learner: a policy network, a target network and an optimiser, fed batches.

All weights of a network lie in one vector of which its tensors are views, so that the optimiser, the clipping and the
copy into the target network are one operation each, whatever the number of layers.
"""

import copy
from collections.abc import Iterable
from typing import NamedTuple, Protocol

import numpy as np
import torch

from zsdist.common.compiled import compiled
from zsdist.config import LevelConfig
from zsdist.dqn import losses, network, torch_network
from zsdist.errors import RunError, WeightsError
from zsdist.types import Batch, Parameters

_DISTIL_MARGIN_WEIGHT = 1.0
_BETAS, _ADAM_EPSILON = (0.9, 0.999), 1e-8


class Mirror(Protocol):
    """The left-right reflection of a state and its actions; applied twice it changes nothing.

    Attributes:
        state_index: `(D,)` int, feature that takes each feature's place.
        state_sign: `(D,)` float32, +1 or -1, applied after.
        action_index: `(A,)` int, action that takes each action's place.
    """

    state_index: np.ndarray
    state_sign: np.ndarray
    action_index: np.ndarray


class DqnLearner:
    """Learns one network from batches, one gradient step at a time.

    Equal seeds and equal batches give equal bits, on one thread and one kind of device.

    Args:
        state_size: features of a state, `D`.
        actions: number of actions, `A`.
        config: rates, losses and sizes.
        seed: of the initial weights and of which rows are reflected.
        mirror: reflects half of each batch; None: no augmentation.
        device: where to compute; None: CUDA where there is one, else the CPU.
    """

    def __init__(
        self,
        state_size: int,
        actions: int,
        config: LevelConfig,
        seed: int,
        mirror: Mirror | None = None,
        device: str | torch.device | None = None,
    ) -> None:
        self.updates = 0
        self._last: _Step | None = None
        self._state_size, self._actions = state_size, actions
        self._config = config
        self._mirror = mirror
        self._rng = np.random.default_rng([seed, 1])
        self._device = torch.device(device or ("cuda" if torch.cuda.is_available() else "cpu"))
        parameters = network.initial_parameters(state_size, actions, config.hidden, seed)
        self._online = torch_network.policy_network(parameters).to(self._device)
        self._target = torch_network.target_network(parameters).to(self._device)
        self._weights, self._gradient = _flatten(self._online)
        self._target_weights, _ = _flatten(self._target)
        self._restart_optimiser()

    def fits(self, batch: Batch) -> bool:
        """Whether `batch` is of this network's states and actions."""
        return (batch.states.shape[1], batch.masks.shape[1]) == (self._state_size, self._actions)

    def update(self, batch: Batch) -> None:
        """One gradient step of the policy network on `batch`, then a soft copy into the target network: Eq. (11).

        Deviation: Adam with a clipped gradient in place of the plain step; Huber loss where so configured.
        """
        self._last = self._step(batch, self._config.guide_margin_weight)
        if self._config.target_tau:
            self._target_weights.lerp_(self._weights, self._config.target_tau)
        self.updates += 1

    def figures(self) -> dict[str, float]:
        """Of the last update: `loss` before weighting, `q_mean` of all actions, `gradient_norm` before clipping.

        Before any update: nothing. Asked for apart, since they take a while.
        """
        if self._last is None:
            return {}
        last, config = self._last, self._config
        loss = losses.td_loss(last.errors, config.huber)
        if config.guide_margin_weight:
            margin = losses.margin_loss(last.q, last.masks, last.guides, config.guide_margin)
            loss += config.guide_margin_weight * margin
        return {"loss": loss, "q_mean": float(last.q.mean()), "gradient_norm": last.gradient_norm}

    def errors(self) -> np.ndarray:
        """Absolute temporal-difference errors of the rows of the last update's batch, `(B,)` float32.

        Asked for apart, as `figures` are.

        Raises:
            RunError: there has been no update.
        """
        if self._last is None:
            raise RunError("errors of the last update were asked for; there has been none")
        return np.abs(self._last.errors)

    def distilled(self, batches: Iterable[Batch]) -> Parameters:
        """Parameters of a copy that took one step on each of `batches` with the large-margin loss on guide actions.

        The temporal-difference loss stays on beside it, so that values keep their scale. This learner is unchanged.
        """
        student = copy.copy(self)
        student._rng = copy.deepcopy(self._rng)
        student._online = torch_network.policy_network(self.parameters()).to(self._device)
        student._weights, student._gradient = _flatten(student._online)
        student._restart_optimiser()
        for batch in batches:
            student._step(batch, _DISTIL_MARGIN_WEIGHT)
        return student.parameters()

    def promote(self, parameters: Parameters, reset_online: bool) -> None:
        """Makes `parameters` the target network; with `reset_online` the policy network too, with a new optimiser.

        Raises:
            WeightsError: they belong to another network.
        """
        self._load(self._target, parameters)
        if reset_online:
            self._load(self._online, parameters)
            self._restart_optimiser()

    def parameters(self) -> Parameters:
        """A copy of the policy network's parameters."""
        return self._online.parameters_numpy()

    def target_parameters(self) -> Parameters:
        """A copy of the target network's parameters."""
        return self._target.parameters_numpy()

    def state(self) -> dict[str, np.ndarray]:
        """All that the next update depends on: a learner that restores it goes on as if it had never stopped."""
        arrays = {f"online/{name}": value for name, value in self.parameters().items()}
        arrays |= {f"target/{name}": value for name, value in self.target_parameters().items()}
        arrays |= {f"adam/{name}": value.cpu().numpy().copy() for name, value in self._adam.items()}
        return arrays | {"updates": np.array(self.updates, np.int64), "generator": _generator_words(self._rng)}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Takes over a `state()`.

        Raises:
            RunError: an entry is missing or misshapen.
            WeightsError: its weights belong to another network.
        """
        expected = {name: value.shape for name, value in self.state().items() if "/" not in name or "adam/" in name}
        for name, shape in expected.items():
            found = np.shape(state[name]) if name in state else "missing"
            if found != shape:
                raise RunError(f"learner state {name} is {found}; allowed is an array of shape {shape}")
        for prefix, module in (("online/", self._online), ("target/", self._target)):
            self._load(module, {k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)})
        for name, value in self._adam.items():
            value.copy_(torch.from_numpy(np.array(state[f"adam/{name}"])))
        self.updates = int(state["updates"])
        _set_generator(self._rng, state["generator"])

    @torch.inference_mode()
    def _step(self, batch: Batch, margin_weight: float) -> "_Step":
        config, size = self._config, len(batch)
        columns = joined(batch)
        if self._mirror is not None:
            reflect(columns, self._mirror, self._rng.random(size) < 0.5)
        states = torch.from_numpy(columns.states).to(self._device)
        # Double Q-learning asks the policy network of the next states too: one pass for both.
        values, trace = self._online.traced(states if config.double else states[:size])
        target_q = self._target(states[size:]).cpu().numpy()
        values = values.cpu().numpy()
        q = values[:size]
        errors, gradient = _gradient(
            q,
            columns.actions,
            columns.masks[:size],
            columns.guides,
            losses.td_targets(
                batch.rewards * np.float32(config.reward_scale),
                batch.discounts,
                target_q,
                columns.masks[size:],
                values[size:] if config.double else None,
            ),
            config.huber,
            config.guide_margin,
            margin_weight,
        )
        if batch.weights is not None:  # drawn by priority: each row counts as much as its importance weight
            gradient *= batch.weights[:, None]
        self._online.backward(torch.from_numpy(gradient).to(self._device), trace)
        norm = torch.linalg.vector_norm(self._gradient).item()
        shrink = np.float32(config.max_gradient_norm) * (1 / (np.float32(norm) + np.float32(1e-6)))
        if shrink < 1:
            self._gradient.mul_(float(shrink))
        self._adam["step"] += 1
        torch._fused_adam_(  # without the class and the function around it, which take three times as long
            [self._weights],
            [self._gradient],
            [self._adam["exp_avg"]],
            [self._adam["exp_avg_sq"]],
            [],
            [self._adam["step"]],
            lr=config.learning_rate,
            beta1=_BETAS[0],
            beta2=_BETAS[1],
            weight_decay=0.0,
            eps=_ADAM_EPSILON,
            amsgrad=False,
            maximize=False,
        )
        return _Step(q, errors, columns.masks[:size], columns.guides, norm)

    def _load(self, module: torch_network.QNetwork, parameters: Parameters) -> None:
        network.check(parameters, self._state_size, self._actions)
        for name, tensor in zip(module.names, module.tensors, strict=True):
            if name not in parameters or tuple(tensor.shape) != parameters[name].shape:
                found = parameters[name].shape if name in parameters else "missing"
                raise WeightsError(f"network weight {name} is {found}; allowed is shape {tuple(tensor.shape)}")
            tensor.data.copy_(torch.from_numpy(parameters[name]))

    def _restart_optimiser(self) -> None:
        self._adam = {
            "step": torch.zeros((), device=self._device),
            "exp_avg": torch.zeros_like(self._weights),
            "exp_avg_sq": torch.zeros_like(self._weights),
        }


class _Step(NamedTuple):
    """What is left of a gradient step, for those who ask."""

    q: np.ndarray
    errors: np.ndarray
    masks: np.ndarray
    guides: np.ndarray
    gradient_norm: float


class Columns(NamedTuple):
    """What of a batch of `B` rows a reflection changes; an array's first `B` rows are of `t`, the others of `t + 1`.

    Attributes:
        states: `(2 B, D)` float32.
        masks: `(2 B, A)` bool.
        actions: `(B,)` int64.
        guides: `(B,)` int64.
    """

    states: np.ndarray
    masks: np.ndarray
    actions: np.ndarray
    guides: np.ndarray


def joined(batch: Batch) -> Columns:
    """A copy of these columns."""
    return Columns(
        np.concatenate((batch.states, batch.next_states)),
        np.concatenate((batch.masks, batch.next_masks)),
        batch.actions.copy(),
        batch.guides.copy(),
    )


def reflect(columns: Columns, mirror: Mirror, rows: np.ndarray) -> None:
    """Reflects the given rows (`(B,)` bool) left to right where they are."""
    _reflect(*columns, rows, mirror.state_index, mirror.state_sign, mirror.action_index)


@compiled()
def _reflect(states, masks, actions, guides, rows, index, sign, swap):  # noqa: ANN001, ANN202
    for row in np.flatnonzero(rows):
        actions[row] = swap[actions[row]]
        if guides[row] >= 0:
            guides[row] = swap[guides[row]]
        for at in (row, row + len(rows)):
            before, allowed = states[at].copy(), masks[at].copy()
            for feature in range(len(index)):
                states[at, feature] = before[index[feature]] * sign[feature]
            for action in range(len(swap)):
                masks[at, action] = allowed[swap[action]]


@compiled()
def _gradient(  # noqa: ANN202
    q: np.ndarray,
    actions: np.ndarray,
    masks: np.ndarray,
    guides: np.ndarray,
    targets: np.ndarray,
    huber: bool,
    margin: float,
    margin_weight: float,
):
    """Errors `(B,)`, and the gradient `(B, A)` of the losses with respect to `q`; without the mean's weights."""
    errors = losses.td_error(q, actions, targets)
    gradient = losses.td_gradient(q, actions, errors, huber)
    if margin_weight:
        weight = np.float64(np.float32(margin_weight))  # the sum is rounded once
        gradient = (gradient + weight * losses.margin_gradient(q, masks, guides, margin)).astype(np.float32)
    return errors, gradient


def _flatten(module: torch_network.QNetwork) -> tuple[torch.Tensor, torch.Tensor]:
    """Moves a network's weights and gradients into two vectors of which its tensors become views."""
    weights = torch.cat([tensor.detach().reshape(-1) for tensor in module.tensors])
    gradient = torch.zeros_like(weights)
    start = 0
    for tensor in module.tensors:
        stop = start + tensor.numel()
        tensor.data = weights[start:stop].view_as(tensor)
        if tensor.requires_grad:
            tensor.grad = gradient[start:stop].view_as(tensor)
        start = stop
    weights.grad = gradient
    return weights, gradient


def _generator_words(rng: np.random.Generator) -> np.ndarray:
    """State of a PCG64 generator as `(6,)` uint64: two 128-bit numbers and the cached half draw."""
    state = rng.bit_generator.state
    low = 2**64 - 1
    words = [half for key in ("state", "inc") for half in divmod(state["state"][key], low + 1)]
    return np.array([*words, state["has_uint32"], state["uinteger"]], np.uint64)


def _set_generator(rng: np.random.Generator, words: np.ndarray) -> None:
    high, low, inc_high, inc_low, has_uint32, uinteger = (int(word) for word in words)
    rng.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {"state": high << 64 | low, "inc": inc_high << 64 | inc_low},
        "has_uint32": has_uint32,
        "uinteger": uinteger,
    }
