"""`check_task`: all our tasks keep the contract, and each planted fault is told in its sentence."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from gymnasium import spaces

from benchmark_envs import Measured, Task, TaskContractError, check_task, make_task, task_ids
from benchmark_envs.checking import TASK_RULES

FloatArray = np.ndarray[Any, Any]


class Reach(Task):
    """A point is to end at a target; a short way earns a little more."""

    context_names: Any = ("target [m]",)
    trajectory_names: Any = ("x [m]", "y [m]")
    exploration_scale: Any = (0.1, 0.1)
    reward_terms: Any = {"distance": "minus the last point's distance [m]", "way": "of it [m]"}  # noqa: RUF012
    context_space: Any = spaces.Box(0.2, 1.0, (1,), np.float32)
    trajectory_space: Any = spaces.Box(-2.0, 2.0, (10, 2), np.float32)
    dt = 0.1

    def __init__(self, tolerance: float = 0.1) -> None:
        self.tolerance = tolerance

    @property
    def reward_range(self) -> tuple[float, float]:
        return -60.0, 0.0

    def _draw_context(self, rng: np.random.Generator) -> FloatArray:
        return rng.uniform(0.2, 1.0, 1)

    def initial_trajectory(self, context: Any) -> FloatArray:
        return np.zeros((10, 2))

    def demonstrate(self, context: Any, mode: str | None = None) -> FloatArray:
        self.check_mode(mode)
        return np.linspace(0.1, 1.0, 10)[:, None] * np.array([1.0, 0.0]) * context[0]

    def _execute(self, contexts: FloatArray, trajectories: FloatArray) -> Measured:
        targets = np.column_stack([contexts[:, 0], np.zeros(len(contexts))])
        distance = np.linalg.norm(trajectories[:, -1] - targets, axis=1)
        way = 0.01 * np.abs(np.diff(trajectories, axis=1)).sum(axis=(1, 2))
        terms = {"distance": -distance, "way": -way}
        return Measured(trajectories, terms, distance < self.tolerance)


def changed(**entries: Any) -> type[Reach]:
    return type("Faulty", (Reach,), entries)


def measuring(change: Callable[[Measured], Measured], **entries: Any) -> type[Reach]:
    """A task whose measurements are changed."""
    return changed(_execute=lambda self, c, t: change(Reach._execute(self, c, t)), **entries)


def terms(change: Callable[[FloatArray], FloatArray]) -> type[Reach]:
    def distorted(measured: Measured) -> Measured:
        named = {**measured.terms, "distance": change(np.array(measured.terms["distance"]))}
        return replace(measured, terms=named)

    return measuring(distorted)


class Drifting(Reach):
    """Its robot wears out."""

    n_rollouts = 0

    def _execute(self, contexts: FloatArray, trajectories: FloatArray) -> Measured:
        self.n_rollouts += len(contexts)
        return super()._execute(contexts, trajectories * (1 - 1e-9 * self.n_rollouts))


class Noisy(Reach):
    """Built anew, it repeats itself, as its generator is seeded; asked again, it does not."""

    def __init__(self) -> None:
        self.tolerance = 0.1
        self.rng = np.random.default_rng(0)

    def _execute(self, contexts: FloatArray, trajectories: FloatArray) -> Measured:
        noise = self.rng.normal(0, 1e-6, trajectories.shape)
        return super()._execute(contexts, trajectories + noise)


class Cached(Reach):
    """All callers share one array."""

    naive = np.zeros((10, 2))

    def initial_trajectory(self, context: Any) -> FloatArray:
        return self.naive


class Consuming(Reach):
    def demonstrate(self, context: Any, mode: str | None = None) -> FloatArray:
        shown = super().demonstrate(context, mode)
        context -= 0.1
        return shown


class Forgetful(Reach):
    def __init__(self, radius: float = 0.1) -> None:
        self.tolerance = radius


class Doubling(Reach):
    def __init__(self, tolerance: float = 0.1) -> None:
        self.tolerance = 2 * tolerance


class Lenient(Reach):
    """Simulates whatever comes."""

    def check_context(self, context: Any) -> FloatArray:
        return np.asarray(context, np.float64)


class Cheating(Reach):
    """Executes set-points beyond its space, silently."""

    def simulate(self, contexts: Any, trajectories: Any) -> Any:
        rollouts = super().simulate(contexts, trajectories)
        return replace(rollouts, clipped=np.zeros(len(rollouts), bool))


def by_place(distance: FloatArray) -> FloatArray:
    return distance - 1e-9 * np.arange(len(distance))


def a_hole(distance: FloatArray) -> FloatArray:
    distance[1:] = np.nan
    return distance


def raising(error: Exception) -> Any:
    def raise_it(*_: Any) -> Any:
        raise error

    return raise_it


#: by fault: the task, and parts of the sentence
FAULTS: dict[str, tuple[Any, tuple[str, ...]]] = {
    "no task": ("Reach", ("'Reach' is a str", "a subclass of benchmark_envs.Task")),
    "no names": (
        type("Nameless", (Reach,), {"context_names": property(lambda _: _.no_such)}),
        ("does not say its context_names",),
    ),
    "unbounded contexts": (
        changed(context_space=spaces.Box(0.2, np.inf, (1,), np.float32)),
        ("context_space is Box(", "inf", "finite bounds"),
    ),
    "a trajectory of one axis": (
        changed(trajectory_space=spaces.Box(-1, 1, (20,), np.float32)), ("(T, D)", "(20,)"),
    ),
    "a name too many": (
        changed(context_names=("x [m]", "y [m]")), ("holds 2 names", "for 1 entries"),
    ),
    "a name without unit": (changed(trajectory_names=("x [m]", "y")), ("holds 'y'", "brackets")),
    "a scale of one": (changed(exploration_scale=(0.1,)), ("is (0.1,)", "2 finite numbers > 0")),
    "time stands still": (changed(dt=0.0), ("dt is 0.0", "> 0")),
    "a range reversed": (
        changed(reward_range=(0.0, -9.0)), ("reward_range is (0.0, -9.0)", "before the best"),
    ),
    "a setting forgotten": (Forgetful, ("argument 'radius'", "keeps no attribute")),
    "a setting changed": (Doubling, ("{'tolerance': 0.2}", "{'tolerance': 0.4}")),
    "names that are numbers": (
        changed(context_names=(3,)), ("context_names is (3,)", "a tuple of texts"),
    ),
    "no names of the trajectory": (changed(trajectory_names=None), ("is None", "tuple of texts")),
    "a scale of mixed lengths": (
        changed(exploration_scale=((1,), (1, 2))), ("is ((1,), (1, 2))", "2 finite numbers > 0"),
    ),
    "a text for the time step": (changed(dt="0.1"), ("dt is '0.1'", "seconds > 0")),
    "two time steps": (changed(dt=np.full(2, 0.1)), ("dt is array(", "seconds > 0")),
    "a range of one": (changed(reward_range=0.0), ("reward_range is 0.0", "two finite numbers")),
    "a range of texts": (changed(reward_range=("a", "b")), ("('a', 'b')", "two finite numbers")),
    "terms in a list": (
        changed(reward_terms=["distance", "way"]), ("is ['distance', 'way']", "a dictionary"),
    ),
    "a mode that is a text": (changed(modes="default"), ("modes is 'default'", "tuple of texts")),
    "no modes": (changed(modes=()), ("modes is ()", "at least one: ('default',)")),
    "no text for a summand": (changed(step_reward=None), ("step_reward is None", "a text, ''")),
    "an optimum without name": (changed(optimum=3), ("optimum is 3", "a name and a reward")),
    "a scene in a list": (
        changed(scene=lambda self, context: [1]), ("scene(context) is [1]", "a dictionary"),
    ),
    "a context of the wrong shape": (
        changed(_draw_context=lambda self, rng: np.zeros(3)),
        ("_draw_context left the context space", "shape (1,) (target [m]), not (3,)"),
    ),
    "drawing that raises": (
        changed(_draw_context=raising(ZeroDivisionError("division by zero"))),
        ("raised ZeroDivisionError (division by zero)", "`_draw_context` returns", "traceback"),
    ),
    "a text for a naive trajectory": (
        changed(initial_trajectory=lambda self, context: "a"),
        ("initial_trajectory returned no trajectory but a str", "(T, D) = (10, 2)"),
    ),
    "an expert of one axis": (
        changed(demonstrate=lambda self, context, mode=None: np.zeros(10)),
        ("demonstrate returned no trajectory but a ndarray of shape (10,)", "(10, 2) (x [m]"),
    ),
    "an expert that returns nothing": (
        changed(demonstrate=lambda self, context, mode=None: None),
        ("demonstrate returned no trajectory but a NoneType",),
    ),
    "an expert that is not written": (
        changed(demonstrate=raising(NotImplementedError("later"))),
        ("raised NotImplementedError (later)", "without one raises a TaskError"),
    ),
    "an expert without modes": (
        changed(demonstrate=lambda self, context: np.zeros((10, 2))),
        ("raised TypeError", "positional arguments", "Each mode of the expert"),
    ),
    "no success": (
        measuring(lambda m: replace(m, successes=cast(Any, None))),
        ("successes = None", "an array of shape (2,)"),
    ),
    "no terms": (
        measuring(lambda m: replace(m, terms=cast(Any, None))), ("terms = None", "a dictionary"),
    ),
    "a term of texts": (
        terms(lambda d: np.full(d.shape, "a")), ("terms['distance'] of dtype <U1", "numbers"),
    ),
    "paths in no dictionary": (
        measuring(lambda m: replace(m, paths=cast(Any, None))), ("paths = None", "a dictionary"),
    ),
    "summands in a list": (
        measuring(lambda m: replace(m, step_rewards=cast(Any, [[0.0] * 10] * 2))),
        ("step_rewards = [[", "an array of shape (2, 10)"),
    ),
    "an outcome of nan": (
        measuring(lambda m: replace(m, outcomes={"drop": np.full(len(m.executed), np.nan)})),
        ("outcomes['drop'] with a value that is not finite", "0.0"),
    ),
    "rollouts of another kind": (
        changed(simulate=lambda self, contexts, trajectories: None),
        ("simulate returned a NoneType", "override _execute"),
    ),
    "a mode as an array": (
        changed(mode_of=lambda self, context, executed: np.zeros(3)),
        ("returned array([0., 0., 0.])", "('default',)"),
    ),
    "an array among the metadata": (
        changed(scene=lambda self, context: {"limits": np.zeros((2, 2))}),
        ("scene(context) is", "plain JSON", ".tolist()"),
    ),
    "a context outside its space": (
        changed(_draw_context=lambda self, rng: rng.uniform(0.2, 3.0, 1)),
        ("_draw_context left the context space", "must lie in [0.2, 1]", "widen"),
    ),
    "contexts of global chance": (
        changed(_draw_context=lambda self, rng: np.random.uniform(0.2, 1.0, 1)),
        ("from a generator of the same seed", "draw from the given rng alone"),
    ),
    "a naive trajectory outside": (
        changed(initial_trajectory=lambda self, context: np.full((10, 2), 2.5)),
        ("initial_trajectory lies 0.5 outside",),
    ),
    "a naive trajectory too short": (
        changed(initial_trajectory=lambda self, context: np.zeros((9, 2))),
        ("initial_trajectory returned no trajectory", "(T, D) = (10, 2)"),
    ),
    "an array that is shared": (Cached, ("another trajectory when it is asked again", "its own")),
    "success of the wrong shape": (
        measuring(lambda m: replace(m, successes=m.successes[:, None])),
        ("successes of shape (2, 1)", "(2,)"),
    ),
    "success as a number": (
        measuring(lambda m: replace(m, successes=m.successes.astype(float))),
        ("successes = [", "must be booleans"),
    ),
    "an executed trajectory too short": (
        measuring(lambda m: replace(m, executed=m.executed[:, :-1])),
        ("executed of shape (2, 9, 2)", "(2, 10, 2)"),
    ),
    "a term without description": (
        changed(reward_terms={"distance": "minus the distance [m]"}),
        ("['distance', 'way']", "describes ['distance']"),
    ),
    "NaN reward": (terms(a_hole), ("gave the reward nan in the context [", "finite number")),
    "a reward out of range": (terms(lambda d: d - 100), ("gave the reward -1", "reward_range")),
    "summands that do not add up": (
        measuring(
            lambda m: replace(m, step_rewards=np.ones((len(m.executed), 10))),
            step_reward="the distance [m]",
        ),
        ("step_rewards add up to 10.0", "summands over time"),
    ),
    "achievements outside": (
        measuring(
            lambda m: replace(m, achieved_contexts=m.executed[:, -1, :1] + 5),
            tells_achievement=True,
        ),
        ("outside the context space", "within_contexts"),
    ),
    "a robot that wears out": (Drifting, ("the same rollouts again", "keep no state")),
    "a generator of its own": (Noisy, ("the same rollouts again", "draw nothing at random")),
    "simulate that depends on batch order": (
        terms(by_place), ("rewards[0]", "in the reverse order", "row by row"),
    ),
    "an expert that fails": (
        changed(demonstrate=lambda self, context, mode=None: np.zeros((10, 2))),
        ("expert ('default') solves 0 of 5", "80%"),
    ),
    "an expert that eats its context": (Consuming, ("changed the context", "work on a copy")),
    "nothing to learn": (
        measuring(lambda m: replace(m, successes=np.ones(len(m.executed), bool))),
        ("solves all of 5 contexts", "nothing is left to learn"),
    ),
    "contexts outside are taken": (
        Lenient, ("took a context outside its space", "InvalidContextError"),
    ),
    "clipping in silence": (Cheating, ("reports clipped = False",)),
    "a mode that is none": (
        changed(mode_of=lambda self, context, executed: "left"),
        ("returned 'left'", "('default',)"),
    ),
}  # fmt: skip


def test_a_healthy_task_passes() -> None:
    check_task(Reach())


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_is_told_in_its_sentence(fault: str) -> None:
    made, parts = FAULTS[fault]
    with pytest.raises(TaskContractError) as caught:
        check_task(made() if isinstance(made, type) else made)
    message = str(caught.value)
    assert [part for part in parts if part not in message] == [], message
    assert message.endswith(".")


@pytest.mark.parametrize(
    ("asked", "part"),
    [
        ({"n_contexts": 1}, "n_contexts is 1"),
        ({"n_contexts": "5"}, "n_contexts is '5'"),
        ({"n_contexts": 2.5}, "n_contexts is 2.5"),
        ({"seed": -1}, "seed is -1"),
        ({"seed": "a"}, "seed is 'a'"),
    ],
)
def test_what_is_no_number_is_refused(asked: dict[str, Any], part: str) -> None:
    with pytest.raises(TaskContractError, match=f"{part}; it must be a whole number >= "):
        check_task(Reach(), **asked)


@pytest.mark.parametrize("task_id", task_ids())
def test_every_task_keeps_the_contract(task_id: str) -> None:
    check_task(make_task(task_id), n_contexts=2 if task_id.startswith("nmp/Pouring") else 5)


def test_every_rule_says_what_it_asks() -> None:
    assert len(TASK_RULES) > 20 and all(rule.__doc__ for rule in TASK_RULES)
