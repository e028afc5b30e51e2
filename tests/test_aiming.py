"""Searches that aim: where rollouts tell what they achieved, the critic predicts that."""

from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from baselines import BO
from benchmark_envs import make_task
from benchmark_envs.tasks.push import TARGETS
from sb3_nmp import ACNMP, ACNMPCritic, CNMPArchitecture, CNMPPretraining, Demonstrations
from sb3_nmp.bayesian.critic import N_AIMED, Critic, may_aim, nearest_misses, tells_misses
from sb3_nmp.bayesian.gaussian_process import Hypotheses
from sb3_nmp.bayesian.search import CriticSearch, Subspace
from sb3_nmp.common.exceptions import InvalidDataError
from sb3_nmp.common.rollouts import Generation, Information

T = 12
TIMES = np.linspace(0.0, 1.0, T)
WANTED = np.array([-2.5, 1.5])


def rollouts(
    achieved: np.ndarray | None,
    rewards: np.ndarray,
    terms: dict[str, np.ndarray] | None = None,
) -> Generation:
    n = len(rewards)
    return Generation(
        np.tile(WANTED, (n, 1)).astype(np.float32),
        np.zeros((n, T, 1), np.float32),
        rewards,
        np.zeros(n, bool),
        terms or {},
        None,
        achieved,
    )


def chosen(critic: Critic) -> np.ndarray:
    """The point of a grid that the critic likes best, without luck."""
    values = np.linspace(-3.0, 3.0, 61)
    grid = np.stack([each.ravel() for each in np.meshgrid(values, values)], axis=-1)
    bound = -sum(np.abs(process.predict(grid)[0]) for process in critic.signed)
    return grid[np.argmax(bound)]


def test_misses_are_those_of_the_rollouts_that_achieved_the_nearest() -> None:
    far = np.linspace(0.1, 3.0, 20)[::-1]
    achieved = WANTED + far[:, None] * [1.0, -2.0]
    achieved[3] = np.nan
    rows, misses = nearest_misses(rollouts(achieved, -far), unit=np.array([0.5, 2.0]))
    assert rows.tolist() == list(range(20 - N_AIMED, 20))
    np.testing.assert_allclose(misses, far[rows][:, None] * [2.0, -1.0], atol=1e-6)
    few = rollouts(achieved[:5], -far[:5])
    assert nearest_misses(few)[0].tolist() == [0, 1, 2, 4]  # one tells nothing


def test_a_dozen_that_miss_alike_leave_the_reward_to_go_by() -> None:
    """An object that nothing touched misses the same way each time."""
    n = N_AIMED + 2
    achieved = np.tile(WANTED + 0.1, (n, 1))
    achieved[:2] += [[1.0, 0.0], [0.0, 2.0]]  # those farther off would tell something
    tried = rollouts(achieved, -np.arange(n, dtype=float))
    points = np.random.default_rng(0).standard_normal((n, 2))
    assert not tells_misses(tried)
    critic = Critic.fit(points, tried, Hypotheses((np.eye(2),), (2.0,), (1e-4,)))
    assert critic.whole is not None


def test_a_rollout_that_tells_nothing_does_not_end_the_aiming() -> None:
    rng = np.random.default_rng(0)
    search = CriticSearch(Subspace(np.zeros((T, 1)), rng.standard_normal((3, T, 1))), 0.7)
    for k, told in enumerate((True, True, False, True, False)):
        tried = search.ask(1, rng).astype(np.float32)
        achieved = WANTED + rng.random((1, 2)) if told else None
        known = rollouts(achieved, np.array([-1.0 - k]))
        search.tell(replace(known, trajectories=tried))
        assert search.aims == (k >= 2)
    assert search.has_aimed


def test_push_aims_from_its_answer_and_divergence_is_no_cost_of_the_task() -> None:
    task = make_task("nmp/Push-v0", n_threads=1)
    shown = Demonstrations.from_task(task, TARGETS[[0, 1, 3]])
    env = gym.make("nmp/Push-v0", context=TARGETS[9])  # far from those
    model = BO("MlpPolicy", env, demonstrations=shown, seed=0).learn(4)
    (search,) = (each.search for each in model.searches)
    assert isinstance(search, CriticSearch)
    assert search.has_aimed
    told = search.rollouts[0]
    assert {"path", "diverged"} == set(told.terms) and told.achieved is not None
    assert may_aim(told)
    worse = replace(told, terms={**told.terms, "other": np.zeros(1)})
    assert not may_aim(worse)  # two costs of the task: their sum is told


def test_units_weigh_which_rollout_is_near() -> None:
    n = N_AIMED + 1
    achieved = np.tile(WANTED, (n, 1))
    achieved[0, 0] += 1.0
    achieved[1:, 1] += 2.0 + 0.01 * np.arange(n - 1)
    for unit, left_out in ((np.array([1.0, 1.0]), n - 1), (np.array([0.1, 1.0]), 0)):
        rows = nearest_misses(rollouts(achieved, np.zeros(n)), unit)[0]
        assert set(range(n)) - set(rows.tolist()) == {left_out}


