"""Deep Q-learner with hand-written gradients: computes the same as `zsdist.dqn.learner` in less time.

For networks of this size, automatic differentiation takes about as long to record the operations as to do them.
"""

import numpy as np
import torch
from torch.nn import functional
from torch.optim.adam import adam

from zsdist.common.compiled import compiled
from zsdist.dqn import losses, soundness
from zsdist.dqn.base import BaseDqnLearner, GradientStep
from zsdist.dqn.network import NORM_EPSILON
from zsdist.dqn.torch_network import QNetwork
from zsdist.types import Batch

_BETAS, _ADAM_EPSILON = (0.9, 0.999), 1e-8  # torch's defaults
_relu_backward = torch.ops.aten.threshold_backward.default  # a fixed overload needs no search in every call
_layer_norm_backward = torch.ops.aten.native_layer_norm_backward.default

# For each hidden layer: input, linear output, its mean and 1 / spread. Last entry: input of the output layer.
Trace = list[tuple[torch.Tensor, ...]]


class FusedDqnLearner(BaseDqnLearner):
    """Learner with hand-written gradients and the fused Adam, without automatic differentiation."""

    @torch.inference_mode()
    def _gradient_step(self, batch: Batch, margin_weight: float) -> GradientStep:
        config, size = self._config, len(batch)
        rows = self._stacked(batch)
        states = torch.from_numpy(rows.states).to(self._device)
        # Double Q-learning needs the policy network's values of the next states too, so one pass computes both.
        values_t, trace = forward(self._online, states if config.double else states[:size])
        target_q = forward(self._target, states[size:])[0].cpu().numpy()
        values = values_t.cpu().numpy()
        q, masks = values[:size], rows.masks[:size]
        targets = self._td_targets(batch, rows.masks[size:], target_q, values[size:] if config.double else None)
        errors, gradient = _errors_and_gradient(
            q, rows.actions, masks, rows.guides, targets, config.huber, config.guide_margin, margin_weight
        )
        if batch.weights is not None:  # drawn by priority: each row counts as much as its importance weight
            gradient *= batch.weights[:, None]
        backward(self._online, torch.from_numpy(gradient).to(self._device), trace)
        norm: float = torch.linalg.vector_norm(self._gradient).item()
        soundness.require(self.limit, norm, values, target_q, errors)
        self._descend(norm)
        return GradientStep(q, errors, masks, rows.guides, norm)

    def _descend(self, norm: float) -> None:
        """Make one Adam step down the gradient, which has this norm, after clipping it."""
        shrink = np.float32(self._config.max_gradient_norm) * (1 / (np.float32(norm) + np.float32(1e-6)))
        if shrink < 1:
            self._gradient.mul_(float(shrink))
        adam(  # the function beneath `torch.optim.Adam(fused=True)`, whose `step` takes twice as long
            [self._weights],
            [self._gradient],
            [self._adam["exp_avg"]],
            [self._adam["exp_avg_sq"]],
            [],
            [self._adam["step"]],
            fused=True,
            lr=self._config.learning_rate,
            beta1=_BETAS[0],
            beta2=_BETAS[1],
            weight_decay=0.0,
            eps=_ADAM_EPSILON,
            amsgrad=False,
            maximize=False,
        )


def forward(network: QNetwork, states: torch.Tensor) -> tuple[torch.Tensor, Trace]:
    """Return the values of all actions `(B, A)` in `states` `(B, D)`, and the intermediate results for `backward`."""
    trace: Trace = []
    x = states
    for weight, bias, scale, shift in network.hidden_layers:
        linear = functional.linear(x, weight, bias)
        normal, mean, spread = torch.native_layer_norm(linear, bias.shape, scale, shift, NORM_EPSILON)
        trace.append((x, linear, mean, spread))
        x = torch.relu_(normal)
    trace.append((x,))
    return functional.linear(x, *network.output_layer), trace


def backward(network: QNetwork, gradient: torch.Tensor, trace: Trace) -> None:
    """Write the gradient of every parameter into its `grad`, which must exist.

    Args:
        network: network that `forward` ran, with parameters unchanged since.
        gradient: `(b, A)`, gradient with respect to the values of the first `b` of the traced states.
        trace: intermediate results that `forward` returned.
    """
    b, (weight, bias), (active,) = len(gradient), network.output_layer, trace[-1]
    for layer in range(len(network.hidden_layers), -1, -1):
        torch.mm(gradient.t(), active[:b], out=weight.grad)
        torch.sum(gradient, 0, out=bias.grad)
        if layer == 0:
            return
        gradient = _relu_backward(torch.mm(gradient, weight), active[:b], 0)
        weight, bias, scale, shift = network.hidden_layers[layer - 1]
        active, *normalised = trace[layer - 1]
        linear, mean, spread = (tensor[:b] for tensor in normalised)
        gradient, scale_gradient, shift_gradient = _layer_norm_backward(
            gradient, linear, bias.shape, mean, spread, scale, shift, [True, True, True]
        )
        assert scale.grad is not None and shift.grad is not None
        scale.grad.copy_(scale_gradient)
        shift.grad.copy_(shift_gradient)


@compiled()
def _errors_and_gradient(
    q: np.ndarray,
    actions: np.ndarray,
    masks: np.ndarray,
    guides: np.ndarray,
    targets: np.ndarray,
    huber: bool,
    margin: float,
    margin_weight: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return errors `(B,)` and the gradient `(B, A)` of both losses with respect to `q`, before rows are weighted."""
    errors = losses.td_error(q, actions, targets)
    gradient = losses.td_gradient(q, actions, errors, huber)
    if margin_weight:
        weight = np.float64(np.float32(margin_weight))  # the sum is rounded once
        gradient = (gradient + weight * losses.margin_gradient(q, masks, guides, margin)).astype(np.float32)
    return errors, gradient
