"""`check_algorithm`: all our algorithms keep the contract; each planted fault is told."""

from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th
from numpy.typing import NDArray

from baselines import REPS, LogEI, TuRBO
from sb3_nmp import AlgorithmContractError, TrajectoryAlgorithm, check_algorithm
from sb3_nmp.checking import ALGORITHM_RULES, ReachEnv
from sb3_nmp.common.exceptions import ConfigurationError
from sb3_nmp.common.rollouts import Generation
from tests.registry import ALGORITHMS, POPULATION

SHOWN = {"demonstrations": ReachEnv.demonstrations()}
#: each rollout of theirs costs an optimisation
ASCENT = {"n_restarts": 1, "n_ascent": 2, "n_initial": 8}
SMALLER = {TuRBO: {"population_size": 4}, LogEI: {"population_size": 4, **ASCENT}}


@pytest.mark.parametrize("algorithm", ALGORITHMS, ids=lambda each: each.__name__)
def test_every_algorithm_keeps_the_contract(algorithm: type[TrajectoryAlgorithm]) -> None:
    settings = {**ALGORITHMS[algorithm], **SMALLER.get(algorithm, {})}
    if "demonstrations" in settings:
        settings |= SHOWN
    check_algorithm(algorithm, **settings)


def test_an_environment_of_ones_own_may_be_given() -> None:
    check_algorithm(REPS, lambda: ReachEnv(), population_size=6)  # draws its contexts


class Overspending(REPS):
    def learn(self, total_timesteps: int, *args: Any, **kwargs: Any) -> Any:
        return super().learn(total_timesteps + 1, *args, **kwargs)


class Uncounted(REPS):
    def learn(self, *args: Any, **kwargs: Any) -> Any:
        super().learn(*args, **kwargs)
        self.num_timesteps -= 1
        return self


class Silent(REPS):
    def learn(self, *args: Any, **kwargs: Any) -> Any:
        super().learn(*args, **kwargs)


class Holed(REPS):
    def _propose(self, members: slice, contexts: NDArray[Any]) -> NDArray[Any]:
        proposed = super()._propose(members, contexts)
        proposed[:, 3] = np.nan
        return proposed


def proposing(change: Callable[[Any, NDArray[Any], slice], NDArray[Any]]) -> type[REPS]:
    def propose(self: Any, members: slice, contexts: NDArray[Any]) -> NDArray[Any]:
        return change(self, REPS._propose(self, members, contexts), members)

    return type("Changed", (REPS,), {"_propose": propose})


def misproposing(change: Callable[[NDArray[Any]], Any]) -> type[REPS]:
    return proposing(lambda _, proposed, members: change(proposed))


class Deaf(REPS):
    """Hears no seed."""

    def _setup_model(self) -> None:
        super()._setup_model()
        self.rng = np.random.default_rng(0)


def answering(change: Callable[[Any, NDArray[Any], bool], NDArray[Any]]) -> type[REPS]:
    def predict(
        self: Any, observation: Any, *args: Any, deterministic: bool = False, **kwargs: Any
    ) -> Any:
        answer, state = REPS.predict(self, observation, *args, deterministic=deterministic)
        return change(self, answer, deterministic), state

    return type("Changed", (REPS,), {"predict": predict})


def drawn(model: REPS, answer: NDArray[Any], greedy: bool) -> NDArray[Any]:
    model.rng.random()
    return answer


class Absentminded(REPS):
    """Begins a new generation in each call of learn."""

    def learn(self, *args: Any, **kwargs: Any) -> Any:
        self._collected, self._generation_started = [], False
        return super().learn(*args, **kwargs)


class Restless(REPS):
    def learn(self, total_timesteps: int, callback: Any = None, *args: Any, **kwargs: Any) -> Any:
        return super().learn(total_timesteps, None, *args, **kwargs)


class Shifted(REPS):
    """Its files change what it answers."""

    @classmethod
    def load(cls, *args: Any, **kwargs: Any) -> Any:
        model = super().load(*args, **kwargs)
        with th.no_grad():
            for value in model.policy.state_dict().values():
                value += 0.01
        return model