@pytest.mark.parametrize(
    ("achieved", "told"),
    [
        (None, False),
        (np.full((3, 2), np.nan), False),
        (np.array([[0.0, 0.0], [np.nan, np.nan], [np.nan, np.nan]]), False),
        (np.tile(WANTED, (3, 1)), False),  # circumstances: as they were given
        (np.array([[0.0, 1.5], [1.0, 1.5], [np.nan, np.nan]]), True),
    ],
)
def test_a_critic_aims_where_two_rollouts_tell_different_misses(
    achieved: np.ndarray | None, told: bool
) -> None:
    tried = rollouts(achieved, np.array([-1.0, -2.0, -3.0]))
    assert tells_misses(tried) == told
    points = np.random.default_rng(0).standard_normal((3, 2))
    critic = Critic.fit(points, tried, Hypotheses((np.eye(2),), (2.0,), (1e-4,)))
    assert (critic.whole is None) == told
    assert len(critic.signed) == int(told)  # the other entry is a circumstance


def test_a_critic_that_aims_looks_where_every_entry_is_met_whatever_the_reward_says() -> None:
    rng = np.random.default_rng(1)
    points = rng.standard_normal((10, 2))
    mixing = np.array([[1.0, 0.4], [-0.3, 0.8]])
    goal = np.array([1.0, -1.5])
    achieved = WANTED + (points - goal) @ mixing
    tried = rollouts(achieved, rng.random(10))
    critic = Critic.fit(points, tried, Hypotheses((np.eye(2),), (5.0, 8.0), (1e-4,)))
    assert np.abs(chosen(critic) - goal).max() <= 0.1
    assert critic.to_gain == pytest.approx(np.abs(achieved - WANTED).sum(axis=1).min(), rel=1e-5)


def test_terms_that_add_up_come_first_and_either_can_be_hidden() -> None:
    rng = np.random.default_rng(2)
    space = Subspace(np.zeros((T, 1)), rng.standard_normal((3, T, 1)))
    costs, achieved = rng.random((2, 6)), rng.random((2, 6, 2))

    def asked(settings: ACNMPCritic, share: np.ndarray, told: np.ndarray) -> tuple[Any, bool]:
        search = CriticSearch(space, 0.7, settings)
        terms = {"a": -share, "b": -(1.0 - share)}
        search.tell(rollouts(told, -np.ones(6), terms=terms))
        return search.ask(1, np.random.default_rng(0)).tolist(), search.aims

    for settings, sees_terms, aims in (
        (ACNMPCritic(), True, False),
        (ACNMPCritic(terms=False), False, True),
        (ACNMPCritic(achieved=False), True, False),
        (ACNMPCritic(terms=False, achieved=False), False, False),
    ):
        known = asked(settings, costs[0], achieved[0])
        assert known[1] == aims
        assert (asked(settings, costs[1], achieved[0]) != known) == sees_terms
        assert (asked(settings, costs[0], achieved[1]) != known) == aims


def test_a_search_aims_until_it_succeeds_and_not_in_every_region_where_it_never_does() -> None:
    rng = np.random.default_rng(3)
    space = Subspace(np.zeros((T, 1)), rng.standard_normal((3, T, 1)))

    def aiming(succeeds_at: int) -> list[tuple[int, bool, int]]:
        search, found = CriticSearch(space, 0.7), []
        for k in range(40):
            tried = search.ask(1, np.random.default_rng(k))
            told = rollouts(WANTED + 0.1 + rng.random((1, 2)), np.array([-float(k)]))
            done = np.array([k == succeeds_at])
            search.tell(replace(told, trajectories=tried.astype(np.float32), successes=done))
            critic = search._fit_critic() if k else None
            assert critic is None or (critic.whole is None) == search.aims
            found.append((search.n_restarts, search.aims, k))
        return found

    failing = aiming(succeeds_at=99)
    assert {restarts for restarts, *_ in failing} >= {0, 1, 2, 3, 4}
    for restarts, aims, k in failing[1:]:
        assert aims == (restarts not in (2, 4, 6)), (restarts, k)
    assert [k for _, aims, k in aiming(succeeds_at=5) if aims] == [1, 2, 3, 4]


@pytest.mark.parametrize("restart_radius", [0.0, 0.1])
def test_a_search_that_never_begins_anew_leaves_its_aim_where_it_can_shrink_no_more(
    restart_radius: float,
) -> None:
    rng = np.random.default_rng(3)
    space = Subspace(np.zeros((T, 1)), rng.standard_normal((3, T, 1)))
    settings = ACNMPCritic(restart_radius=restart_radius, radius_limits=(0.1, 1.5))
    search, found = CriticSearch(space, 0.7, settings), []
    for k in range(12):
        at_its_smallest = search.region.radius == 0.1
        tried = search.ask(1, np.random.default_rng(k))
        if k >= 2:
            found.append((search.aims, at_its_smallest))
        reward = 1.0 if k == 10 else -float(k)  # a new best one: the region grows
        told = rollouts(WANTED + 0.1 + rng.random((1, 2)), np.array([reward]))
        search.tell(replace(told, trajectories=tried.astype(np.float32)))
    assert search.n_restarts == 0 and not search.has_succeeded
    assert all(aims != smallest for aims, smallest in found)
    assert [aims for aims, _ in found] == 7 * [True] + 2 * [False] + [True]


