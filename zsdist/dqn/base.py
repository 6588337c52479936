"""Base of the deep Q-learners: networks, optimiser state, checkpoints and promotion; subclasses make the gradient step.

All weights of a network lie in one vector, and its tensors are views of that vector. So the optimiser, the clipping and
the copy into the target network are one operation each, whatever the number of layers.
"""

import contextlib
import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from typing import NamedTuple, Self

import numpy as np
import torch

from zsdist.common import random_streams
from zsdist.config import LevelConfig
from zsdist.dqn import losses, network, soundness, torch_network
from zsdist.dqn.batches import StackedBatch
from zsdist.dqn.soundness import Quantity, UnsoundUpdateError
from zsdist.errors import RunError, WeightsError
from zsdist.types import Batch, Mirror, Parameters

_DISTIL_MARGIN_WEIGHT = 1.0


class GradientStep(NamedTuple):
    """Results of one gradient step. All but the norm belong to the batch's rows after some of them were reflected.

    Attributes:
        q: `(B, A)` float32, values before the step.
        errors: `(B,)` float32, temporal-difference errors before the step.
        masks: `(B, A)` bool, allowed actions.
        guides: `(B,)` int64, actions of the guide; negative: none.
        gradient_norm: norm of the gradient before clipping.
    """

    q: np.ndarray
    errors: np.ndarray
    masks: np.ndarray
    guides: np.ndarray
    gradient_norm: float