class Reset(REPS):
    @classmethod
    def load(cls, *args: Any, **kwargs: Any) -> Any:
        model = super().load(*args, **kwargs)
        model.num_timesteps = 0
        return model


class Unseeded(REPS):
    """Its files lack the state of its generator."""

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "rng"]


class Shy(REPS):
    """Does half of its work where contexts are drawn."""

    def learn(self, total_timesteps: int, *args: Any, **kwargs: Any) -> Any:
        assert self.env is not None
        if self.env.get_attr("pinned")[0] is None:
            total_timesteps //= 2
        return super().learn(total_timesteps, *args, **kwargs)


class Peeping(REPS):
    """Learns from success, and does not say so."""

    def _end_generation(self, generation: Generation) -> None:
        super()._end_generation(
            replace(generation, rewards=generation.rewards + 9.0 * generation.successes)
        )


class Boasting(REPS):
    @property
    def information(self) -> frozenset[Any]:
        return super().information | {"telepathy"}


class Needy(REPS):
    def __init__(self, policy: Any, env: Any, sigma: float, **shared: Any) -> None:
        super().__init__(policy, env, **shared)


class Breaking(REPS):
    def _end_generation(self, generation: Generation) -> None:
        raise KeyError("sigma")


class Bare(REPS):
    def predict(self, *args: Any, **kwargs: Any) -> Any:
        return super().predict(*args, **kwargs)[0]


class Nameless(REPS):
    policy_aliases = {"OwnPolicy": REPS.policy_aliases["MlpPolicy"]}  # noqa: RUF012


