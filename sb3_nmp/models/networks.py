"""The parts that networks over trajectories are made of.

Shape letters: B batch, T target times, E members of an ensemble.

With ``n_members`` above 1, each of these parts is an ensemble of its kind in one: all its inputs
and outputs begin with E, and members share nothing.
"""

import math
from itertools import pairwise
from typing import cast

import torch as th
from torch import nn

from sb3_nmp.common.regression import linear_regression
from sb3_nmp.common.settings import settings_name

#: of a fitted trend's slopes, for each demonstration, contexts having a standard deviation of 1
TREND_RIDGE = 0.01
#: of its weights over time, for each time point: waves over half of their period are nearly
#: collinear, and weights that cancel each other would cost single precision its digits
TIME_RIDGE = 1e-4
#: the activations that settings name in files
ACTIVATIONS = {
    "relu": nn.ReLU,
    "tanh": nn.Tanh,
    "elu": nn.ELU,
    "gelu": nn.GELU,
    "silu": nn.SiLU,
    "leaky-relu": nn.LeakyReLU,
    "softplus": nn.Softplus,
}
for _name, _activation in ACTIVATIONS.items():
    settings_name(_name)(_activation)


class MemberLinear(nn.Module):
    """A linear layer for each member of an ensemble, in one product.

    Each begins as PyTorch's ``nn.Linear`` does.

    :param n_members: E
    :param inputs: size of the input
    :param outputs: size of the output
    :param bias: whether a constant is added
    """

    def __init__(self, n_members: int, inputs: int, outputs: int, bias: bool = True) -> None:
        super().__init__()
        limit = inputs**-0.5
        self.weight = nn.Parameter(th.empty(n_members, inputs, outputs).uniform_(-limit, limit))
        first = th.empty(n_members, 1, outputs).uniform_(-limit, limit) if bias else None
        self.bias = None if first is None else nn.Parameter(first)

    def forward(self, inputs: th.Tensor) -> th.Tensor:
        """Return the outputs, shape (E, *, outputs).

        :param inputs: shape (E, *, inputs)
        """
        rows = inputs.flatten(1, -2)
        if self.bias is None:
            found = th.bmm(rows, self.weight)
        else:
            found = th.baddbmm(self.bias, rows, self.weight)
        return found.view(*inputs.shape[:-1], self.weight.shape[-1])


def linear(
    inputs: int, outputs: int, n_members: int = 1, bias: bool = True
) -> nn.Linear | MemberLinear:
    """Return a linear layer, or one for each member.

    :param inputs: size of the input
    :param outputs: size of the output
    :param n_members: E
    :param bias: whether a constant is added
    """
    if n_members == 1:
        return nn.Linear(inputs, outputs, bias)
    return MemberLinear(n_members, inputs, outputs, bias)


def weight_and_bias(layer: nn.Module | None) -> tuple[th.Tensor, th.Tensor]:
    """Return a linear layer's weight, shape ([E,] inputs, outputs), and its bias, to be written to.

    :param layer: of `linear`, with a bias
    """
    found = cast(nn.Linear | MemberLinear, layer)
    weight = found.weight if isinstance(found, MemberLinear) else found.weight.T
    return weight, cast(nn.Parameter, found.bias)


def mlp(sizes: list[int], activation_fn: type[nn.Module], n_members: int = 1) -> nn.Sequential:
    """Return a multi-layer perceptron with a linear last layer.

    :param sizes: of input, hidden layers and output
    :param activation_fn: between the layers
    :param n_members: E
    """
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(sizes):
        layers += [linear(inputs, outputs, n_members), activation_fn()]
    return nn.Sequential(*layers[:-1])


class LinearPlus(nn.Module):
    """A linear map plus a multi-layer perceptron: few examples determine the linear part best.

    :param sizes: of input, hidden layers and output
    :param activation_fn: between the layers
    :param n_members: E
    """

    def __init__(
        self, sizes: list[int], activation_fn: type[nn.Module], n_members: int = 1
    ) -> None:
        super().__init__()
        self.linear = linear(sizes[0], sizes[-1], n_members)
        self.correction = mlp(sizes, activation_fn, n_members)

    def forward(self, inputs: th.Tensor) -> th.Tensor:
        """Return the sum, shape (*, outputs).

        :param inputs: shape (*, inputs)
        """
        return self.linear(inputs) + self.correction(inputs)


