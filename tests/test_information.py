"""What an algorithm says it learns from is what changes its run, no more and no less."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecEnv

from baselines import BO, CMAES, CMAME, GA, REPS, LogEI, RandomSearch, TuRBO
from benchmark_envs import TrajectoryVecEnv
from results.report.own_answer import SIGNS
from sb3_nmp import (
    ACNMP,
    RCNMP,
    ACNMPAdaptation,
    ACNMPCritic,
    Demonstrations,
    TrajectoryAlgorithm,
)
from sb3_nmp.checking.environments import Telling
from sb3_nmp.common.policies import ElitePolicy
from sb3_nmp.common.rollouts import Information
from sb3_nmp.rcnmp.settings import RCNMPAchievement, RCNMPSkill
from tests.registry import ALGORITHMS, DEMONSTRATIONS, ENV_ID, POPULATION

Algorithm = type[TrajectoryAlgorithm]
BY_STEPS = {"search": "policy", "adaptation": ACNMPAdaptation("step", n_training_steps=3)}
BY_TERMS_AND_STEPS = {"adaptation": ACNMPAdaptation("to_go", n_training_steps=3)}
SUM_ALONE = {"critic": ACNMPCritic(terms=False)}
VARYING = {"random_bottles": True}
SMALL = {
    "skill": RCNMPSkill(n_members=2, prior_steps=(5, 5), reward_steps=(5, 5), ascent_steps=3),
    "achievement": RCNMPAchievement(n_members=2, steps_per_rollout=0.5, correction_steps=3),
}
CASES: dict[str, tuple[Algorithm, dict[str, Any], dict[str, Any]]] = {
    **{algorithm.__name__: (algorithm, {}, {}) for algorithm in ALGORITHMS},
    "ACNMP by steps": (ACNMP, BY_STEPS, {}),
    "ACNMP by terms and steps": (ACNMP, BY_TERMS_AND_STEPS, {}),
    "ACNMP, sum alone": (ACNMP, SUM_ALONE, {}),
    "BO, sum alone": (BO, SUM_ALONE, {}),
    "REPS, shown some": (REPS, {"demonstrations": DEMONSTRATIONS}, {}),
    "RCNMP, shown some": (RCNMP, {"demonstrations": DEMONSTRATIONS}, {}),
    "RCNMP over contexts": (RCNMP, {"policy_kwargs": SMALL}, VARYING),
    "RCNMP over contexts, no relabelling": (
        RCNMP,
        {"policy_kwargs": SMALL, "relabel": False},
        VARYING,
    ),
    "RCNMP over contexts, shown some": (
        RCNMP,
        {"policy_kwargs": SMALL, "demonstrations": DEMONSTRATIONS},
        VARYING,
    ),
    "GA over contexts": (GA, {}, VARYING),
    "GA over contexts, no relabelling": (GA, {"relabel": False}, VARYING),
}


def environment(altered: Information | None, task: dict[str, Any]) -> VecEnv:
    pinned = {} if task else {"context": DEMONSTRATIONS.contexts[0]}
    return make_vec_env(
        ENV_ID,
        vec_env_cls=TrajectoryVecEnv,
        env_kwargs={**task, **pinned},
        wrapper_class=Telling,
        wrapper_kwargs={"altered": altered},
    )


def traces(name: str, altered: Information | None) -> tuple[list[Any], frozenset[Information]]:
    """What a run executed and answers in the end, and what its algorithm says it learns from."""
    algorithm, more, task = CASES[name]
    settings = {**ALGORITHMS[algorithm], **more}
    shown = settings.get("demonstrations")
    if altered is Information.DEMONSTRATIONS and shown is not None:
        settings["demonstrations"] = Demonstrations(shown.contexts, 0.9 * shown.trajectories)
    make: Callable[..., TrajectoryAlgorithm] = algorithm
    model = make("MlpPolicy", environment(altered, task), seed=0, **settings)
    executed: list[Any] = []

    def keep(found: dict[str, Any], _: dict[str, Any]) -> bool:
        executed.append(found["actions"].copy())
        return True

    model.learn(4 * POPULATION, callback=keep)
    contexts = DEMONSTRATIONS.contexts[:1].astype(np.float32)
    own = model.policy.own_answer(contexts)
    answers = [model.predict(contexts, deterministic=True)[0], np.zeros(1) if own is None else own]
    return [*executed, *answers], model.information


def differ(one: list[Any], two: list[Any]) -> bool:
    return any(not np.array_equal(a, b) for a, b in zip(one, two, strict=True))


@pytest.mark.parametrize("name", CASES)
def test_a_run_changes_with_what_its_algorithm_learns_from_and_with_nothing_else(name: str) -> None:
    reference, information = traces(name, None)
    changing = {kind for kind in Information if differ(traces(name, kind)[0], reference)}
    assert changing == information


def test_every_kind_of_information_has_a_sign() -> None:
    assert list(SIGNS) == [str(kind) for kind in Information]
    assert len(set(SIGNS.values())) == len(SIGNS)


# -- the model's own answer --------------------------------------------------------------------


@pytest.mark.parametrize("algorithm", ALGORITHMS, ids=lambda a: a.__name__)
def test_the_own_answer_is_the_greedy_one_after_all_rollouts_are_forgotten(
    algorithm: Algorithm,
) -> None:
    model: Any = algorithm("MlpPolicy", environment(None, {}), seed=0, **ALGORITHMS[algorithm])
    model.learn(2 * POPULATION)
    context, policy = DEMONSTRATIONS.contexts[:1].astype(np.float32), model.policy
    own, remembering = policy.own_answer(context), policy.predict(context, deterministic=True)[0]
    if algorithm in (GA, RandomSearch, TuRBO, LogEI, CMAME):  # they have no model of contexts
        assert own is None
        return
    assert model.action_space.contains(own[0].astype(np.float32))
    if isinstance(policy, ElitePolicy):
        assert not np.array_equal(own.astype(np.float32), remembering)
        policy.elites.forget()
    forgetful = policy.predict(context, deterministic=True)[0]
    np.testing.assert_array_equal(own.astype(np.float32), forgetful)


def test_what_has_learned_nothing_has_no_answer_of_its_own() -> None:
    context = DEMONSTRATIONS.contexts[:1]
    for algorithm in (RCNMP, CMAES, GA):
        model = algorithm("MlpPolicy", environment(None, {}), seed=0).learn(2)
        assert model.policy.own_answer(context) is None