class BaseDqnLearner(ABC):
    """Learner of one network from batches, one gradient step at a time.

    Equal seeds and equal batches give bit-identical weights, on one thread and one kind of device.

    Args:
        state_size: features of a state, `D`.
        actions: number of actions, `A`.
        config: rates, losses and sizes.
        seed: seed of the initial weights and of the choice of rows to reflect.
        mirror: left-right reflection of states and actions, applied to half of each batch; None: no augmentation.
        device: device to compute on; None: CUDA if there is one, else the CPU.

    Attributes:
        updates: number of gradient steps so far.
        limit: magnitude that no value and no error may exceed in an update.
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
        self.updates, self.limit = 0, math.inf
        self._last: GradientStep | None = None
        self._state_size, self._actions = state_size, actions
        self._config = config
        self._mirror = mirror
        self._rng = random_streams.reflected_rows(seed)
        self._device = torch.device(device or ("cuda" if torch.cuda.is_available() else "cpu"))
        parameters = network.initial_parameters(state_size, actions, config.hidden, seed)
        self._online = torch_network.policy_network(parameters).to(self._device)
        self._target = torch_network.target_network(parameters).to(self._device)
        self._weights, self._gradient = _flatten(self._online)
        self._target_weights, _ = _flatten(self._target)
        self._restart_optimiser()

    def fits(self, batch: Batch) -> bool:
        """Tell whether `batch` has this network's number of state features and actions."""
        return (batch.states.shape[1], batch.masks.shape[1]) == (self._state_size, self._actions)

    def update(self, batch: Batch) -> None:
        """Make one gradient step of the policy network, then move the target network towards it by `target_tau`.

        Raises:
            UnsoundUpdateError: the step would compute a number that is not finite, or a value or error beyond `limit`;
                nothing has changed.
        """
        drawn = None if self._mirror is None else self._rng.bit_generator.state
        try:
            self._last = self._gradient_step(batch, self._config.guide_margin_weight)
        except UnsoundUpdateError:
            if drawn is not None:
                self._rng.bit_generator.state = drawn
            raise
        if self._config.target_tau:
            self._target_weights.lerp_(self._weights, self._config.target_tau)
        self.updates += 1

    @abstractmethod
    def _gradient_step(self, batch: Batch, margin_weight: float) -> GradientStep:
        """Make one step of the policy network down the gradient of the loss of `batch`: `theta <- theta - alpha dL`.

        Args:
            batch: transitions to learn from; left unchanged.
            margin_weight: weight of the large-margin loss, which is added to the temporal-difference loss.

        Raises:
            UnsoundUpdateError: as `update` raises it.
        """

    def figures(self) -> dict[str, float]:
        """Return figures of the last update; an empty dictionary before the first.

        They are `loss` without the rows' importance weights, `q_mean` over all actions and `gradient_norm` before
        clipping. They are not computed in `update` because they take a while.
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
        """Return the absolute temporal-difference errors of the last update's rows, `(B,)` float32.

        Raises:
            RunError: there has been no update.
        """
        if self._last is None:
            raise RunError("there are no errors of a last update; make an update first")
        errors: np.ndarray = np.abs(self._last.errors)
        return errors

    def distilled(self, batches: Iterable[Batch]) -> Parameters:
        """Return the parameters of a copy that took one step per batch with the large-margin loss on guide actions.

        The temporal-difference loss remains part of it, so that values keep their scale. This learner is unchanged.
        """
        student = self._student()
        for batch in batches:
            student._gradient_step(batch, _DISTIL_MARGIN_WEIGHT)
        return student.parameters()

    def examine(self, batch: Batch) -> str | None:
        """Return what an update by `batch` would first compute that is not finite or beyond `limit`; None: nothing.

        This learner is unchanged.
        """
        with np.errstate(all="ignore"):
            return soundness.first_unsound(self._quantities(batch))

    def _quantities(self, batch: Batch) -> Iterator[Quantity]:
        """Return all that an update reads and computes, in order; what comes later is only computed if asked for."""
        columns = {name: getattr(batch, name) for name in ("states", "rewards", "discounts", "next_states", "weights")}
        yield from (Quantity(f"{name} of the batch", column) for name, column in columns.items() if column is not None)
        yield from (Quantity(f"{name} of the learner", array) for name, array in self.state().items() if "/" in name)
        student, size = self._student(), len(batch)
        rows = student._stacked(batch)
        for of, parameters, states in (
            ("online", self.parameters(), rows.states),
            ("target", self.target_parameters(), rows.states[size:]),
        ):
            yield from soundness.layers(of, parameters, states, self.limit)
        online, target = network.apply(self.parameters(), rows.states), network.apply(parameters, states)
        yield Quantity("scaled rewards of the batch", batch.rewards * np.float32(self._config.reward_scale))
        targets = self._td_targets(batch, rows.masks[size:], target, online[size:] if self._config.double else None)
        yield Quantity("targets", targets)
        yield Quantity("errors", losses.td_error(online[:size], rows.actions, targets), self.limit)
        student = self._student()
        with contextlib.suppress(UnsoundUpdateError):
            student._gradient_step(batch, self._config.guide_margin_weight)
        for name, tensor in zip(student._online.names, student._online.tensors, strict=True):
            assert tensor.grad is not None  # a view of the vector of gradients
            yield Quantity(f"gradient of {name}", tensor.grad.cpu().numpy())
        yield Quantity("squared norm of the gradient", np.square(student._gradient.cpu().numpy()).sum())

    def _student(self) -> Self:
        """Return a copy with the same networks, a new optimiser, and a policy network of its own."""
        student = copy.copy(self)
        student._rng = copy.deepcopy(self._rng)
        student._online = torch_network.policy_network(self.parameters()).to(self._device)
        student._weights, student._gradient = _flatten(student._online)
        student._restart_optimiser()
        return student

    def promote(self, parameters: Parameters, reset_online: bool) -> None:
        """Load `parameters` into the target network; with `reset_online` also into the policy network.

        The optimiser is reset together with the policy network.

        Raises:
            WeightsError: the parameters belong to another network.
        """
        self._load(self._target, parameters)
        if reset_online:
            self._load(self._online, parameters)
            self._restart_optimiser()

    def parameters(self) -> Parameters:
        """Return a copy of the policy network's parameters."""
        return self._online.parameters_numpy()

    def target_parameters(self) -> Parameters:
        """Return a copy of the target network's parameters."""
        return self._target.parameters_numpy()

    def state(self) -> dict[str, np.ndarray]:
        """Return a copy of all state that updates depend on; a learner that restores it continues bit-identically."""
        arrays = {f"online/{name}": value for name, value in self.parameters().items()}
        arrays |= {f"target/{name}": value for name, value in self.target_parameters().items()}
        arrays |= {f"adam/{name}": value.cpu().numpy().copy() for name, value in self._adam.items()}
        return arrays | {"updates": np.array(self.updates, np.int64), "generator": _generator_words(self._rng)}

    def restore(self, state: dict[str, np.ndarray], *, check: bool = True) -> None:
        """Restore what `state` returned.

        Args:
            state: entries by name.
            check: whether weights that are not finite are refused.

        Raises:
            RunError: an entry is missing or misshapen.
            WeightsError: the weights belong to another network.
        """
        expected = {name: value.shape for name, value in self.state().items() if "/" not in name or "adam/" in name}
        for name, shape in expected.items():
            found = np.shape(state[name]) if name in state else "missing"
            if found != shape:
                raise RunError(f"learner state {name} is {found}; allowed is an array of shape {shape}")
        for prefix, module in (("online/", self._online), ("target/", self._target)):
            self._load(module, {k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)}, check)
        for name, value in self._adam.items():
            value.copy_(torch.from_numpy(np.array(state[f"adam/{name}"])))
        self.updates = int(state["updates"])
        _set_generator(self._rng, state["generator"])

    def _stacked(self, batch: Batch) -> StackedBatch:
        """Return a copy of a batch's columns, with half of the rows reflected if there is a mirror."""
        rows = StackedBatch.of(batch)
        if self._mirror is not None:
            rows.reflect(self._mirror, self._rng.random(len(batch)) < 0.5)
        return rows

    def _td_targets(
        self, batch: Batch, next_masks: np.ndarray, target_q: np.ndarray, online_q: np.ndarray | None
    ) -> np.ndarray:
        """Return the targets of the batch's rows, `(B,)`, from both networks' values of the next states."""
        rewards = batch.rewards * np.float32(self._config.reward_scale)
        return losses.td_targets(rewards, batch.discounts, target_q, next_masks, online_q)

    def _load(self, module: torch_network.QNetwork, parameters: Parameters, check: bool = True) -> None:
        if check:
            network.check(parameters, self._state_size, self._actions)
        for name, tensor in zip(module.names, module.tensors, strict=True):
            if name not in parameters or tuple(tensor.shape) != parameters[name].shape:
                found = parameters[name].shape if name in parameters else "missing"
                raise WeightsError(f"network weight {name} is {found}; allowed is shape {tuple(tensor.shape)}")
            tensor.data.copy_(torch.from_numpy(parameters[name]))

    def _restart_optimiser(self) -> None:
        """Set Adam's step count and moments to 0."""
        self._adam = {
            "step": torch.zeros((), device=self._device),
            "exp_avg": torch.zeros_like(self._weights),
            "exp_avg_sq": torch.zeros_like(self._weights),
        }


def _flatten(module: torch_network.QNetwork) -> tuple[torch.Tensor, torch.Tensor]:
    """Move a network's weights and gradients into two vectors; return them. Its tensors become views of them."""
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
    """Return the state of a PCG64 generator as `(6,)` uint64: two 128-bit numbers, and the cached half of a draw."""
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
