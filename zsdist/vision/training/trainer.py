"""Training of a network epoch by epoch; it can be saved between epochs and resumed."""

import json
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np
import safetensors
import safetensors.torch
import torch
from torch import Tensor, nn

from zsdist.errors import RunError, WeightsError

LARGEST_GRADIENT = 5.0  # norm at which gradients are clipped

Losses = Iterable[tuple[Tensor, dict[str, float]]]
"""Of each batch of an epoch: the loss to minimise, and its parts to report."""


@dataclass(frozen=True)
class Recipe:
    """Settings of a training.

    Attributes:
        epochs: greatest number of passes over the data.
        batch: number of views in a step.
        learning_rate: peak of the learning rate, which rises and falls once.
        weight_decay: weight decay of AdamW.
        patience: number of epochs without a better validation loss after which the training stops.
        average: decay of the moving average of the weights after each step; the average is validated and kept in place
            of the weights themselves. 0: no average.
    """

    epochs: int = 30
    batch: int = 64
    learning_rate: float = 3e-3
    weight_decay: float = 0.02
    patience: int = 8
    average: float = 0.0


class Trainer(Iterator[dict[str, float]]):
    """Training of a network in place. Each `next` is one epoch; at the end the weights of the best epoch are loaded.

    The optimiser is AdamW with one cycle of the learning rate. The training ends after `recipe.epochs`, when the time
    is used, or after `recipe.patience` epochs without a better validation loss. Between epochs `state` holds all that
    is needed to resume in another process: weights, best weights, optimiser, counters and random numbers.

    Args:
        network: network to train.
        recipe: settings of the training.
        steps: number of batches of an epoch.
        losses: function that yields the losses of one epoch's batches, computed one at a time with the given generator.
        validate: function that returns the parts of the validation loss; the epoch with the least sum is the best.
        rng: source of all randomness.
        time_used: function that returns the used share of the time budget; the cycle is sped up to end when it is 1.

    Raises:
        RunError: a loss is not finite; the message names the epoch, and the weights are those before the step.

    Yields:
        `{"epoch", "learning_rate", "loss", "validation_loss"}`, with the parts as `loss_<part>` and
        `validation_<part>`.
    """

    def __init__(
        self,
        network: nn.Module,
        recipe: Recipe,
        steps: int,
        losses: Callable[[np.random.Generator], Losses],
        validate: Callable[[], dict[str, float]],
        rng: np.random.Generator,
        time_used: Callable[[], float],
    ) -> None:
        self.epoch = 0
        self._network = network
        self._recipe = recipe
        self._steps = steps
        self._losses = losses
        self._validate = validate
        self._rng = rng
        self._time_used = time_used
        self._best_loss, self._best_epoch = math.inf, 0
        self._best: dict[str, Tensor] = {}
        self._average: dict[str, Tensor] = self._weights() if recipe.average else {}
        self._parameters = [parameter for parameter in network.parameters() if parameter.requires_grad]
        self._optimiser = torch.optim.AdamW(self._parameters, lr=recipe.learning_rate, weight_decay=recipe.weight_decay)

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> dict[str, float]:
        if self._over():
            if self._best:
                self._network.load_state_dict(self._best)
            raise StopIteration
        with torch.random.fork_rng(devices=[]):  # torch's randomness, such as dropout, follows from `rng` too
            torch.manual_seed(int(self._rng.integers(2**63)))
            means, rate = self._train()
        latest = self._weights()
        if self._average:
            self._network.load_state_dict(self._average)
        parts = self._validate()
        found = sum(parts.values())
        self._check("validation loss", found, parts)
        self.epoch += 1
        if found < self._best_loss:
            self._best_loss, self._best_epoch = found, self.epoch
            self._best = self._weights()
        self._network.load_state_dict(latest)
        return {
            "epoch": self.epoch,
            "learning_rate": rate,
            "loss": means.pop("loss"),
            **{f"loss_{name}": value for name, value in means.items()},
            "validation_loss": found,
            **{f"validation_{name}": value for name, value in parts.items()},
        }

    def _over(self) -> bool:
        return self.epoch > 0 and (
            self.epoch >= self._recipe.epochs
            or self._time_used() >= 1.0
            or self.epoch - self._best_epoch >= self._recipe.patience
        )

    def _check(self, name: str, value: float, parts: dict[str, float]) -> None:
        if not math.isfinite(value):
            numbers = ", ".join(f"{part} {number:g}" for part, number in parts.items())
            raise RunError(
                f"{name} is {value:g} ({numbers}) in epoch {self.epoch + 1}; allowed is a finite one; try another "
                "seed or more pictures"
            )

    def _train(self) -> tuple[dict[str, float], float]:
        """Train one epoch; return the means of the loss and its parts, and the last learning rate."""
        self._network.train()
        sums: dict[str, float] = {}
        step, total_steps, rate = self.epoch * self._steps, self._recipe.epochs * self._steps, 0.0
        batches = 0
        for total, parts in self._losses(self._rng):
            self._check("loss", float(total.detach()), parts)
            rate = self._recipe.learning_rate * one_cycle(max(step / total_steps, min(self._time_used(), 1.0)))
            for group in self._optimiser.param_groups:
                group["lr"] = rate
            self._optimiser.zero_grad()
            total.backward()
            torch.nn.utils.clip_grad_norm_(self._parameters, LARGEST_GRADIENT)
            self._optimiser.step()
            self._move_average(step)
            for name, value in {"loss": float(total.detach()), **parts}.items():
                sums[name] = sums.get(name, 0.0) + value
            step, batches = step + 1, batches + 1
        return {name: value / batches for name, value in sums.items()}, rate

    def _weights(self) -> dict[str, Tensor]:
        """Return a copy of the network's present weights."""
        return {name: value.clone() for name, value in self._network.state_dict().items()}

    def _move_average(self, step: int) -> None:
        """Move the average towards the weights after a step; early ones count less, as in a mean."""
        if not self._average:
            return
        share = 1 - min(self._recipe.average, (1 + step) / (10 + step))
        for name, value in self._network.state_dict().items():
            if value.is_floating_point():
                self._average[name].lerp_(value, share)
            else:
                self._average[name].copy_(value)

    def state(self) -> bytes:
        """Return the state of the training after the last epoch, for `restore`, in the format of safetensors."""
        progress = {
            "epoch": self.epoch,
            "best_loss": self._best_loss,
            "best_epoch": self._best_epoch,
            "rng": self._rng.bit_generator.state,
        }
        tensors = {"progress": torch.frombuffer(bytearray(json.dumps(progress).encode()), dtype=torch.uint8)}
        groups = {"now": self._network.state_dict(), "best": self._best, "average": self._average}
        for prefix, weights in groups.items():
            tensors |= {f"{prefix}.{name}": value.contiguous() for name, value in weights.items()}
        for number, moments in self._optimiser.state_dict()["state"].items():
            tensors |= {f"optimiser.{number}.{name}": value.contiguous() for name, value in moments.items()}
        return safetensors.torch.save({name: value.clone() for name, value in tensors.items()})

    def restore(self, content: bytes) -> None:
        """Resume from the state of another training with the same network and recipe.

        Raises:
            WeightsError: the content is damaged or belongs to another network.
        """
        try:
            tensors = safetensors.torch.load(content)
            progress = json.loads(tensors.pop("progress").numpy().tobytes())
            groups: dict[str, dict[str, Tensor]] = {"now": {}, "best": {}, "average": {}, "optimiser": {}}
            for name, value in tensors.items():
                group, _, rest = name.partition(".")
                groups[group][rest] = value
            self._network.load_state_dict(groups["now"])
            moments: dict[int, dict[str, Tensor]] = {}
            for name, value in groups["optimiser"].items():
                number, _, moment = name.partition(".")
                moments.setdefault(int(number), {})[moment] = value
            self._optimiser.load_state_dict(
                {"state": moments, "param_groups": self._optimiser.state_dict()["param_groups"]}
            )
            self._rng.bit_generator.state = progress["rng"]
            self._average = groups["average"]
            self._best, self._best_loss = groups["best"], float(progress["best_loss"])
            self.epoch, self._best_epoch = int(progress["epoch"]), int(progress["best_epoch"])
        except (safetensors.SafetensorError, KeyError, ValueError, RuntimeError) as error:
            reason = " ".join(str(error).split())[:200]
            raise WeightsError(f"saved training cannot be resumed: {reason}") from error


def one_cycle(share: float) -> float:
    """Return the learning rate over its peak at `share` of the training: it rises for a fifth, then falls to zero."""
    return 0.05 + 0.95 * share / 0.2 if share < 0.2 else 0.5 * (1 + math.cos(math.pi * (share - 0.2) / 0.8))
