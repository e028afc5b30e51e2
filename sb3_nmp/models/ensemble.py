"""`Ensemble`: several perceptrons, each with a linear part, trained as one batched model.

Shape letters: E members, N rows, I inputs, K outputs.
"""

from collections.abc import Callable, Hashable, Sequence
from copy import deepcopy
from dataclasses import dataclass
from itertools import pairwise
from typing import Self

import numpy as np
import torch as th
from numpy.typing import NDArray
from torch import nn

from sb3_nmp.common.lockstep import TrainingPhase, train
from sb3_nmp.common.settings import Rules, Settings, settings_name, whole

#: of outputs and targets, both (E, rows, K): a mean over members and rows
Loss = Callable[[th.Tensor, th.Tensor], th.Tensor]


@settings_name("ensemble-training")
@dataclass(frozen=True)
class EnsembleTraining(Settings):
    """How an ensemble is trained; each member draws batches of its own.

    :param learning_rate: of AdamW
    :param weight_decay: of AdamW
    :param batch_size: rows per step and member
    :param huber: errors above this count linearly (Huber's loss), as where outliers are real; None
        counts all squared
    :raises ConfigurationError: a value outside its range
    """

    learning_rate: float = 3e-3
    weight_decay: float = 0.01
    batch_size: int = 128
    huber: float | None = None

    def rules(self) -> Rules:
        """Return the rules of the values."""
        return {
            "learning_rate": (self.learning_rate > 0, "> 0"),
            "weight_decay": (self.weight_decay >= 0, ">= 0"),
            "batch_size": whole(self.batch_size, least=1),
            "huber": (self.huber is None or self.huber > 0, "> 0, or None"),
        }

    def loss(self, predicted: th.Tensor, wanted: th.Tensor) -> th.Tensor:
        """Return the mean error, squared or Huber's.

        :param predicted: shape (E, rows, K)
        :param wanted: shape (E, rows, K)
        """
        if self.huber is None:
            return nn.functional.mse_loss(predicted, wanted)
        return nn.functional.smooth_l1_loss(predicted, wanted, beta=self.huber)


class Ensemble(nn.Module):
    """Members that differ by their first weights and by their batches; their spread is a doubt.

    A member is a perceptron plus a linear map: few rows determine the linear part best.

    >>> ensemble = Ensemble([2, 8, 1], n_members=5, generator=th.Generator().manual_seed(0))
    >>> ensemble(th.zeros(3, 2)).shape
    torch.Size([5, 3, 1])

    :param sizes: of inputs, hidden layers and outputs
    :param n_members: E
    :param generator: of the first weights
    """

    def __init__(self, sizes: list[int], n_members: int, generator: th.Generator) -> None:
        super().__init__()
        self.weights, self.biases = nn.ParameterList(), nn.ParameterList()
        for layer, (inputs, outputs) in enumerate(pairwise(sizes)):
            scale = inputs**-0.5 * (0.1 if layer == len(sizes) - 2 else 1.0)
            drawn = th.randn(n_members, inputs, outputs, generator=generator)
            self.weights.append(nn.Parameter(scale * drawn))
            self.biases.append(nn.Parameter(th.zeros(n_members, 1, outputs)))
        self.linear = nn.Parameter(th.zeros(n_members, sizes[0], sizes[-1]))

    @property
    def n_members(self) -> int:
        """E."""
        return len(self.linear)

    @th.no_grad()
    def begin_with(self, slopes: th.Tensor) -> None:
        """Make every member the same linear map, to which training adds.

        :param slopes: shape (I, K)
        """
        self.linear.copy_(slopes)
        self.weights[-1].zero_()

    def forward(self, rows: th.Tensor) -> th.Tensor:
        """Return each member's outputs, shape (E, N, K).

        :param rows: for all members, shape (N, I), or for each its own, shape (E, N, I)
        """
        inputs = rows.expand(self.n_members, *rows.shape[-2:])
        hidden = inputs
        last = len(self.weights) - 1
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            hidden = th.baddbmm(bias, hidden, weight)
            if layer < last:
                hidden = nn.functional.silu(hidden)
        return hidden + inputs @ self.linear

    def fit(
        self,
        inputs: th.Tensor,
        targets: th.Tensor,
        n_steps: int,
        training: EnsembleTraining,
        generator: th.Generator,
        loss: Loss | None = None,
        shares: NDArray[np.float64] | None = None,
    ) -> None:
        """Regress targets on inputs.

        :param inputs: shape (N, I)
        :param targets: shape (N, K)
        :param n_steps: of the optimizer
        :param training: rate and batches
        :param generator: draws the batches
        :param loss: to be minimised; None takes that of ``training``
        :param shares: with which rows are drawn, shape (N,); None draws all alike
        """
        train(Regression(self, inputs, targets, n_steps, training, generator, loss, shares))

    @classmethod
    def joined(cls, ensembles: Sequence[Self]) -> Self:
        """Return the members of all ensembles as one; it shares nothing with them.

        :param ensembles: of equal sizes
        """
        joined = deepcopy(ensembles[0])
        for parameter, *each in zip(*(e.parameters() for e in (joined, *ensembles)), strict=True):
            parameter.data = th.cat([one.detach() for one in each])
        return joined

    @th.no_grad()
    def take(self, joined: Self, first: int) -> None:
        """Take parameters from an ensemble that these members were joined to.

        :param joined: the larger ensemble
        :param first: the place of the first of these members in it
        """
        for own, larger in zip(self.parameters(), joined.parameters(), strict=True):
            own.copy_(larger[first : first + self.n_members])


