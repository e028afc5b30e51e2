"""`check_algorithm`: whether an algorithm keeps the contract of SB3 and of the benchmark."""

from collections.abc import Callable
from typing import Any

import gymnasium as gym
from stable_baselines3.common.base_class import BaseAlgorithm

from sb3_nmp.checking import answers, learning
from sb3_nmp.checking.environments import ReachEnv
from sb3_nmp.checking.examined import Examined, apply, check_maker

#: a pinned context of `ReachEnv`
TARGET = 0.3
#: in this order: a rule relies on those before it
ALGORITHM_RULES: tuple[Callable[[Examined], None], ...] = (
    answers.it_is_an_algorithm_of_sb3,
    learning.trajectories_are_executable,
    learning.the_budget_is_spent_and_no_more,
    learning.a_seed_repeats_a_run,
    learning.global_generators_do_not_matter,
    answers.answers_are_trajectories,
    answers.greedy_answers_are_repeated,
    learning.looking_changes_nothing,
    learning.two_calls_are_one,
    learning.a_callback_ends_a_run,
    answers.a_file_keeps_the_answers,
    answers.a_run_goes_on_from_its_files,
    learning.environments_side_by_side_give_the_same_run,
    learning.contexts_may_be_drawn,
    learning.it_learns_from_what_it_says,
)


def examine(
    algorithm: type[BaseAlgorithm],
    make_env: Callable[[], gym.Env[Any, Any]] | None = None,
    **settings: Any,  # noqa: ANN401
) -> Examined:
    """Return an algorithm as `ALGORITHM_RULES` take it; see `check_algorithm`.

    :param algorithm: the class
    :param make_env: returns a new environment each time
    :param settings: constructor arguments
    """
    if make_env is None:
        if getattr(algorithm, "needs_demonstrations", False):
            settings = {"demonstrations": ReachEnv.demonstrations(), **settings}
        return Examined(algorithm, lambda: ReachEnv(TARGET), settings)
    return Examined(algorithm, check_maker(make_env), settings)


def check_algorithm(
    algorithm: type[BaseAlgorithm],
    make_env: Callable[[], gym.Env[Any, Any]] | None = None,
    **settings: Any,  # noqa: ANN401
) -> None:
    """Raise unless an algorithm keeps the contract of SB3 and of the benchmark.

    It learns some twenty short runs; `ALGORITHM_RULES` are what it asks.

    >>> from baselines import REPS
    >>> check_algorithm(REPS, population_size=6)

    :param algorithm: the class
    :param make_env: returns a new environment each time; by default one that costs no time, where
        a point is to end at a target, with demonstrations for a class that says
        ``needs_demonstrations``
    :param settings: constructor arguments besides policy, environment and seed: those that make
        learning quick
    :raises AlgorithmContractError: it breaks a rule: the value, the rule, and the way out
    :raises ConfigurationError: settings that the algorithm refuses, or what makes no environment
    """
    examined = examine(algorithm, make_env, **settings)
    for rule in ALGORITHM_RULES:
        apply(rule, examined)
