"""The policy of contextual searches: a Gaussian whose mean is linear in features of the context."""

from typing import Literal

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.type_aliases import Schedule

from baselines.contextual.features import Features, FloatArray, feature_rule, make_features
from baselines.reps.policies import GaussianPrimitivePolicy
from sb3_nmp.common.exceptions import ConfigurationError
from sb3_nmp.common.pd_controller import PDController


class ContextualGaussianPolicy(GaussianPrimitivePolicy):
    """Weights w ~ N(mean(features of the context), covariance); greedy is the mean.

    >>> from gymnasium.spaces import Box
    >>> policy = ContextualGaussianPolicy(Box(-1, 1, (2,)), Box(0, 4, (30, 1)), n_bases=5)
    >>> tuple(policy.coefficients.shape)  # 1, two entries, three products; five weights
    (6, 5)

    :param observation_space: contexts, shape (C,)
    :param action_space: trajectories, shape (T, D)
    :param lr_schedule: not used here; SB3 passes it to every policy
    :param primitive: ``"promp"`` or ``"dmp"``
    :param n_bases: K, bases per dimension
    :param pd_controller: through which a ProMP is executed; None executes it as it is
    :param context_features: ``"linear"`` or ``"quadratic"``, of the context scaled to [-1, 1]
    :raises ConfigurationError: there are no such features or no such primitive
    """

    def __init__(
        self,
        observation_space: spaces.Box,
        action_space: spaces.Box,
        lr_schedule: Schedule | None = None,
        primitive: Literal["promp", "dmp"] = "promp",
        n_bases: int = 10,
        pd_controller: PDController | None = None,
        context_features: Features = "quadratic",
    ) -> None:
        fits, rule = feature_rule(context_features)
        if not fits:
            raise ConfigurationError(
                f"context_features is {context_features!r}; it must be {rule}."
            )
        super().__init__(
            observation_space, action_space, lr_schedule, primitive, n_bases, pd_controller
        )
        self.settings |= {"context_features": context_features}
        self.context_features: Features = context_features
        n_features = len(self.features(np.zeros((1, self.context_dim)))[0])
        mean = self.coefficients[0]
        self.coefficients = th.zeros(n_features, len(mean), dtype=th.float64)
        self.coefficients[0] = mean

    def scaled(self, contexts: NDArray[np.floating]) -> FloatArray:
        """Return contexts scaled to [-1, 1] by their space, shape (N, C).

        :param contexts: shape (N, C)
        """
        return super().features(contexts)[:, 1:]

    def features(self, contexts: NDArray[np.floating]) -> FloatArray:
        """Return the features of contexts, shape (N, F).

        :param contexts: shape (N, C)
        """
        return make_features(self.scaled(contexts), self.context_features)
