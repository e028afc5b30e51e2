"""Networks of one architecture stacked into one, with the state of their optimizers.

Shape letters: S networks.
"""

from collections.abc import Hashable, Sequence

import torch as th
from torch import nn
from torch.optim import Adam, AdamW, Optimizer


def shapes_of(network: nn.Module) -> Hashable:
    """Return what two networks must share to be stacked.

    :param network: whose modules and parameters count, not their values
    """
    return str(network), tuple(
        (name, each.shape, each.dtype, each.device) for name, each in network.named_parameters()
    )


def stage_of(optimizer: Optimizer) -> Hashable:
    """Return what two optimizers must share to be stacked: settings, and steps done.

    Adam treats each number by itself. So it does the same to stacked networks; others may not, and
    are like none but themselves.

    :param optimizer: of one network
    """
    if type(optimizer) not in (Adam, AdamW) or len(optimizer.param_groups) != 1:
        return id(optimizer)
    steps = {float(state["step"]) for state in optimizer.state.values()}
    return type(optimizer), repr(_settings(optimizer)), tuple(sorted(steps))


def _settings(optimizer: Optimizer) -> dict[str, object]:
    group = optimizer.param_groups[0]
    return {name: value for name, value in group.items() if name != "params"}


class Stack:
    """Networks whose parameters are trained as one, and given back.

    >>> networks = [nn.Linear(2, 1), nn.Linear(2, 1)]
    >>> optimizers = [Adam(each.parameters()) for each in networks]
    >>> stack = Stack(networks, optimizers)
    >>> stack.parameters["weight"].shape
    torch.Size([2, 1, 2])

    :param networks: of equal `shapes_of`
    :param optimizers: one for each, of all its parameters, of equal `stage_of`
    """

    def __init__(self, networks: Sequence[nn.Module], optimizers: Sequence[Optimizer]) -> None:
        self._each = [dict(network.named_parameters()) for network in networks]
        self._optimizers = optimizers
        #: by name, shape (S, *)
        self.parameters = {
            name: nn.Parameter(th.stack([each[name].detach() for each in self._each]))
            for name in self._each[0]
        }
        #: of all of them
        self.optimizer = Adam(self.parameters.values(), **_settings(optimizers[0]))  # pyright: ignore[reportArgumentType]
        for name, parameter in self.parameters.items():
            states = [
                optimizer.state[each[name]]
                for each, optimizer in zip(self._each, optimizers, strict=True)
                if each[name] in optimizer.state  # not before its first step
            ]
            if states:
                self.optimizer.state[parameter] = _stacked(states)

    @th.no_grad()
    def give_back(self) -> None:
        """Write parameters and states into the networks and their optimizers."""
        for name, stacked in self.parameters.items():
            state = self.optimizer.state.get(stacked, {})
            for s, (each, optimizer) in enumerate(zip(self._each, self._optimizers, strict=True)):
                each[name].copy_(stacked[s])
                if state:  # none without a gradient
                    optimizer.state[each[name]] = {
                        key: value.clone() if key == "step" else value[s].clone()
                        for key, value in state.items()
                    }


def _stacked(states: Sequence[dict[str, th.Tensor]]) -> dict[str, th.Tensor]:
    """Return the states of one parameter as one; they have done as many steps."""
    return {
        key: value.clone() if key == "step" else th.stack([state[key] for state in states])
        for key, value in states[0].items()
    }
