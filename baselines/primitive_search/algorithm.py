"""`PrimitiveSearch`: searches over the weights of a movement primitive, in one context each."""

from abc import abstractmethod
from typing import ClassVar, Literal, Unpack

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv

from baselines.primitive_search.points import PointSearch
from baselines.primitive_search.policies import StartPolicy
from baselines.primitives.pd_filtered import bends
from sb3_nmp.bayesian.search import Subspace
from sb3_nmp.bayesian.shaped_noise import noise_directions, spread_over_time
from sb3_nmp.common.adaptive import AdaptiveAlgorithm, AdaptiveArguments
from sb3_nmp.common.pd_controller import PDController
from sb3_nmp.common.settings import Rules

FloatArray = NDArray[np.float64]
Controller = PDController | Literal["auto"] | None


class PrimitiveSearchArguments(AdaptiveArguments, total=False):
    """Those that all searches over primitives share; `PrimitiveSearch` describes them."""

    population_size: int
    max_generations: int
    n_bases: int
    shaped: float
    pd_controller: Controller


class PrimitiveSearch(AdaptiveAlgorithm):
    """Search over the weights of smooth bases that bend a trajectory, in each context anew.

    The trajectory is what a regression on the demonstrations answers
    (``policy_kwargs={"regression": ...}``, see `StartPolicy`); without demonstrations it is the
    environment's initial trajectory in the first context. Independent weights of standard deviation
    1 bend it by ``exploration_scale``, as root mean square over time. A subclass chooses the
    weights that are tried (`_search_in`). Solutions are remembered, but not learned.

    :param population_size: rollouts per generation in each context that is searched
    :param n_bases: smooth bases, per dimension (`SmoothNoise`)
    :param shaped: share of the exploration's variance that is shaped like the demonstrations, as
        in `sb3_nmp.ShapedExploration`
    :param pd_controller: through which the bends are executed (Eq. 6.3), so that trajectories start
        and end as the first one does; ``"auto"`` is a `PDController` without demonstrations and
        none with them, whose starts and ends may differ
    """

    policy: StartPolicy
    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": StartPolicy}
    needs_demonstrations: ClassVar[bool] = False

    def __init__(
        self,
        policy: str | type[StartPolicy],
        env: GymEnv | str,
        *,
        population_size: int = 5,
        max_generations: int = 200,
        n_bases: int = 10,
        shaped: float = 0.0,
        pd_controller: Controller = "auto",
        **shared: Unpack[AdaptiveArguments],
    ) -> None:
        was_shown = shared.get("demonstrations") is not None
        if pd_controller == "auto":
            pd_controller = None if was_shown else PDController()
        self.n_bases, self.shaped, self.pd_controller = n_bases, shaped, pd_controller
        self._mixing: FloatArray | None = None
        super().__init__(
            policy, env, population_size=population_size, max_generations=max_generations, **shared
        )

    @abstractmethod
    def _search_in(self, space: Subspace) -> PointSearch:
        """Return a search in a space of trajectories.

        :param space: whose origin is where the search starts
        """

    def _rules(self) -> Rules:
        shown = self.demonstrations_digest is not None
        return {
            "n_bases": (self.n_bases >= 2, ">= 2"),
            "shaped": (
                0 <= self.shaped <= 1 and (shown or self.shaped == 0),
                "in [0, 1], and 0 without demonstrations, which tell how trajectories vary",
            ),
            **super()._rules(),
        }

    def _setup_model(self) -> None:
        super()._setup_model()
        if self.demonstrations is not None:
            self.policy.learn_demonstrations(self.demonstrations)
            self._mixing = spread_over_time(self.demonstrations, self.shaped)

    def _begin_generation(self) -> None:
        if self._n_updates == 0 and not self.policy.was_shown:
            self.policy.set_initial(self.initial_trajectory())
        super()._begin_generation()

    def _new_search(self, context: NDArray[np.float32]) -> PointSearch:
        start = self.policy.start(context[None])[0]
        return self._search_in(Subspace(start, self.directions()))

    def directions(self) -> FloatArray:
        """Return what a weight of 1 adds to the trajectory, shape (n_bases * D, T, D)."""
        n_time_points, n_dimensions = self.policy.trajectory_shape
        everywhere = np.tile(np.eye(n_dimensions), (n_time_points, 1, 1))
        mixing = everywhere if self._mixing is None else self._mixing
        directions = noise_directions(mixing * np.asarray(self.first_scale()), self.n_bases)
        return directions if self.pd_controller is None else bends(self.pd_controller, directions)