class Throw(gym.Env[Any, Any]):
    """Lands where weighted means of the trajectory say; the reward tells the distance.

    An instant toy: two weighted means over time, bent a little, are where it lands.
    """

    tells_achievement = True

    def __init__(self, context: np.ndarray, telling: bool = True) -> None:
        self.observation_space = gym.spaces.Box(-4, 4, (2,), np.float32)
        self.action_space = gym.spaces.Box(-9, 9, (T, 2), np.float32)
        self.exploration_scale = np.array([0.3, 0.3])
        self.context, self.telling = np.array(context, np.float32), telling

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        return self.context, {}

    def step(self, action: Any) -> Any:
        landed = np.clip(landing(np.asarray(action, np.float64)), -4, 4)
        error = float(np.linalg.norm(landed - self.context))
        info: dict[str, Any] = {"is_success": error < 0.05}
        if self.telling:
            info["achieved_context"] = landed
        return self.context, -(error**0.2), True, False, info


def landing(trajectory: np.ndarray) -> np.ndarray:
    ends = trajectory[-1] + 0.5 * trajectory[T // 2, ::-1]
    return ends + 0.2 * np.sin(2 * ends[::-1])


def thrown(contexts: np.ndarray) -> np.ndarray:
    """Demonstrations that land near their contexts."""
    ends = np.linalg.solve(np.array([[1.0, 0.25], [0.25, 1.0]]), contexts.T).T
    return TIMES[:, None] * ends[:, None]


CONTEXTS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.5], [0.5, -1.0]])


def n_until_success(algorithm: Any, telling: bool, seed: int, **more: Any) -> tuple[int, Any]:
    shown = Demonstrations(CONTEXTS.astype(np.float32), thrown(CONTEXTS).astype(np.float32))
    model = algorithm("MlpPolicy", Throw(WANTED, telling), demonstrations=shown, seed=seed, **more)
    found: list[bool] = []

    def watch(known: dict[str, Any], _: dict[str, Any]) -> bool:
        found.append(bool(known["infos"][0]["is_success"]))
        return not found[-1]

    model.learn(60, callback=watch)
    return (len(found) if found[-1] else 61), model


SMALL = {
    "pretraining": CNMPPretraining(n_steps=100),
    "policy_kwargs": {"cnmp": CNMPArchitecture(encoder_arch=(16,), decoder_arch=(32,))},
}


@pytest.mark.parametrize(("algorithm", "more"), [(BO, {}), (ACNMP, SMALL)])
def test_what_was_achieved_saves_rollouts_and_is_told_of(
    algorithm: Any, more: dict[str, Any]
) -> None:
    aimed = [n_until_success(algorithm, True, seed, **more) for seed in range(4)]
    blind = [n_until_success(algorithm, False, seed, **more) for seed in range(4)]
    hidden, _ = n_until_success(algorithm, True, 0, critic=ACNMPCritic(achieved=False), **more)
    assert hidden == blind[0][0]
    assert sum(n for n, _ in aimed) < 0.75 * sum(n for n, _ in blind)
    assert all(Information.ACHIEVED_CONTEXTS in model.information for _, model in aimed)
    assert all(Information.ACHIEVED_CONTEXTS not in model.information for _, model in blind)


@pytest.mark.parametrize(("algorithm", "more"), [(BO, {}), (ACNMP, SMALL)])
def test_entries_of_a_context_count_in_standard_deviations_of_the_demonstrated_ones(
    algorithm: Any, more: dict[str, Any]
) -> None:
    contexts = CONTEXTS * [3.0, 0.0] + [0.0, 1.5]  # the second entry is the same in all
    shown = Demonstrations(contexts.astype(np.float32), thrown(contexts).astype(np.float32))
    model = algorithm("MlpPolicy", Throw(WANTED), demonstrations=shown, seed=0, **more)
    search = model.learn(1)._new_search(WANTED.astype(np.float32))
    np.testing.assert_allclose(search.unit, [contexts[:, 0].std(), 1.0], rtol=1e-6)


class Beyond(Throw):
    """Tells that it achieved what is no context."""

    def step(self, action: Any) -> Any:
        observation, reward, *rest, info = super().step(action)
        return observation, reward, *rest, info | {"achieved_context": np.array([9.0, 0.0])}


@pytest.mark.parametrize(("algorithm", "more"), [(BO, {}), (ACNMP, SMALL)])
def test_an_achieved_context_outside_the_space_is_told(
    algorithm: Any, more: dict[str, Any]
) -> None:
    shown = Demonstrations(CONTEXTS.astype(np.float32), thrown(CONTEXTS).astype(np.float32))
    model = algorithm("MlpPolicy", Beyond(WANTED), demonstrations=shown, seed=0, **more)
    with pytest.raises(InvalidDataError, match=r"achieved_context'\] is \[9.0, 0.0\]; it must lie"):
        model.learn(3)
