"""`Ensemble`: several perceptrons, each with a linear part, trained as one batched model.

Shape letters: E members, N rows, I inputs, K outputs.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch as th
from numpy.typing import NDArray
from torch import nn

from sb3_nmp.common.settings import settings_name


@settings_name("ensemble-training")
@dataclass(frozen=True)
class EnsembleTraining:
    """How an ensemble is trained; each member draws batches of its own.

    :param learning_rate: of AdamW
    :param weight_decay: of AdamW
    :param batch_size: rows per step and member
    :param huber: errors above this count linearly (Huber's loss), as where outliers are real; None
        counts all squared
    """

    learning_rate: float = 3e-3
    weight_decay: float = 0.01
    batch_size: int = 128
    huber: float | None = None

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
        loss: Callable[[th.Tensor, th.Tensor], th.Tensor] | None = None,
        shares: NDArray[np.float64] | None = None,
    ) -> None:
        """Regress targets on inputs.

        :param inputs: shape (N, I)
        :param targets: shape (N, K)
        :param n_steps: of the optimizer
        :param training: rate and batches
        :param generator: draws the batches
        :param loss: of outputs and targets, both (E, rows, K); None takes that of ``training``
        :param shares: with which rows are drawn, shape (N,); None draws all alike
        """
        measure = training.loss if loss is None else loss
        self.requires_grad_(True)
        optimizer = th.optim.AdamW(
            self.parameters(), training.learning_rate, weight_decay=training.weight_decay
        )
        size = min(len(inputs), training.batch_size)
        for _ in range(n_steps):
            rows = self._draw(len(inputs), size, shares, generator)
            error = measure(self(inputs[rows]), targets[rows])
            optimizer.zero_grad()
            error.backward()
            optimizer.step()
        self.requires_grad_(False)  # what follows are gradients for the inputs

    def _draw(
        self,
        n: int,
        size: int,
        shares: NDArray[np.float64] | None,
        generator: th.Generator,
    ) -> th.Tensor:
        """Return the rows of a batch for each member, shape (E, size)."""
        if shares is None:
            return th.randint(n, (self.n_members, size), generator=generator)
        drawn = th.multinomial(
            th.as_tensor(shares), self.n_members * size, replacement=True, generator=generator
        )
        return drawn.view(self.n_members, size)
