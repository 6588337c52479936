"""Q-network in PyTorch, used by learners; `network` computes the same in numpy."""

import torch
from torch.nn import functional

from zsdist.dqn.network import NORM_EPSILON, depth
from zsdist.types import Parameters


class QNetwork(torch.nn.Module):
    """Q(s, ·) as a multilayer perceptron with given parameters; `(B, D)` to `(B, A)`, float32.

    Attributes:
        names: names of the parameters.
        tensors: the parameters, in the order of `names`.
        hidden_layers: weight and bias of each hidden layer, and scale and shift of its normalisation.
        output_layer: weight and bias of the output layer.
    """

    def __init__(self, parameters: Parameters) -> None:
        super().__init__()
        tensors = {name: torch.nn.Parameter(torch.from_numpy(value.copy())) for name, value in parameters.items()}
        self.names = tuple(tensors)
        self.tensors = torch.nn.ParameterList(tensors.values())
        self.hidden_layers = [
            tuple(tensors[f"hidden{i}.{part}"] for part in ("weight", "bias", "norm_scale", "norm_shift"))
            for i in range(depth(parameters))
        ]
        self.output_layer = (tensors["output.weight"], tensors["output.bias"])

    def forward(self, states: torch.Tensor) -> torch.Tensor:
        """Return the values of all actions `(B, A)` in `states` `(B, D)`."""
        x = states
        for weight, bias, scale, shift in self.hidden_layers:
            linear = functional.linear(x, weight, bias)
            x = functional.relu(functional.layer_norm(linear, bias.shape, scale, shift, NORM_EPSILON))
        return functional.linear(x, *self.output_layer)

    def parameters_numpy(self) -> Parameters:
        """Return a copy of the parameters, by name."""
        return {name: t.detach().cpu().numpy().copy() for name, t in zip(self.names, self.tensors, strict=True)}


def policy_network(parameters: Parameters) -> QNetwork:
    """Return the network that acts and learns, Q(s, a; theta): Eq. (8)."""
    return QNetwork(parameters)


def target_network(parameters: Parameters) -> QNetwork:
    """Return the network that computes the targets, Q'(s, a; theta^-), without gradients: Eq. (9)."""
    return QNetwork(parameters).requires_grad_(False)
