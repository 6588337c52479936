"""One training of a network, epoch by epoch, which can be saved between epochs and resumed."""

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

LARGEST_GRADIENT = 5.0  # norm to which longer gradients are cut

Losses = Iterable[tuple[Tensor, dict[str, float]]]
"""Of an epoch's batches: the loss to go down, and its parts to tell."""


@dataclass(frozen=True)
class Recipe:
    """How to train: passes over the data, views a step, the one cycle's peak, weight decay, and when to stop."""

    epochs: int = 30
    batch: int = 64
    learning_rate: float = 3e-3
    weight_decay: float = 0.02
    patience: int = 8  # epochs without a better validation loss


class Trainer(Iterator[dict[str, float]]):
    """Trains a network in place; each `next` is an epoch, and the end leaves the weights of the best one.

    AdamW with one cycle of the learning rate. It ends after `recipe.epochs`, when the time is used, or after
    `recipe.patience` epochs in which the validation loss did not get better. Between epochs `state` is all that is
    needed to go on in another process: weights, best weights, optimiser, counters and random numbers.

    Args:
        network: to train.
        recipe: how.
        steps: batches of an epoch.
        losses: gives the losses of one epoch's batches, computed when asked for, with the random numbers given.
        validate: gives the parts of the validation loss, of which the sum is to be small.
        rng: decides whatever is random.
        time_used: share of the time allowed that is gone; the cycle hurries so as to end when it reaches 1.

    Raises:
        RunError: a loss is not finite; the epoch is named, and the weights are those before the step.

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
        self._parameters = [parameter for parameter in network.parameters() if parameter.requires_grad]
        self._optimiser = torch.optim.AdamW(self._parameters, lr=recipe.learning_rate, weight_decay=recipe.weight_decay)

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> dict[str, float]:
        if self._over():
            if self._best:
                self._network.load_state_dict(self._best)
            raise StopIteration
        with torch.random.fork_rng(devices=[]):  # so that dropout, too, follows from `rng`
            torch.manual_seed(int(self._rng.integers(2**63)))
            means, rate = self._train()
        parts = self._validate()
        found = sum(parts.values())
        self._check("validation loss", found, parts)
        self.epoch += 1
        if found < self._best_loss:
            self._best_loss, self._best_epoch = found, self.epoch
            self._best = {name: value.clone() for name, value in self._network.state_dict().items()}
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
            said = ", ".join(f"{part} {number:g}" for part, number in parts.items())
            raise RunError(
                f"{name} is {value:g} ({said}) in epoch {self.epoch + 1}; allowed is a finite one, to which another "
                "seed or more pictures may lead"
            )

    def _train(self) -> tuple[dict[str, float], float]:
        """An epoch; the means of the loss and its parts, and the last learning rate."""
        self._network.train()
        step, total_steps, sums, rate = self.epoch * self._steps, self._recipe.epochs * self._steps, {}, 0.0
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
            for name, value in {"loss": float(total.detach()), **parts}.items():
                sums[name] = sums.get(name, 0.0) + value
            step, batches = step + 1, batches + 1
        return {name: value / batches for name, value in sums.items()}, rate

    def state(self) -> bytes:
        """Where the training stands after the last epoch, for `restore`; in the format of safetensors."""
        progress = {
            "epoch": self.epoch,
            "best_loss": self._best_loss,
            "best_epoch": self._best_epoch,
            "rng": self._rng.bit_generator.state,
        }
        tensors = {"progress": torch.frombuffer(bytearray(json.dumps(progress).encode()), dtype=torch.uint8)}
        for prefix, weights in (("now", self._network.state_dict()), ("best", self._best)):
            tensors |= {f"{prefix}.{name}": value.contiguous() for name, value in weights.items()}
        for number, moments in self._optimiser.state_dict()["state"].items():
            tensors |= {f"optimiser.{number}.{name}": value.contiguous() for name, value in moments.items()}
        return safetensors.torch.save({name: value.clone() for name, value in tensors.items()})

    def restore(self, content: bytes) -> None:
        """Goes on from where another training with the same network and recipe stood.

        Raises:
            WeightsError: the content is damaged, or of another network.
        """
        try:
            tensors = safetensors.torch.load(content)
            progress = json.loads(tensors.pop("progress").numpy().tobytes())
            groups: dict[str, dict[str, Tensor]] = {"now": {}, "best": {}, "optimiser": {}}
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
            self._best, self._best_loss = groups["best"], float(progress["best_loss"])
            self.epoch, self._best_epoch = int(progress["epoch"]), int(progress["best_epoch"])
        except (safetensors.SafetensorError, KeyError, ValueError, RuntimeError) as error:
            reason = " ".join(str(error).split())[:200]
            raise WeightsError(f"saved training cannot be resumed: {reason}") from error


def one_cycle(share: float) -> float:
    """Learning rate over its peak at `share` of the training: up for the first fifth, then down to nothing."""
    return 0.05 + 0.95 * share / 0.2 if share < 0.2 else 0.5 * (1 + math.cos(math.pi * (share - 0.2) / 0.8))