@dataclass(frozen=True, eq=False)
class Regression(TrainingPhase):
    """What `Ensemble.fit` does, with its parameters."""

    ensemble: Ensemble
    inputs: th.Tensor
    targets: th.Tensor
    n_steps: int
    training: EnsembleTraining
    generator: th.Generator
    loss: Loss | None
    shares: NDArray[np.float64] | None

    @property
    def kind(self) -> Hashable:
        """Sizes, number of steps, batches and loss."""
        shapes = tuple(parameter.shape for parameter in self.ensemble.parameters())
        return shapes, self.n_steps, self.training, self._size, self.loss

    @property
    def _size(self) -> int:
        """Rows of a batch."""
        return min(len(self.inputs), self.training.batch_size)

    def alone(self) -> None:
        """Train the ensemble."""
        _minimise(self.ensemble, [self])

    @classmethod
    def as_one(cls, phases: Sequence[Self]) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Train all members as those of one ensemble.

        :param phases: of one kind
        """
        joined, first = Ensemble.joined([phase.ensemble for phase in phases]), 0
        _minimise(joined, phases)
        for phase in phases:
            phase.ensemble.take(joined, first)
            phase.ensemble.requires_grad_(False)
            first += phase.ensemble.n_members

    def draw(self) -> tuple[th.Tensor, th.Tensor]:
        """Draw a batch for each member: inputs (E, rows, I) and targets (E, rows, K)."""
        n, shape = len(self.inputs), (self.ensemble.n_members, self._size)
        if self.shares is None:
            rows = th.randint(n, shape, generator=self.generator)
        else:
            shares = th.as_tensor(self.shares)
            drawn = th.multinomial(
                shares, shape[0] * shape[1], replacement=True, generator=self.generator
            )
            rows = drawn.view(shape)
        return self.inputs[rows], self.targets[rows]


def _minimise(ensemble: Ensemble, phases: Sequence[Regression]) -> None:
    """Train an ensemble whose members are those of all phases, in their order."""
    training, n = phases[0].training, len(phases)
    measure = training.loss if phases[0].loss is None else phases[0].loss
    ensemble.requires_grad_(True)
    optimizer = th.optim.AdamW(
        ensemble.parameters(),
        training.learning_rate,
        weight_decay=training.weight_decay,
        fused=n > 1,  # rounds otherwise, so that what one learns alone would change
    )
    for _ in range(phases[0].n_steps):
        batches = [phase.draw() for phase in phases]
        inputs, targets = batches[0] if n == 1 else map(th.cat, zip(*batches, strict=True))
        error = measure(ensemble(inputs), targets)
        optimizer.zero_grad()
        (error if n == 1 else n * error).backward()  # a mean over fewer is larger
        optimizer.step()
    ensemble.requires_grad_(False)  # what follows are gradients for the inputs
