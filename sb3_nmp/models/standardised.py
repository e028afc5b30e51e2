"""`Standardised`: data in units of their own standard deviation."""

import torch as th
from torch import nn


class Standardised(nn.Module):
    """Mean and standard deviation of data, kept with a network.

    :param size: of a row
    """

    mean: th.Tensor
    std: th.Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("mean", th.zeros(size))
        self.register_buffer("std", th.ones(size))

    def take(self, rows: th.Tensor, groups: int | None = None) -> None:
        """Take over the mean and the standard deviation of rows.

        :param rows: shape (N, size)
        :param groups: entries that are so many apart share a standard deviation, at least 1e-6: a
            network's output that never changed stays where it is. By default none do, and an entry
            that is constant keeps its own unit: an input that was never seen to change
        """
        self.mean.copy_(rows.mean(dim=0))
        square = ((rows - self.mean) ** 2).mean(dim=0)
        if groups is not None:
            square = square.unflatten(0, (-1, groups)).mean(dim=0).repeat(len(square) // groups)
            self.std.copy_(square.sqrt().clamp(min=1e-6))
        else:
            is_constant = square <= 1e-12 * self.mean**2  # but for rounding
            self.std.copy_(th.where(is_constant, 1.0, square.sqrt()))

    def forward(self, rows: th.Tensor) -> th.Tensor:
        """Return rows with mean 0 and standard deviation 1.

        :param rows: shape (..., size)
        """
        return (rows - self.mean) / self.std
