"""`TuningPlan`: what is equal for all algorithms that are tuned.

What a trial costs is told by one of three measures. ``"rollouts"``: the mean logarithm of the
rollouts until the greedy policy succeeds, over the tuning runs; a run that never does counts as
twice its budget. ``"reward"``: minus the mean reward of the greedy trajectory at the end.
``"failures"``, of streams of contexts and of nothing else: the share of held-out contexts that
fail, its mean over all evaluations, which lie evenly on a logarithmic scale of rollouts.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Literal, get_args

import numpy as np

from results.exceptions import BenchmarkError
from results.harness.protocol import Protocol
from results.harness.records import Curve
from results.harness.specification import plain
from results.harness.suite import Recipe, find_label
from results.one_context.protocol import OneContext
from results.report.frames import rollouts_to_success
from results.stream.protocol import Stream
from sb3_nmp.common.tuning import Value

#: reported runs have smaller seeds
FIRST_TUNING_SEED = 1000

Measure = Literal["rollouts", "reward", "failures"]


@dataclass(frozen=True)
class Trial:
    """One setting.

    :param chosen: values by the names of the search space; empty: as in the suite
    :param cost: what it cost; None where a run failed
    """

    chosen: dict[str, Value]
    cost: float | None


@dataclass(frozen=True)
class TuningPlan:
    """What is equal for all algorithms.

    :param suite: its name
    :param task: the suite's task
    :param task_settings: its constructor arguments
    :param budget: rollouts of a run
    :param seeds: of the runs of each trial; none of them is reported
    :param n_trials: of each algorithm, its settings in the suite included
    :param protocols: each seed is run once in each
    :param measure: what a trial costs
    :param variants: further settings of the task, by name; each seed is run once in each
    :raises BenchmarkError: a seed that reported runs have, no seed, fewer than one trial or
        rollout, no such measure, or one that goes with other protocols
    """

    suite: str
    task: str
    task_settings: dict[str, Any]
    budget: int
    seeds: tuple[int, ...]
    n_trials: int
    protocols: tuple[Protocol, ...] = (OneContext(),)
    measure: Measure = "rollouts"
    variants: Mapping[str, Mapping[str, Any]] = field(default_factory=lambda: {"": {}})

    def __post_init__(self) -> None:
        """Check seeds, trials and measure."""
        reported = [seed for seed in self.seeds if seed < FIRST_TUNING_SEED]
        if reported or not self.seeds:
            some = ", ".join(map(str, self.seeds[:3])) + (", ..." if len(self.seeds) > 3 else "")
            raise BenchmarkError(
                f"the tuning seeds are [{some}]; reported runs have seeds below "
                f"{FIRST_TUNING_SEED}, so tuning needs at least one, and all from there on, such "
                f"as --seeds {FIRST_TUNING_SEED}-{FIRST_TUNING_SEED + 4}."
            )
        if self.budget < 1:
            raise BenchmarkError(f"the budget is {self.budget}; a run needs at least 1 rollout.")
        if self.n_trials < 1:
            raise BenchmarkError(f"n_trials is {self.n_trials}; at least 1 is needed.")
        if self.measure not in get_args(Measure):
            raise BenchmarkError(
                f"measure is {self.measure!r}; a trial costs {' or '.join(get_args(Measure))}."
            )
        if self.over_contexts != (self.measure == "failures"):
            goes = "'failures'" if self.over_contexts else "'rollouts' or 'reward'"
            raise BenchmarkError(
                f"measure is {self.measure!r}; on the suite '{self.suite}' a trial costs {goes}: "
                "failures are counted over streams of contexts, and there alone."
            )

    @property
    def over_contexts(self) -> bool:
        """Whether policies for all contexts are learned, from streams of them."""
        return any(isinstance(each, Stream) for each in self.protocols)

    @property
    def shows(self) -> bool:
        """Whether algorithms are shown demonstrations."""
        return any(
            each.n_demonstrations > 0 if isinstance(each, Stream) else each != OneContext()
            for each in self.protocols
        )

    @property
    def record(self) -> dict[str, Any]:
        """Its fields as JSON values."""
        where = [
            [each.name, plain(each.settings) if isinstance(each, Stream) else each.number]
            for each in self.protocols
        ]
        alone = list(self.variants) == [""]  # which studies from before variants do not tell
        others = {"protocols", "variants"} if alone else {"protocols"}
        names = [each.name for each in fields(self) if each.name not in others]
        return {name: plain(getattr(self, name)) for name in names} | {"protocols": where}

    @property
    def n_runs(self) -> int:
        """The runs of each trial."""
        return len(self.protocols) * len(self.seeds) * len(self.variants)

    def cost(self, curve: Curve) -> float:
        """Return what a run cost.

        :param curve: of its record
        """
        if self.measure == "failures":
            return float(np.mean(curve["failure_rate"]))
        if self.measure == "reward":
            return -float(curve["greedy_reward"][-1])
        first = rollouts_to_success(curve["rollouts"], curve["greedy_success"])
        return float(np.log(min(max(first, 1.0), 2.0 * self.budget)))

    def told(self, trial: Trial) -> str:
        """Return a trial's cost in words.

        :param trial: of this plan
        """
        if trial.cost is None:
            return "failed"
        if self.measure == "failures":
            return f"{trial.cost:.1%} fail"
        if self.measure == "reward":
            return f"reward {-trial.cost:.4f}"
        return f"{np.exp(trial.cost):.0f} rollouts"

    @classmethod
    def of(
        cls,
        suite: str,
        recipe: Recipe,
        seeds: Sequence[int],
        n_trials: int,
        budget: int | None = None,
        measure: Measure | None = None,
        variants: Sequence[str] | None = None,
    ) -> "TuningPlan":
        """Return the plan for a suite.

        :param suite: its name
        :param recipe: what it is made of
        :param seeds: of the runs of each trial
        :param n_trials: of each algorithm
        :param budget: rollouts of a run; the recipe's by default
        :param measure: what a trial costs; rollouts by default, over streams failures
        :param variants: these of the suite's; all by default
        :raises BenchmarkError: the suite is not of one task, has no contexts to tune in, or has
            no such variant
        """
        alone = recipe.protocols == (OneContext(),)
        protocols = recipe.tuning or (recipe.protocols if alone else ())
        if not protocols or len(recipe.tasks) != 1:
            raise BenchmarkError(
                f"the suite '{suite}' cannot be tuned: its runs must be of one task, in one "
                "context without demonstrations, as those of quick, bottles and rivals are, or it "
                "must have tuning contexts, as push, pouring, pick-and-place, aperture and "
                "random-bottles have."
            )
        ((task, settings),) = recipe.tasks.items()
        if measure is None:
            measure = "failures" if isinstance(protocols[0], Stream) else "rollouts"
        size = recipe.budget if budget is None else budget
        known = recipe.variants
        chosen = [
            find_label(v, known, f"the suite '{suite}'", "variant") for v in variants or known
        ]
        made = {name: dict(known[name]) for name in chosen}
        return cls(
            suite, task, dict(settings), size, tuple(seeds), n_trials, protocols, measure, made
        )
