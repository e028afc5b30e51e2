"""`GaussianSearch`: what all searches share that draw a primitive's weights from one Gaussian."""

from typing import Any, ClassVar, Literal, Unpack, cast

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv, Schedule
from stable_baselines3.common.vec_env import VecEnv

from baselines.reps.gaussian import FloatArray
from baselines.reps.policies import GaussianPrimitivePolicy
from sb3_nmp.common.algorithm import TrajectoryAlgorithm
from sb3_nmp.common.arguments import SharedArguments
from sb3_nmp.common.pd_controller import PDController
from sb3_nmp.common.settings import Rules

Controller = PDController | Literal["auto"] | None
PrimitiveName = Literal["promp", "dmp"]


class GaussianArguments(SharedArguments, total=False):
    """Those that all searches of this kind share; `GaussianSearch` describes them."""

    primitive: PrimitiveName
    n_bases: int
    pd_controller: Controller
    rollouts_per_context: int


class GaussianSearch(TrajectoryAlgorithm):
    """Draws the weights of a movement primitive from a Gaussian whose mean follows the context.

    The mean starts as the fit of the environment's initial trajectory in the first context, whose
    start and goal are the primitive's. With ``demonstrations`` it starts as the linear regression
    of the demonstrated weights on the context instead; start and goal are then part of the weights,
    and nothing forces them. A subclass adapts the Gaussian (`_end_generation`).

    :param demonstrations: of an expert, from which a ProMP without controller starts. They are not
        saved with the model
    :param primitive: ``"promp"`` or ``"dmp"``
    :param n_bases: of the primitive, per dimension
    :param pd_controller: through which trajectories are executed (Eq. 6.3), so that they start and
        end as the initial trajectory; ``"auto"`` is a `PDController` for a ProMP and none for a
        DMP, which ends at its goal by itself, and with demonstrations
    :param rollouts_per_context: members of a generation that share a context; more than 1 where
        contexts are fewer than rollouts
    """

    policy: GaussianPrimitivePolicy
    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": GaussianPrimitivePolicy}

    def __init__(
        self,
        policy: str | type[GaussianPrimitivePolicy],
        env: GymEnv | str,
        *,
        population_size: int,
        learning_rate: float | Schedule = 0.0,
        primitive: PrimitiveName = "promp",
        n_bases: int = 10,
        pd_controller: Controller = "auto",
        rollouts_per_context: int = 1,
        **shared: Unpack[SharedArguments],
    ) -> None:
        self._demonstrated = shared.get("demonstrations") is not None
        if pd_controller == "auto":
            free = primitive == "dmp" or self._demonstrated
            pd_controller = None if free else PDController()
        self.rollouts_per_context = rollouts_per_context
        self._started = False
        self._deviations: FloatArray | None = None
        self._weights: FloatArray | None = None
        self._contexts: NDArray[np.float32] | None = None
        chosen = {"primitive": primitive, "n_bases": n_bases, "pd_controller": pd_controller}
        shared["policy_kwargs"] = chosen | (shared.get("policy_kwargs") or {})
        super().__init__(
            policy, env, population_size=population_size, learning_rate=learning_rate, **shared
        )

    def _rules(self) -> Rules:
        chosen, n = self.policy_kwargs, self.population_size
        forced = chosen["primitive"] != "promp" or chosen["pd_controller"] is not None
        shares = 1 <= self.rollouts_per_context <= n and n % self.rollouts_per_context == 0
        return {
            "policy_kwargs": (
                not (self._demonstrated and forced),
                "those of primitive='promp' and pd_controller=None where demonstrations are given: "
                "a DMP and a controller force start and goal, which differ between demonstrations",
            ),
            "rollouts_per_context": (shares, f">= 1 and a divisor of the population of {n}"),
        }

    def _setup_model(self) -> None:
        super()._setup_model()
        if self.demonstrations is not None:
            shown = self.demonstrations
            self.policy.start_from_demonstrations(shown.contexts, shown.trajectories)

    def _made_with(self) -> dict[str, Any]:
        fixed = ("primitive", "n_bases", "pd_controller", "context_features")
        own = {name: value for name, value in self.policy_kwargs.items() if name in fixed}
        return super()._made_with() | own

    def _begin_generation(self) -> None:
        if not self._started:
            if self._demonstrated:
                self.policy.explore(self.first_scale())
            else:
                self.policy.start_from(self.initial_trajectory(), self.first_scale())
            self._started = True
        self._contexts = self._draw_contexts() if self.rollouts_per_context > 1 else None
        factor = np.linalg.cholesky(self.policy.gaussian.covariance)
        noise = self.rng.standard_normal((self.population_size, len(factor)))
        self._deviations = noise @ factor.T
        self._weights = np.zeros_like(noise)

    def _draw_contexts(self) -> NDArray[np.float32]:
        """Let the environments draw a generation's contexts, each several times, shape (n, C)."""
        env, n = cast(VecEnv, self.env), self.population_size // self.rollouts_per_context
        drawn = [np.array(self._last_obs, np.float32)]
        while sum(map(len, drawn)) < n:
            drawn.append(self._reset(env))
        self._last_obs = drawn[-1]
        return np.repeat(np.concatenate(drawn)[:n], self.rollouts_per_context, axis=0)

    def _wanted_contexts(self, members: slice) -> NDArray[np.float32] | None:
        return None if self._contexts is None else self._contexts[members]

    def _propose(self, members: slice, contexts: NDArray[np.float32]) -> NDArray[np.floating]:
        deviations, weights = cast(FloatArray, self._deviations), cast(FloatArray, self._weights)
        proposed: list[FloatArray] = []
        # one by one: a matrix product's last bits depend on how many members it is asked for
        for i, context in zip(range(members.start, members.stop), contexts, strict=True):
            weights[i] = self.policy.mean_weights(context) + deviations[i]
            proposed.append(self.policy.trajectory(weights[i]))
        return np.stack(proposed)
