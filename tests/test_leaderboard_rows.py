"""The committed rows against today's program, and against programs that were made worse.

`make leaderboard` runs these; each does runs of the leaderboard again.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from baselines import GA, REPS
from results.leaderboard.boards import BOARDS, DATA
from results.leaderboard.commands import judgements
from results.leaderboard.files import row_path, row_paths

pytestmark = pytest.mark.leaderboard
ROWS = row_paths(DATA)


@pytest.mark.parametrize("path", ROWS, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_todays_program_is_no_worse_than_the_row(path: Path) -> None:
    (judged,) = judgements(BOARDS, [path], 1, len(ROWS))
    assert not judged.worse(), judged.sentence()


def no_mutation(patch: pytest.MonkeyPatch) -> None:
    """The first generation keeps its noise, as there would be nothing to select."""
    mutations = GA._mutations

    def fading(self: GA, n: int, n_fresh: int, age: int) -> Any:
        return mutations(self, n, n_fresh, age) * (1.0 if self._n_updates == 0 else 0.0)

    patch.setattr(GA, "_mutations", fading)


def worst_reward_asked_for(patch: pytest.MonkeyPatch) -> None:
    reverse_rewards(patch, GA)


def wrong_sign_of_the_reward_in_reps(patch: pytest.MonkeyPatch) -> None:
    reverse_rewards(patch, REPS)


def reverse_rewards(patch: pytest.MonkeyPatch, kind: type[GA] | type[REPS]) -> None:
    from dataclasses import replace

    learn = kind._end_generation

    def reversed_rewards(self: Any, generation: Any) -> None:
        learn(self, replace(generation, rewards=-generation.rewards))

    patch.setattr(kind, "_end_generation", reversed_rewards)


def crossover_of_a_parent_with_itself(patch: pytest.MonkeyPatch) -> None:
    import baselines.ga.ga as module

    pairs = module.crossover_pairs

    def alone(*arguments: Any) -> Any:
        before, _, cuts = pairs(*arguments)
        return before, before, cuts

    patch.setattr(module, "crossover_pairs", alone)


PLANTED: dict[Callable[[pytest.MonkeyPatch], None], str] = {
    no_mutation: "GA",
    worst_reward_asked_for: "GA",
    crossover_of_a_parent_with_itself: "GA",
    wrong_sign_of_the_reward_in_reps: "REPS",
}


#: ten runs do not show them
MISSED = {crossover_of_a_parent_with_itself}
CASES = [
    pytest.param(
        plant,
        id=plant.__name__,
        marks=[pytest.mark.xfail(reason="too small for ten runs", strict=False)]
        if plant in MISSED
        else [],
    )
    for plant in PLANTED
]


@pytest.mark.parametrize("plant", CASES)
def test_a_planted_regression_raises_the_alarm(
    plant: Callable[[pytest.MonkeyPatch], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    plant(monkeypatch)
    path = row_path(DATA, "bottles", PLANTED[plant])
    (judged,) = judgements(BOARDS, [path], 1, len(ROWS))
    assert judged.worse(), judged.sentence()
