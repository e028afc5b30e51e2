"""The committed rows against today's program, and against programs that were made worse.

`make leaderboard` runs these; each does runs of the leaderboard again.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from baselines import GA, REPS, ContextualREPS
from results.harness.provenance import provenance
from results.harness.records import RunRecord
from results.harness.runner import execute
from results.leaderboard.boards import BOARDS, DATA
from results.leaderboard.commands import comparisons, judgements
from results.leaderboard.files import row_path, row_paths
from results.leaderboard.rows import Claim, claim_of
from sb3_nmp import RCNMP, CNMPPretraining

pytestmark = pytest.mark.leaderboard
ROWS = row_paths(DATA)


@pytest.mark.parametrize("path", ROWS, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_todays_program_is_no_worse_than_the_row(path: Path) -> None:
    """And on a like machine the whole first seed is the same to the bit: then nothing is worse."""
    (found,) = comparisons(BOARDS, [path], 1)
    if found.unlike or found.changed:
        (judged,) = judgements(BOARDS, [path], 1, len(ROWS))
        assert not judged.worse(), judged.sentence()
        if found.unlike and not judged.n_runs:
            pytest.skip(f"its runs take too long to do many again: {found.sentence()}")
    assert not found.changed, found.sentence()


def no_mutation(patch: pytest.MonkeyPatch) -> None:
    mutate_at_first_only(patch, GA)


def no_mutation_in_rcnmp(patch: pytest.MonkeyPatch) -> None:
    mutate_at_first_only(patch, RCNMP)


def mutate_at_first_only(patch: pytest.MonkeyPatch, kind: type[GA] | type[RCNMP]) -> None:
    """The first generation keeps its noise, as there would be nothing to select."""
    mutations = kind._mutations

    def fading(self: Any, n: int, n_fresh: int, age: int) -> Any:
        return mutations(self, n, n_fresh, age) * (1.0 if self._n_updates == 0 else 0.0)

    patch.setattr(kind, "_mutations", fading)


def worst_reward_asked_for(patch: pytest.MonkeyPatch) -> None:
    reverse_rewards(patch, GA)


def worst_reward_wanted_everywhere_in_rcnmp(patch: pytest.MonkeyPatch) -> None:
    """By the network, by its judge, and by what draws parents."""
    reverse_rewards(patch, RCNMP)


def worst_reward_asked_for_in_rcnmp(patch: pytest.MonkeyPatch) -> None:
    """Of the network alone; the judge still wants the best one."""
    train = RCNMP._train

    def ask_for_the_worst(self: RCNMP) -> None:
        train(self)
        self.policy.target_reward.neg_()

    patch.setattr(RCNMP, "_train", ask_for_the_worst)


def wrong_sign_of_what_a_skill_learns(patch: pytest.MonkeyPatch) -> None:
    """Each rollout is learned as one that went round the other side."""
    import sb3_nmp.common.skill_search as module

    made = module.Experience

    def mirrored(contexts: Any, weights: Any, *told: Any) -> Any:
        return made(contexts, -weights, *told)

    patch.setattr(module, "Experience", mirrored)


def worst_reward_asked_for_in_contextual_reps(patch: pytest.MonkeyPatch) -> None:
    reverse_rewards(patch, ContextualREPS)


def wrong_sign_of_the_reward_in_reps(patch: pytest.MonkeyPatch) -> None:
    reverse_rewards(patch, REPS)


def reverse_rewards(patch: pytest.MonkeyPatch, kind: type[Any]) -> None:
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


def crossover_of_a_parent_with_itself_in_rcnmp(patch: pytest.MonkeyPatch) -> None:
    pairs = RCNMP._draw_parents

    def alone(self: RCNMP, *arguments: Any) -> Any:
        parents = pairs(self, *arguments)
        first = [0, 0]
        return replace(parents, latents=parents.latents[first], rows=parents.rows[first])

    patch.setattr(RCNMP, "_draw_parents", alone)


def wrong_sign_of_the_policy_gradient(patch: pytest.MonkeyPatch) -> None:
    import sb3_nmp.acnmp.losses as module

    loss = module.policy_gradient_loss
    patch.setattr(module, "policy_gradient_loss", lambda *args: -loss(*args))


def a_critic_that_sees_half_of_the_rollouts(patch: pytest.MonkeyPatch) -> None:
    import sb3_nmp.bayesian.search as module

    fit = module.Critic.fit

    def half(points: Any, rollouts: Any, *more: Any) -> Any:
        return fit(points[::2], rollouts[::2], *more)

    patch.setattr(module.Critic, "fit", half)


Plant = Callable[[pytest.MonkeyPatch], None]
#: Board and row that it is judged by. `a_critic_that_sees_half_of_the_rollouts` is not among them:
#: its eight runs take ten minutes, and what statistics say of it was not tried; bits show it.
PLANTED: dict[Plant, tuple[str, str]] = {
    no_mutation: ("bottles", "GA"),
    worst_reward_asked_for: ("bottles", "GA"),
    crossover_of_a_parent_with_itself: ("bottles", "GA"),
    wrong_sign_of_the_reward_in_reps: ("bottles", "REPS"),
    worst_reward_wanted_everywhere_in_rcnmp: ("bottles", "RC-NMP"),
    worst_reward_asked_for_in_rcnmp: ("bottles", "RC-NMP"),
    no_mutation_in_rcnmp: ("via-points", "RC-NMP"),
    crossover_of_a_parent_with_itself_in_rcnmp: ("bottles", "RC-NMP"),
    wrong_sign_of_the_policy_gradient: ("push-beyond", "ACNMP, network drives"),
    wrong_sign_of_what_a_skill_learns: ("random-bottles", "twin, nearest"),
    worst_reward_asked_for_in_contextual_reps: ("aperture", "contextual REPS"),
}
#: What the runs that a check does again do not show, and their least p-value, uncorrected: an alarm
#: needs one of 5e-5. `SHOWN` has the bits, which show all of them.
MISSED: dict[Plant, str] = {
    crossover_of_a_parent_with_itself: "too small for ten runs",
    crossover_of_a_parent_with_itself_in_rcnmp: "p = 0.06 in ten runs, 0.08 on via-points",
    worst_reward_asked_for_in_rcnmp: "p = 0.07 in ten runs: the judge sorts out what it gives",
}
CASES = [
    pytest.param(
        plant,
        id=plant.__name__,
        marks=[pytest.mark.xfail(reason=MISSED[plant], strict=False)] if plant in MISSED else [],
    )
    for plant in PLANTED
]


@pytest.mark.parametrize("plant", CASES)
def test_a_planted_regression_raises_the_alarm(
    plant: Plant, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant(monkeypatch)
    path = row_path(DATA, *PLANTED[plant])
    (judged,) = judgements(BOARDS, [path], 1, len(ROWS))
    assert judged.worse(), judged.sentence()


def test_what_statistics_miss_shows_in_bits() -> None:
    assert MISSED.keys() <= SHOWN.keys()


# -- to the bit ------------------------------------------------------------------------------------


def a_ridge_of_nearly_nothing(patch: pytest.MonkeyPatch) -> None:
    import sb3_nmp.common.regression as module

    patch.setattr(module, "RIDGE", 1e-12)


#: board, row and rollouts in which one seed shows it
SHOWN: dict[Plant, tuple[str, str, int]] = {
    crossover_of_a_parent_with_itself: ("bottles", "GA", 45),
    no_mutation: ("bottles", "GA", 45),
    worst_reward_asked_for: ("bottles", "GA", 45),
    wrong_sign_of_the_reward_in_reps: ("bottles", "REPS", 45),
    worst_reward_asked_for_in_rcnmp: ("bottles", "RC-NMP", 100),
    worst_reward_wanted_everywhere_in_rcnmp: ("bottles", "RC-NMP", 100),
    no_mutation_in_rcnmp: ("bottles", "RC-NMP", 100),
    crossover_of_a_parent_with_itself_in_rcnmp: ("bottles", "RC-NMP", 100),
    wrong_sign_of_the_policy_gradient: ("push-beyond", "ACNMP, network drives", 12),
    a_critic_that_sees_half_of_the_rollouts: ("push-beyond", "ACNMP", 20),
    a_ridge_of_nearly_nothing: ("push-beyond", "twin, ridge", 5),
}


def first_run(board: str, label: str, budget: int) -> Claim:
    """The first run of a row, cut short, with less training on demonstrations."""
    run = replace(BOARDS[board].runs(board, [label], 1)[0], budget=budget)
    if label.startswith("ACNMP"):
        settings = {**run.algorithm.settings, "pretraining": CNMPPretraining(30)}
        run = replace(run, algorithm=replace(run.algorithm, settings=settings))
    return claim_of(RunRecord(run.record, provenance(), "finished", execute(run)))


@pytest.mark.parametrize("plant", SHOWN, ids=lambda plant: plant.__name__)
def test_a_planted_regression_shows_in_the_bits_of_one_seed(
    plant: Plant, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The unchanged program repeats them, so that this alarm is never false."""
    before = first_run(*SHOWN[plant])
    assert first_run(*SHOWN[plant]) == before
    plant(monkeypatch)
    assert first_run(*SHOWN[plant]) != before
