"""`ACNMP`: learning from demonstration and policy gradient in one latent space (thesis ch. 5)."""

from dataclasses import replace
from typing import Any, ClassVar, Self, cast

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv, Schedule
from stable_baselines3.common.utils import update_learning_rate

from sb3_nmp.acnmp.exploration import Exploration, directions
from sb3_nmp.acnmp.losses import (
    Advantage,
    advantages,
    check_advantage,
    policy_gradient_loss,
)
from sb3_nmp.acnmp.policies import ACNMPPolicy
from sb3_nmp.acnmp.search import LatentSearch
from sb3_nmp.common.adaptive import AdaptiveAlgorithm, Case
from sb3_nmp.common.algorithm import Generation
from sb3_nmp.common.cnmp import (
    PointSampler,
    PretrainingSettings,
    cosine,
    negative_log_likelihood,
    pretrain,
)
from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.exceptions import ConfigurationError

DEFAULT_PRETRAINING = PretrainingSettings()
DEFAULT_EXPLORATION = Exploration()


class ACNMP(AdaptiveAlgorithm):
    """Adaptive conditional neural movement primitives.

    The steps are those of Fig. 5.1. (I) A CNMP is trained on the demonstrations (Eq. 4.1).
    (II-IV) It answers each context with a trajectory, which is executed. (V) Where that is not
    satisfactory, a search begins. (VI) Rollouts explore directions that the latent space of the
    demonstrations gives, beside smooth noise that is shaped like them (`Exploration`). (VII) The
    network is trained on these rollouts by policy gradient (Eq. 5.2) and on the demonstrations by
    likelihood (Eq. 4.1) in alternating steps. (VIII) A solved context is assimilated: its
    trajectory joins the demonstrations.

    On an environment with a fixed context it adapts to that context for the whole budget; on one
    that draws contexts it improves itself over the stream of them (`AdaptiveAlgorithm`).

    Where this departs from the thesis: a generation has ``population_size`` rollouts instead of
    two, and a critic (`Critic`) chooses them by all earlier rollouts in the context instead of
    sampling around the policy's mean; ``use_critic=False`` samples as the thesis does. What each
    part brings is measured in ``results/experiments/acnmp.md``.

    :param policy: the policy's class or ``"MlpPolicy"``
    :param env: the environment or its id; T x D trajectories as actions, contexts as observations
    :param demonstrations: of the expert
    :param learning_rate: of Adam after the pre-training, or a schedule of it; after each
        generation it starts there and falls to a hundredth along a cosine
    :param population_size: rollouts a generation in each context that is searched; a multiple of
        the number of environments
    :param n_contexts: new contexts that are tried at once; None: ``population_size``
    :param exploration: directions and scales of exploration
    :param use_critic: whether a Gaussian process proposes the rollouts of a search
    :param advantage: of the policy gradient, see `Advantage`; without a critic, ``"place"`` is of
        the last generation too
    :param supervised: train on demonstrations between the policy gradient steps; False is the
        thesis's RL-only ablation
    :param pretraining: length and batches of the training on demonstrations
    :param n_training_steps: pairs of alternating steps after a generation
    :param n_assimilation_steps: steps of supervised learning after contexts have been assimilated
    :param reward_threshold: a rollout that succeeds with at least this reward needs no search, or
        ends it; None asks for success alone, two values tell these apart
    :param max_generations: after so many it ends in any case
    :param policy_kwargs: further arguments of the policy, such as ``{"cnmp": CNMPSettings(...)}``
    :param stats_window_size: rollouts over which the logged success rate and reward are averaged
    :param tensorboard_log: folder for TensorBoard; None switches it off
    :param verbose: 0 nothing, 1 the log table, 2 debug messages
    :param seed: equal seeds give equal runs, bit for bit
    :param device: of the network
    :param _init_setup_model: whether to build the network at once
    :raises ConfigurationError: no demonstrations, or a setting outside its range
    :raises InvalidDataError: demonstrations that do not fit the environment
    """

    policy: ACNMPPolicy
    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": ACNMPPolicy}

    def __init__(
        self,
        policy: str | type[ACNMPPolicy],
        env: GymEnv | str,
        demonstrations: Demonstrations | None = None,
        learning_rate: float | Schedule = 1e-3,
        population_size: int = 3,
        n_contexts: int | None = None,
        exploration: Exploration = DEFAULT_EXPLORATION,
        use_critic: bool = True,
        advantage: Advantage = "place",
        supervised: bool = True,
        pretraining: PretrainingSettings = DEFAULT_PRETRAINING,
        n_training_steps: int = 10,
        n_assimilation_steps: int = 50,
        reward_threshold: float | tuple[float, float] | None = None,
        max_generations: int = 20,
        policy_kwargs: dict[str, Any] | None = None,
        stats_window_size: int = 100,
        tensorboard_log: str | None = None,
        verbose: int = 0,
        seed: int | None = None,
        device: th.device | str = "auto",
        _init_setup_model: bool = True,
    ) -> None:
        check_advantage(advantage)
        for name, steps in (
            ("n_training_steps", n_training_steps),
            ("n_assimilation_steps", n_assimilation_steps),
        ):
            if steps < 0:
                raise ConfigurationError(f"{name} is {steps}; it must be >= 0.")
        self.exploration = exploration
        self.use_critic = use_critic
        self.advantage: Advantage = advantage
        self.supervised = supervised
        self.pretraining = pretraining
        self.n_training_steps = n_training_steps
        self.n_assimilation_steps = n_assimilation_steps
        self.is_pretrained = False
        super().__init__(
            policy=policy,
            env=env,
            demonstrations=demonstrations,
            population_size=population_size,
            n_contexts=n_contexts,
            reward_threshold=reward_threshold,
            max_generations=max_generations,
            learning_rate=learning_rate,
            policy_kwargs=policy_kwargs,
            stats_window_size=stats_window_size,
            tensorboard_log=tensorboard_log,
            verbose=verbose,
            seed=seed,
            device=device,
            _init_setup_model=_init_setup_model,
        )

    # -- learning from demonstration (I) -------------------------------------------------------

    def pretrain(self) -> Self:
        """Train the CNMP on the demonstrations (Eq. 4.1); `learn` does so first by itself.

        :raises ConfigurationError: the model was loaded without its demonstrations
        """
        self.check_can_go_on()
        pretrain(self.training_set(), self.pretraining, self.rng, self.policy.cnmp)
        self.is_pretrained = True
        return self

    def _setup_learn(self, *args: Any, **kwargs: Any) -> tuple[int, Any]:  # noqa: ANN401
        if not self.is_pretrained:
            self.pretrain()  # first, so that callbacks find a policy that can answer
        if self.exploration.sigma is None:
            self.exploration = replace(self.exploration, sigma=self.exploration_scale())
        return super()._setup_learn(*args, **kwargs)

    def predict(
        self,
        observation: NDArray[Any] | dict[str, NDArray[Any]],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[Any] | None = None,
        deterministic: bool = False,
        via_points: tuple[ArrayLike, ArrayLike] | None = None,
    ) -> tuple[NDArray[Any], tuple[NDArray[Any], ...] | None]:
        """Return a trajectory for a context, or for each of several; see SB3.

        :param observation: context of shape (C,), or (N, C)
        :param state: unused
        :param episode_start: unused
        :param deterministic: the greedy trajectory instead of a sample
        :param via_points: conditioning points that the trajectory is to pass: times in [0, 1],
            shape (O,), and values in the trajectory's unit, shape (O, D)
        :return: shape (T, D), or (N, T, D); and ``state``
        :raises InvalidDataError: via-points of a wrong shape, or times outside [0, 1]
        """
        if via_points is None:
            return super().predict(observation, state, episode_start, deterministic)
        contexts, vectorized = self.policy.obs_to_tensor(observation)
        space = cast(spaces.Box, self.action_space)
        with th.no_grad():
            passing = self.policy.through(cast(th.Tensor, contexts), via_points, deterministic)
        trajectories = np.clip(passing.cpu().numpy(), space.low, space.high)
        return (trajectories if vectorized else trajectories[0]), state

    # -- the search (VI) -----------------------------------------------------------------------

    def _new_search(self, context: NDArray[np.float32]) -> LatentSearch:
        cnmp = self.policy.cnmp
        row = context[None].astype(np.float64)
        return LatentSearch(
            cnmp.trajectories(row)[0],
            directions(self.exploration, cnmp, cast(Demonstrations, self.demonstrations), row[0]),
            use_critic=self.use_critic,
            pull=self.exploration.pull,
        )

    # -- simultaneous training (VII, VIII) -----------------------------------------------------

    def _adapt(self, searched: list[Case], solved: list[Case]) -> None:
        policy = self.policy
        policy.train()
        n_steps = self.n_training_steps + (self.n_assimilation_steps if solved else 0)
        sampler = self._sampler()
        tried = self._tried(searched) if self.n_training_steps else []
        highest = self.lr_schedule(self._current_progress_remaining)
        for step, batch in enumerate(sampler.draw(n_steps)):
            update_learning_rate(policy.optimizer, cosine(highest, step / n_steps))
            losses = []
            if self.supervised:
                losses.append(negative_log_likelihood(policy.cnmp.network, batch))
            if step < self.n_training_steps:
                losses.append(self._policy_gradient_loss(searched, tried))
            for loss in losses:
                policy.optimizer.zero_grad()
                loss.backward()
                policy.optimizer.step()
        policy.train(False)
        if not self.use_critic:
            for case in self.cases:
                search = cast(LatentSearch, case.search)
                search.mean = policy.cnmp.trajectories(case.context[None])[0]

    def _sampler(self) -> PointSampler:
        cnmp, known = self.policy.cnmp, self.training_set()
        return PointSampler(
            self.pretraining,
            cnmp.times,
            cnmp.normalise(cnmp.times.new_tensor(known.trajectories)),
            cnmp.condition(cnmp.times.new_tensor(known.contexts)),
            self.rng,
        )

    def _tried(self, searched: list[Case]) -> list[tuple[th.Tensor, th.Tensor]]:
        """Return each case's normalised trajectories (N, T, D) and their advantages (N, T)."""
        cnmp, pairs = self.policy.cnmp, []
        for case in searched:
            rollouts = self._learned_from(cast(LatentSearch, case.search))
            trajectories = cnmp.normalise(cnmp.times.new_tensor(rollouts.trajectories))
            weights = cnmp.times.new_tensor(advantages(self.advantage, rollouts))
            pairs.append((trajectories, weights))
        return pairs

    def _policy_gradient_loss(
        self, searched: list[Case], tried: list[tuple[th.Tensor, th.Tensor]]
    ) -> th.Tensor:
        """Return Eq. 5.2's loss over the contexts that are searched."""
        cnmp = self.policy.cnmp
        contexts = cnmp.times.new_tensor(np.stack([case.context for case in searched]))
        condition = cnmp.condition(contexts)
        means = cnmp.network.decode(cnmp.times, cnmp.representation(condition), condition).mean
        loss = means.new_zeros(())
        for mean, (trajectories, weights) in zip(means, tried, strict=True):
            loss = loss + policy_gradient_loss(mean, trajectories, weights)
        return loss / len(searched)

    def _learned_from(self, search: LatentSearch) -> Generation:
        """Return the rollouts of the policy gradient: all of them if a critic chose them."""
        if self.use_critic and self.advantage == "place":
            return Generation.concatenate(search.rollouts)
        return search.rollouts[-1]

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        return ["policy", "policy.optimizer"], []
