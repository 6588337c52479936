"""Deep Q-learner by automatic differentiation: the reference implementation, written close to the paper.

`zsdist.dqn.fused` computes the same faster; a test compares both.
"""

import numpy as np
import torch

from zsdist.dqn import soundness
from zsdist.dqn.base import BaseDqnLearner, GradientStep
from zsdist.types import Batch


class DqnLearner(BaseDqnLearner):
    """Learner with PyTorch's automatic differentiation and its Adam."""

    def _gradient_step(self, batch: Batch, margin_weight: float) -> GradientStep:
        config, size = self._config, len(batch)
        rows = self._stacked(batch)
        states, next_states = self._tensor(rows.states[:size]), self._tensor(rows.states[size:])
        masks, next_masks = rows.masks[:size], rows.masks[size:]
        with torch.no_grad():  # targets are constants
            target_q = self._target(next_states).cpu().numpy()
            online_q = self._online(next_states).cpu().numpy() if config.double else None
        targets = self._td_targets(batch, next_masks, target_q, online_q)
        q = self._online(states)
        errors = q.gather(1, self._tensor(rows.actions)[:, None]).squeeze(1) - self._tensor(targets)
        loss = td_losses(errors, config.huber)
        if margin_weight:
            margins = margin_losses(q, self._tensor(masks), self._tensor(rows.guides), config.guide_margin)
            loss = loss + margin_weight * margins
        if batch.weights is not None:  # drawn by priority: each row counts as much as its importance weight
            loss = loss * self._tensor(batch.weights)
        self._optimiser.zero_grad(set_to_none=False)  # the networks' gradients are views of the vector of gradients
        torch.autograd.backward(loss.mean())
        norm = torch.linalg.vector_norm(self._gradient).item()
        values, found = q.detach().cpu().numpy(), errors.detach().cpu().numpy()
        soundness.require(self.limit, norm, values, target_q, found, *(() if online_q is None else (online_q,)))
        self._descend()
        return GradientStep(values, found, masks, rows.guides, norm)

    def _descend(self) -> None:
        """Make one step down the gradient: Eq. (11).

        Deviation: Adam with a clipped gradient in place of the plain step; Huber loss where so configured.
        """
        torch.nn.utils.clip_grad_norm_(self._weights, self._config.max_gradient_norm)
        self._optimiser.step()

    def _restart_optimiser(self) -> None:
        super()._restart_optimiser()
        self._optimiser = torch.optim.Adam([self._weights], lr=self._config.learning_rate)
        self._optimiser.state[self._weights] = self._adam

    def _tensor(self, array: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(array).to(self._device)


def td_losses(errors: torch.Tensor, huber: bool) -> torch.Tensor:
    """Return the loss of each temporal-difference error, `(B,)`: Huber with its bend at 1, or half the square."""
    return torch.where(errors.abs() < 1, errors**2 / 2, errors.abs() - 0.5) if huber else errors**2 / 2


def margin_losses(q: torch.Tensor, masks: torch.Tensor, guides: torch.Tensor, margin: float) -> torch.Tensor:
    """Return the large-margin loss of each row, `(B,)`: 0 without an allowed guide action (`losses.margin_loss`).

    Args:
        q: `(B, A)`, values.
        masks: `(B, A)` bool, allowed actions.
        guides: `(B,)` int64, actions of the guide, negative: none.
        margin: lead over all other actions that the guide action must have, in units of value.
    """
    guide = guides.clamp(min=0)[:, None]
    lifted = (q + margin).scatter(1, guide, q.gather(1, guide))
    best = lifted.masked_fill(~masks, -torch.inf).max(1).values
    counts = (guides >= 0) & masks.gather(1, guide).squeeze(1)
    return torch.where(counts, best - q.gather(1, guide).squeeze(1), 0.0)