#: by fault: the algorithm, and parts of the sentence
FAULTS: dict[str, tuple[Any, tuple[str, ...]]] = {
    "no algorithm": (dict, ("<class 'dict'>", "BaseAlgorithm")),
    "an argument without default": (Needy, ("needs the arguments", "sigma", "SB3's load")),
    "no MlpPolicy": (Nameless, ("['OwnPolicy']", "'MlpPolicy'")),
    "learn that spends n+1": (Overspending, ("learn(3) executed 4 rollouts", "counted")),
    "rollouts that are not counted": (Uncounted, ("num_timesteps = 2 after 3",)),
    "learn returns nothing": (Silent, ("returned None", "return self")),
    "a trajectory with nan": (
        Holed, ("rollout 1 is a trajectory of shape (20, 2)", "from nan to nan"),
    ),
    "trajectories too short": (
        misproposing(lambda p: p[:, :5]),
        ("Changed._propose returned a ndarray of shape (1, 5, 2)", "(n, T, D) = (1, 20, 2)"),
    ),
    "trajectories of one dimension": (
        misproposing(lambda p: p[..., 0]), ("of shape (1, 20)", "(n, T, D) = (1, 20, 2)"),
    ),
    "a trajectory for too many members": (
        misproposing(lambda p: np.repeat(p, 2, 0)), ("shape (2, 20, 2)", "(1, 20, 2)"),
    ),
    "no trajectories": (
        misproposing(lambda p: None), ("_propose returned a NoneType;", "(1, 20, 2)"),
    ),
    "texts as trajectories": (
        misproposing(lambda p: p.astype("<U3")), ("dtype <U3", "an array of numbers"),
    ),
    "an error of Python's": (
        Breaking, ("Breaking raised KeyError ('sigma')", "executes n rollouts", "traceback above"),
    ),
    "an answer without state": (
        Bare, ("Bare.predict returned a ndarray", "the tuple (trajectories, None)"),
    ),
    "non-determinism under a seed": (
        proposing(lambda _, p, m: p + np.random.default_rng().normal(0, 1e-6, p.shape)),
        ("seed 0 gave two runs that differ: rollout 1", "generators that the seed sets"),
    ),
    "deafness to seeds": (Deaf, ("same run for the seeds 0 and 1",)),
    "a global generator": (
        proposing(lambda _, p, m: p + np.random.normal(0, 1e-3, p.shape)),
        ("global generators are seeded anew", "of the model's own"),
    ),
    "predict of a wrong shape": (
        answering(lambda _, a, d: a[..., 0]), ("array of shape (20,)", "(20, 2): (T, D)"),
    ),
    "predict in double precision": (
        answering(lambda _, a, d: a.astype(np.float64)), ("as float64", "float32 in Box"),
    ),
    "predict outside the space": (answering(lambda _, a, d: a + 9), ("answered from", "clip it")),
    "a greedy answer of chance": (
        answering(lambda m, a, d: a * (1 - 1e-3 * np.float32(np.random.default_rng().random()))),
        ("answered twice", "draws nothing"),
    ),
    "a row that depends on the batch": (
        answering(lambda m, a, d: a * np.float32(0.5) if a.ndim == 3 else a),
        ("otherwise when it is asked alone",),
    ),
    "looking changes the run": (answering(drawn), ("changes when predict(", "draw nothing")),
    "each call begins anew": (Absentminded, ("two calls of learn, 9 and 10 rollouts",)),
    "a callback that is not heard": (Restless, ("executed 19 rollouts", "after the third")),
    "save/load that changes predict": (Shifted, ("answers otherwise after save and load",)),
    "rollouts forgotten by load": (Reset, ("after 19 rollouts and loaded with num_timesteps = 0",)),
    "a generator that is not saved": (Unseeded, ("saved after", "not the uninterrupted one")),
    "the number of environments counts": (
        proposing(lambda _, p, m: p * (1 - 0.01 * (m.stop - m.start))),
        ("two environments side by side",),
    ),
    "half a run over contexts": (Shy, ("where contexts are drawn",)),
    "success that is not declared": (
        Peeping, ("learns from success, which its information", "add Information.SUCCESS"),
    ),
    "information that is none": (Boasting, ("names ['telepathy']", "achieved contexts")),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_is_told_in_its_sentence(fault: str) -> None:
    algorithm, parts = FAULTS[fault]
    with pytest.raises(AlgorithmContractError) as caught:
        check_algorithm(algorithm, population_size=POPULATION)
    message = str(caught.value)
    assert [part for part in parts if part not in message] == [], message
    assert message.endswith(".")


@pytest.mark.parametrize(
    ("make_env", "parts"),
    [
        (ReachEnv(), ("make_env is <", "a function", "lambda: gym.make")),
        ("nmp/Bottles-v0", ("make_env is 'nmp/Bottles-v0'", "a function")),
        (lambda: None, ("which returns None", "a new environment")),
    ],
)
def test_what_makes_no_environment_is_refused(make_env: Any, parts: tuple[str, ...]) -> None:
    with pytest.raises(ConfigurationError) as caught:
        check_algorithm(REPS, make_env, population_size=POPULATION)
    assert [part for part in parts if part not in str(caught.value)] == [], str(caught.value)


def test_every_rule_says_what_it_asks() -> None:
    assert len(ALGORITHM_RULES) >= 15 and all(rule.__doc__ for rule in ALGORITHM_RULES)


def test_the_page_of_checks_has_every_algorithm_and_every_rule() -> None:
    """That each passes is what `test_every_algorithm_keeps_the_contract` asks."""
    page = (Path(__file__).parents[1] / "docs/algorithms/contract.md").read_text("utf-8")
    table = [
        [cell.strip() for cell in line.strip("| ").split(" | ")]
        for line in page.splitlines()
        if line.startswith("| ")
    ]
    asked = [name for name in table[0][1:] if name != "CMAME" or find_spec("ribs")]
    assert asked == [each.__name__ for each in ALGORITHMS]
    rules = [(rule.__doc__ or "").splitlines()[0] for rule in ALGORITHM_RULES]
    assert [row[0] for row in table[1:]] == [r.replace("``", "`").rstrip(".") for r in rules]
    assert {cell for row in table[1:] for cell in row[1:]} == {"✓"}
