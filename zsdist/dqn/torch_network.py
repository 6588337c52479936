"""The Q-network in torch, the form that learns; `network` has the same in numpy."""

import torch
from torch.nn import functional

from zsdist.dqn.network import NORM_EPSILON, depth
from zsdist.types import Parameters

# Of each hidden layer: input, linear, mean and 1 / spread of it; last: its output.
Trace = list[tuple[torch.Tensor, ...]]


class QNetwork(torch.nn.Module):
    """Q(s, ·) as a multilayer perceptron holding given parameters; `(B, D)` to `(B, A)`, float32."""

    def __init__(self, parameters: Parameters) -> None:
        super().__init__()
        layers = depth(parameters)
        tensors = {name: torch.nn.Parameter(torch.from_numpy(value.copy())) for name, value in parameters.items()}
        self._layers = [
            tuple(tensors[f"hidden{i}.{part}"] for part in ("weight", "bias", "norm_scale", "norm_shift"))
            for i in range(layers)
        ]
        self._head = (tensors["output.weight"], tensors["output.bias"])
        self.names = tuple(tensors)
        self.tensors = torch.nn.ParameterList(tensors.values())

    def forward(self, states: torch.Tensor) -> torch.Tensor:
        """Values of all actions `(B, A)` in `states` `(B, D)`."""
        return self.traced(states)[0]

    def traced(self, states: torch.Tensor) -> tuple[torch.Tensor, Trace]:
        """Values of all actions `(B, A)` in `states` `(B, D)`, and what `backward` needs of how they came about."""
        trace, x = [], states
        for weight, bias, scale, shift in self._layers:
            linear = functional.linear(x, weight, bias)
            normal, mean, spread = torch.native_layer_norm(linear, bias.shape, scale, shift, NORM_EPSILON)
            trace.append((x, linear, mean, spread))
            x = torch.relu_(normal)
        trace.append((x,))
        return functional.linear(x, *self._head), trace

    def backward(self, gradient: torch.Tensor, trace: Trace) -> None:
        """Writes the gradient of every parameter into its `grad`, which must be there.

        By hand: for networks of this size recording the operations takes about as long as doing them.

        Args:
            gradient: `(b, A)` with respect to the values of the first `b` of the traced states.
            trace: of `traced`, of parameters that have not changed since.
        """
        b, (weight, bias), (active,) = len(gradient), self._head, trace[-1]
        for layer in range(len(self._layers), -1, -1):
            torch.mm(gradient.t(), active[:b], out=weight.grad)
            torch.sum(gradient, 0, out=bias.grad)
            if layer == 0:
                return
            gradient = torch.ops.aten.threshold_backward(gradient @ weight, active[:b], 0)
            weight, bias, scale, shift = self._layers[layer - 1]
            active, *normalised = trace[layer - 1]
            linear, mean, spread = (tensor[:b] for tensor in normalised)
            gradient, scale_gradient, shift_gradient = torch.ops.aten.native_layer_norm_backward(
                gradient, linear, bias.shape, mean, spread, scale, shift, [True, True, True]
            )
            scale.grad.copy_(scale_gradient)
            shift.grad.copy_(shift_gradient)

    def parameters_numpy(self) -> Parameters:
        """A copy of the parameters, by name."""
        return {name: t.detach().cpu().numpy().copy() for name, t in zip(self.names, self.tensors, strict=True)}


def policy_network(parameters: Parameters) -> QNetwork:
    """The network that acts and learns, Q(s, a; theta): Eq. (8)."""
    return QNetwork(parameters)


def target_network(parameters: Parameters) -> QNetwork:
    """The network that targets are computed from, Q'(s, a; theta^-); takes no gradient: Eq. (9)."""
    return QNetwork(parameters).requires_grad_(False)