class TimeFeatures(nn.Module):
    """Time as a vector: t itself, and sines and cosines up to a highest frequency.

    A multi-layer perceptron fed with t alone is slow to learn a path that bends several times;
    the thesis's networks are fed with t alone (``n_frequencies = 0``).

    :param n_frequencies: number of frequencies: 1/2, 1, 3/2, ... periods over [0, 1]
    """

    frequencies: th.Tensor

    def __init__(self, n_frequencies: int) -> None:
        super().__init__()
        self.n_features = 1 + 2 * n_frequencies
        self.register_buffer("frequencies", math.pi * th.arange(1, n_frequencies + 1))

    def forward(self, times: th.Tensor) -> th.Tensor:
        """Return the features, shape (*, n_features).

        :param times: in [0, 1], shape (*,)
        """
        angles = times[..., None] * self.frequencies
        return th.cat([times[..., None], angles.sin(), angles.cos()], dim=-1)


def _bases_of(features: th.Tensor) -> th.Tensor:
    """Return what a trend is linear in at each time: its features, and 1."""
    return nn.functional.pad(features, (0, 1), value=1.0)


class TrajectoryDecoder(nn.Module):
    """From a latent, a condition and target times to the values at those times.

    The first layer is split by what varies with time and what does not, so that a batch of
    trajectories over common times costs the time features once.

    :param n_frequencies: of the time features
    :param inputs: size of latent and condition together
    :param arch: hidden layers
    :param outputs: size of the output at each target time
    :param activation_fn: between the layers
    :param trend_dim: adds to so many of the outputs, the first ones, a trend that is linear in the
        inputs and in the time features. It is what few examples determine best
    :param beside: size of further inputs that the trend alone sees
    :param n_members: E
    """

    def __init__(
        self,
        n_frequencies: int,
        inputs: int,
        arch: list[int],
        outputs: int,
        activation_fn: type[nn.Module],
        trend_dim: int = 0,
        beside: int = 0,
        n_members: int = 1,
    ) -> None:
        super().__init__()
        self.features = TimeFeatures(n_frequencies)
        self.from_time = linear(self.features.n_features, arch[0], n_members)
        self.from_latent = linear(inputs, arch[0], n_members, bias=False)
        self.activation = activation_fn()
        self.layers = mlp([*arch, outputs], activation_fn, n_members)
        self.trend: nn.Linear | MemberLinear | None = None
        if trend_dim:
            n_bases = self.features.n_features + 1
            self.trend = linear(inputs + beside, n_bases * trend_dim, n_members)
            for parameter in self.trend.parameters():
                nn.init.zeros_(parameter)

    def forward(
        self, times: th.Tensor, constant: th.Tensor, beside: th.Tensor | None = None
    ) -> th.Tensor:
        """Return the outputs, shape (B, T, outputs), or (E, B, T, outputs).

        :param times: target times, shape (T,) or (B, T), or (E, 1, T) or (E, B, T)
        :param constant: latent and condition, shape (B, inputs), or (E, B, inputs)
        :param beside: what the trend alone sees, shape (B, beside), or (E, B, beside)
        """
        features = self.features(times)
        hidden = self.from_time(features) + self.from_latent(constant)[..., None, :]
        outputs = self.layers(self.activation(hidden))
        if self.trend is None:
            return outputs
        bases = _bases_of(features).expand(*outputs.shape[:-1], -1)
        seen = constant if beside is None else th.cat([constant, beside], dim=-1)
        trend = bases @ self.trend(seen).unflatten(-1, (bases.shape[-1], -1))
        return outputs + nn.functional.pad(trend, (0, outputs.shape[-1] - trend.shape[-1]))

    @th.no_grad()
    def fit_trend(self, times: th.Tensor, condition: th.Tensor, values: th.Tensor) -> None:
        """Let the mean be the ridge regression of trajectories on a condition, of all members.

        That is the trend's part; what the layers add to it begins at 0.

        :param times: shape (T,)
        :param condition: the last K of the inputs, shape (N, K)
        :param values: of the trend's outputs, shape (N, T, trend_dim)
        """
        bases = _bases_of(self.features(times)).double()
        gram = bases.T @ bases
        gram.diagonal().add_(TIME_RIDGE * len(bases))
        weights = th.linalg.solve(gram, bases.T @ values.double().movedim(0, 1).flatten(1))
        wanted = weights.unflatten(1, (len(values), -1)).movedim(1, 0).flatten(1)
        rows = condition.double().cpu().numpy()
        penalty = TREND_RIDGE * len(rows)
        centre, middle, slopes = linear_regression(rows, wanted.cpu().numpy(), penalty)
        weight, bias = weight_and_bias(self.trend)
        weight.zero_()
        weight[..., -len(slopes) :, :] = th.as_tensor(slopes)
        bias[:] = th.as_tensor(middle - centre @ slopes)
        for parameter in weight_and_bias(self.layers[-1]):
            parameter[..., : values.shape[-1]] = 0.0
