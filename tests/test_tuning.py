"""Equal tuning: search spaces that constructors take, equal trials, seeds apart, what is kept."""

import json
import signal
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baselines import GA
from benchmark_envs import make_task
from results.adaptation.protocol import Adaptation
from results.algorithms import RANDOM_SEARCH
from results.cli import main
from results.exceptions import BenchmarkError
from results.harness.protocol import Protocol
from results.harness.runner import execute
from results.stream.protocol import Stream
from results.suites import find_recipe
from results.tuning import rows, study, trials
from results.tuning.contexts import TuningContext, tuning_contexts
from results.tuning.plan import Trial, TuningPlan
from results.tuning.streams import TuningStream
from results.tuning.study import StudySummary, tune, with_settings
from sb3_nmp import RCNMP, ConfigurationError, Demonstrations
from sb3_nmp.common.tuning import Choice, Range, arguments_of, default_of

RECIPE = find_recipe("rivals")
PLAN = TuningPlan.of("rivals", RECIPE, [1000], n_trials=4, budget=60)


def values(what: Range | Choice) -> list[Any]:
    return list(what.values) if isinstance(what, Choice) else [what.low, what.high]


@pytest.mark.parametrize("label", RECIPE.algorithms)
def test_every_rival_declares_a_space_that_its_constructor_takes(label: str) -> None:
    algorithm = RECIPE.algorithms[label]
    space = algorithm.load().tunable
    assert 1 <= len(space) <= 4
    for name, what in space.items():
        default_of(algorithm.load(), name.partition(".")[0])
        for value in values(what):
            made = with_settings(algorithm, {name: value}).settings
            assert {*made} >= {*algorithm.settings, name.partition(".")[0]}


@pytest.mark.parametrize("label", ["RC-NMP", "GA", "REPS", "DREPS", "CMA-ES", "TuRBO", "LogEI"])
def test_the_ends_of_each_space_are_accepted(label: str) -> None:
    pytest.importorskip("botorch")
    algorithm = RECIPE.algorithms[label]
    for end in (0, -1):
        chosen = {name: values(what)[end] for name, what in algorithm.load().tunable.items()}
        settings = with_settings(algorithm, chosen).settings
        algorithm.load()("MlpPolicy", "nmp/Bottles-v0", **settings)


def test_fields_of_settings_and_of_dictionaries_are_set() -> None:
    made = arguments_of(RCNMP, {"mutation.n_bases": 7, "mutation.width": 2.0, "temperature": 2})
    assert (made["mutation"].n_bases, made["mutation"].width, made["temperature"]) == (7, 2.0, 2)
    agent = RECIPE.algorithms["PPO"].load()
    made = arguments_of(agent, {"agent.n_epochs": 7, "agent.clip_range": 0.3})
    assert made == {"agent": {"n_epochs": 7, "clip_range": 0.3}}
    with pytest.raises(ConfigurationError, match="has no argument 'wings'"):
        arguments_of(RCNMP, {"wings.n": 2})
    with pytest.raises(ConfigurationError, match="has no field 'wings'"):
        arguments_of(RCNMP, {"mutation.wings": 2})


def test_tuning_draws_other_contexts_than_reported_runs() -> None:
    """By the distance of the nearest pair; on bottles that stand still there is but one context."""
    task = make_task("nmp/Bottles-v0", random_bottles=True)

    def contexts(seeds: range) -> np.ndarray:
        return np.stack([task.sample_context(np.random.default_rng(seed)) for seed in seeds])

    reported, tuning = contexts(range(50)), contexts(range(1000, 1020))
    apart = np.linalg.norm(reported[:, None] - tuning, axis=2).min()
    assert apart > 0.005  # m; of 1000 pairs of layouts
    with pytest.raises(BenchmarkError, match=r"seeds are \[7, 1000\]; reported runs have seeds"):
        TuningPlan.of("rivals", RECIPE, [7, 1000], 3)


#: how far contexts must be apart for a solution of one to tell little of the other; by task
APART = {"nmp/Push-v0": 0.03, "nmp/Pouring-v1": 5.0, "nmp/PickAndPlace-v1": 0.005}


@pytest.mark.parametrize("suite", ["push", "pouring", "pick-and-place"])
def test_tuning_contexts_and_demonstrations_are_apart_from_all_that_is_reported(
    suite: str,
) -> None:
    recipe = find_recipe(suite)
    (task_id,) = recipe.tasks

    def contexts(protocols: Iterable[Protocol]) -> np.ndarray:
        splits = [each.split(task_id) for each in protocols if isinstance(each, Adaptation)]
        return np.concatenate([np.vstack(split) for split in splits])

    tuning, reported = contexts(recipe.tuning), contexts(recipe.protocols)
    distances = np.linalg.norm(tuning[:, None] - reported, axis=2)
    assert distances.min() >= APART[task_id]
    space = make_task(task_id).context_space
    assert all(space.contains(each.astype(np.float32)) for each in tuning)
    assert len(recipe.tuning) >= 2


@pytest.mark.parametrize("suite", ["push", "pouring", "pick-and-place"])
def test_what_a_suite_tunes_with_demonstrations_is_accepted(suite: str) -> None:
    recipe = find_recipe(suite)
    plan = TuningPlan.of(suite, recipe, [1000], 2)
    (task_id,) = recipe.tasks
    shown = Demonstrations.from_task(task_id, TuningContext(0).split(task_id)[0][:3])
    tuned = {"ACNMP", "twin, nearest", "CMA-ES context", "ProMP+RL (Stark)", "ProMP+RL (Ewerton)"}
    for label in {*tuned, "REPS", "RC-NMP", "GA"}:
        algorithm = recipe.algorithms[label]
        space = study.space_of(algorithm, plan)
        assert 1 <= len(space) <= 4
        for end in (0, -1):
            chosen = {name: values(what)[end] for name, what in space.items()}
            settings = with_settings(algorithm, chosen).settings
            algorithm.load()("MlpPolicy", task_id, demonstrations=shown, **settings)


STREAMED = find_recipe("random-bottles")


@pytest.mark.parametrize("suite", ["random-bottles", "aperture"])
def test_a_stream_is_tuned_on_contexts_that_no_table_reports(suite: str) -> None:
    recipe = find_recipe(suite)
    ((task_id, made),) = recipe.tasks.items()
    settings: dict[str, Any] = dict(made)
    task = make_task(task_id, **settings)
    (tuning,), (reported,) = recipe.tuning, recipe.protocols
    assert isinstance(tuning, TuningStream) and isinstance(reported, Stream)
    one, other = tuning.test_contexts(task), reported.test_contexts(task)
    assert np.linalg.norm(one[:, None] - other, axis=2).min() > 0.001  # m; of 100,000 pairs
    assert tuning.n_demonstrations == reported.n_demonstrations


@pytest.mark.parametrize("label", STREAMED.algorithms)
def test_what_is_tuned_over_contexts_is_accepted(label: str) -> None:
    plan = TuningPlan.of("random-bottles", STREAMED, [1000], 2, 500)
    algorithm = STREAMED.algorithms[label]
    space = study.space_of(algorithm, plan)
    ours = label == "RC-NMP" or label.startswith("twin")
    assert ("contextual.wanted_rate" in space) == ours
    assert "temperature" not in space  # of parents, of which there are none over contexts
    for end in (0, -1):
        chosen = {name: values(what)[end] for name, what in space.items()}
        settings = with_settings(algorithm, chosen).settings
        made = algorithm.load()("MlpPolicy", plan.task, **settings)
        assert not ours or made.contextual.wanted_rate == chosen["contextual.wanted_rate"]


@pytest.mark.parametrize("label", ["ProMP+RL (Ewerton)", "contextual REPS", "contextual CMA-ES"])
def test_what_is_tuned_on_apertures_is_accepted(label: str) -> None:
    recipe = find_recipe("aperture")
    plan = TuningPlan.of("aperture", recipe, [1000], 2, 3000)
    assert plan.measure == "failures" and plan.shows
    algorithm = recipe.algorithms[label]
    space = study.space_of(algorithm, plan)
    assert 2 <= len(space) <= 4
    shown = Demonstrations.from_task(plan.task, 3, np.random.default_rng(0))
    for end in range(len(values(space["population_size"]))):
        chosen = {name: values(what)[min(end, 1)] for name, what in space.items()}
        chosen["population_size"] = values(space["population_size"])[end]
        settings = with_settings(algorithm, chosen).settings
        algorithm.load()("MlpPolicy", plan.task, demonstrations=shown, **settings)


def test_a_stream_costs_the_share_that_fails_and_nothing_else() -> None:
    plan = TuningPlan.of("random-bottles", STREAMED, [1000], 2)
    assert plan.measure == "failures"
    assert plan.cost({"failure_rate": [1.0, 0.5, 0.0]}) == pytest.approx(0.5)
    assert plan.told(Trial({}, 0.125)) == "12.5% fail"
    for measure in ("rollouts", "reward"):
        with pytest.raises(BenchmarkError, match="random-bottles' a trial costs 'failures'"):
            TuningPlan.of("random-bottles", STREAMED, [1000], 2, measure=measure)
    with pytest.raises(BenchmarkError, match="'rivals' a trial costs 'rollouts' or 'reward'"):
        TuningPlan.of("rivals", RECIPE, [1000], 2, measure="failures")


@pytest.mark.parametrize("label", ["REPS", "DREPS", "RC-NMP", "GA", "GA, judged"])
def test_populations_that_are_tuned_fit_the_budget(label: str) -> None:
    """With 18 rollouts REPS was once tuned over populations of 10 to 30: its own 9 stayed best."""
    recipe = find_recipe("pouring")
    declared = study.space_of(recipe.algorithms[label], PLAN)
    short = TuningPlan.of("pouring", recipe, [1000], 2)
    tuned = study.space_of(recipe.algorithms[label], short)
    own = recipe.algorithms[label].settings["population_size"]
    of_class = recipe.algorithms[label].load().tunable["population_size"]
    assert declared["population_size"] == Choice((own, *of_class.values))
    assert tuned == {**declared, "population_size": Choice((3, 4, 6, 9))}
    longer = replace(short, budget=100)
    assert study.space_of(recipe.algorithms[label], longer) == declared


def test_what_a_suite_has_set_lies_in_what_is_tuned() -> None:
    """Curves through points need 20 bases, and spaces that end at 15 would tune around the best."""
    recipe = find_recipe("via-points")
    plan = TuningPlan.of("via-points", recipe, [1000], 2, variants=["3 points", "6points"])
    space = study.space_of(recipe.algorithms["GA"], plan)
    assert space["mutation.n_bases"] == Range(6, 30, integer=True)
    assert space["mutation_decay"] == Range(0.65, 0.96)
    assert space["population_size"] == Choice((5, 20, 30))
    assert space["temperature"] == GA.tunable["temperature"], "which the suite leaves as it is"
    reps = study.space_of(recipe.algorithms["REPS"], plan)
    assert reps["n_bases"] == Range(6, 30, integer=True)
    assert Range(6, 15, integer=True).reaching(5).low == 3
    assert Range(0.5, 1.0).reaching(0.2).low == 0.2


def test_each_seed_is_run_in_each_variant(monkeypatch: pytest.MonkeyPatch) -> None:
    recipe = find_recipe("via-points")
    plan = TuningPlan.of("via-points", recipe, [1000, 1001], 1, 1, "reward", ["6 points", "1point"])
    done: list[tuple[int, Any]] = []

    def noted(run: Any) -> Any:
        done.append((run.seed, run.task_settings["n_points"]))
        return execute(run)

    monkeypatch.setattr(trials, "execute", noted)
    assert study.cost_of("r", RANDOM_SEARCH, plan) is not None
    assert done == [(1000, 6), (1001, 6), (1000, 1), (1001, 1)]
    assert plan.n_runs == 4 and list(plan.record["variants"]) == ["6 points", "1 point"]
    assert "variants" not in PLAN.record, "studies of one variant are told as before"
    assert TuningPlan.of("via-points", recipe, [1000], 2).n_runs == 6
    told = "has no variant '7 points'; it has '1 point', '2 points'"
    with pytest.raises(BenchmarkError, match=told):
        TuningPlan.of("via-points", recipe, [1000], 2, variants=["7 points"])


@pytest.mark.parametrize("budget", [8, 31, 32, 40, 1000])
def test_declared_populations_stay_where_two_of_them_fit(budget: int) -> None:
    recipe = find_recipe("pouring")
    plan = replace(TuningPlan.of("pouring", recipe, [1000], 2), budget=budget)
    tuned = values(study.space_of(recipe.algorithms["REPS"], plan)["population_size"])
    assert budget < 32 or tuned == [9, 10, 16, 20, 30], "the first is the suite's own"
    assert min(tuned) >= 2 and sorted(tuned)[1] <= budget / 2
    least = study.space_of(recipe.algorithms["REPS"], replace(plan, budget=5))
    assert values(least["population_size"]) == [9, 10, 16, 20, 30], "no two populations fit"


def test_a_trial_costs_what_the_measure_says() -> None:
    curve = {
        "rollouts": [0, 5, 9],
        "greedy_success": [False, True, True],
        "greedy_reward": [-3, -2, -1],
    }
    assert PLAN.cost(curve) == pytest.approx(np.log(5))
    assert PLAN.cost(curve | {"greedy_success": [True] * 3}) == 0.0
    assert replace(PLAN, measure="reward").cost(curve) == 1.0


def test_rows_take_the_best_settings_of_the_committed_studies(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(rows, "STUDIES", tmp_path)
    assert rows.tuned_rows("rivals", RECIPE.algorithms) == {}
    trials = (Trial({}, 5.0), Trial({"epsilon": 2.5}, 3.0))
    StudySummary("REPS", "reps", PLAN, {}, trials).write(tmp_path)
    found = rows.tuned_rows("rivals", RECIPE.algorithms)
    assert list(found) == ["REPS, tuned"]
    assert found["REPS, tuned"].settings["epsilon"] == 2.5
    assert "the best of 2 trials" in found["REPS, tuned"].description
    assert found["REPS, tuned"].n_trials == 2
    StudySummary("REPS", "reps", PLAN, {}, trials[:1]).write(tmp_path)
    assert rows.tuned_rows("rivals", RECIPE.algorithms) == {}  # the suite's own are the best
    study.study_path(tmp_path, "rivals", "REPS").write_text('{"best": ')
    with pytest.raises(BenchmarkError, match=r"reps.json' is no study that can be read"):
        rows.tuned_rows("rivals", RECIPE.algorithms)


def test_tuning_keeps_what_a_suite_has_set_but_for_what_is_tuned() -> None:
    thesis = find_recipe("push").algorithms["ACNMP (thesis)"]
    tuned = with_settings(thesis, {"exploration.radius": 0.9}).settings["exploration"]
    assert tuned == replace(thesis.settings["exploration"], radius=0.9)


def test_every_algorithm_has_as_many_trials_and_the_first_is_the_suites(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("optuna")
    seen: list[Any] = []

    def cost(label: str, algorithm: Any, plan: TuningPlan) -> float | None:
        seen.append((label, dict(algorithm.settings), plan.seeds))
        n = algorithm.settings.get("n_bases", 10)
        return None if n == 4 else float((n - 8) ** 2)

    monkeypatch.setattr(study, "cost_of", cost)
    plan = TuningPlan.of("rivals", RECIPE, [1000, 1001], n_trials=12)
    summaries = [tune(label, RECIPE.algorithms[label], plan) for label in ("CMA-ES", "TuRBO")]
    assert [len(each.trials) for each in summaries] == [12, 12]
    assert len(seen) == 24
    assert {seeds for _, _, seeds in seen} == {(1000, 1001)}
    assert seen[0][1] == dict(RECIPE.algorithms["CMA-ES"].settings)
    for each in summaries:
        assert each.trials[0].chosen == {}
        assert each.best.cost is not None
        assert each.trials[0].cost is not None
        assert each.best.cost <= each.trials[0].cost
    again = tune("TuRBO", RECIPE.algorithms["TuRBO"], plan)
    assert again.trials == summaries[1].trials


#: ends itself as `kill -9` would, before it begins one more trial than the first argument says
MORTAL = """
import os, signal, sys
from results.cli import main
from results.tuning import study

left, cost_of = [int(sys.argv[1])], study.cost_of

def mortal(*asked):
    if left[0] == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    left[0] -= 1
    return cost_of(*asked)

study.cost_of = mortal
sys.exit(main(sys.argv[2:]))
"""


def test_a_study_that_is_killed_goes_on_where_it_was(tmp_path: Path) -> None:
    """Optuna proposes ten trials at random and the later ones by those before."""
    pytest.importorskip("optuna")
    asked = [
        "tune", "--suite", "rivals", "--algorithms", "random search", "--trials", "14",
        "--seeds", "1000,", "--budget", "3", "--measure", "reward", "--out",
    ]  # fmt: skip
    assert main([*asked, str(tmp_path / "whole")]) == 0
    killed = tmp_path / "killed/rivals"
    for n_trials, n_more in ((2, 2), (12, 10)):
        command = [sys.executable, "-c", MORTAL, str(n_more), *asked, str(killed.parent)]
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == -signal.SIGKILL, done.stderr
        (path,) = killed.iterdir()
        assert path.name == "random-search.unfinished.json"
        assert len(json.loads(path.read_text())["trials"]) == n_trials
    assert main([*asked, str(killed.parent)]) == 0
    (path,) = killed.iterdir()
    assert path.read_bytes() == (tmp_path / "whole/rivals" / path.name).read_bytes()
    costs = [trial["cost"] for trial in json.loads(path.read_text())["trials"]]
    assert len(costs) == 14 and len(set(costs)) > 5


def n_bases_cost(label: str, algorithm: Any, plan: TuningPlan) -> float | None:
    n = algorithm.settings.get("n_bases", 10)
    return None if n in (2, 14) else float((n - 8) ** 2) / 3.0


def killed_studies(patch: pytest.MonkeyPatch, folder: Path, n_trials: int) -> list[str]:
    """What a command says that goes on with a study of so many trials out of 14."""
    n_left = [n_trials]

    def mortal(*asked: Any) -> float | None:
        if n_left[0] == 0:
            raise KeyboardInterrupt
        n_left[0] -= 1
        return n_bases_cost(*asked)

    def full(*_: Any) -> None:
        raise KeyboardInterrupt

    plan = TuningPlan.of("rivals", RECIPE, [1000], n_trials=14)
    patch.setattr(study, "cost_of", mortal)
    with pytest.MonkeyPatch.context() as inner, pytest.raises(KeyboardInterrupt):
        inner.setattr(StudySummary, "write", full)  # after the last trial
        list(study.tune_suite(RECIPE, plan, folder, ["CMA-ES"]))
    patch.setattr(study, "cost_of", n_bases_cost)
    return list(study.tune_suite(RECIPE, plan, folder, ["CMA-ES"]))


@pytest.mark.parametrize("n_trials", [0, 1, 5, 11, 13, 14])
def test_trials_are_the_same_wherever_a_study_was_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, n_trials: int
) -> None:
    """Failed ones among them, which the sampler is told of, too."""
    pytest.importorskip("optuna")
    monkeypatch.setattr(study, "cost_of", n_bases_cost)
    plan = TuningPlan.of("rivals", RECIPE, [1000], n_trials=14)
    whole = tune("CMA-ES", RECIPE.algorithms["CMA-ES"], plan)
    assert None in [trial.cost for trial in whole.trials]
    told = killed_studies(monkeypatch, tmp_path, n_trials)
    assert told[:-1] == [f"CMA-ES: going on after {n_trials} of 14 trials"] * (n_trials > 0)
    assert [each.name for each in (tmp_path / "rivals").iterdir()] == ["cma-es.json"]
    written = study.study_path(tmp_path, "rivals", "CMA-ES").read_bytes()
    assert written == whole.write(tmp_path / "whole").read_bytes()


def test_a_study_does_not_go_on_with_another_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("optuna")
    monkeypatch.setattr(study, "cost_of", n_bases_cost)
    plan = TuningPlan.of("rivals", RECIPE, [1000], n_trials=4)
    begun = (Trial({}, 1.0), Trial({"n_bases": 5}, 2.0))
    path = StudySummary("CMA-ES", "cmaes", plan, {}, begun).keep(tmp_path)
    assert path == study.unfinished_path(study.study_path(tmp_path, "rivals", "CMA-ES"))
    with pytest.raises(BenchmarkError, match=r"its trial 1 tried \{'n_bases': 5\}, and today"):
        list(study.tune_suite(RECIPE, plan, tmp_path, ["CMA-ES"]))
    with pytest.raises(BenchmarkError, match=r"unfinished.json' is a study of another plan"):
        list(study.tune_suite(RECIPE, replace(plan, budget=7), tmp_path, ["CMA-ES"]))
    (told,) = study.tune_suite(RECIPE, plan, tmp_path, ["CMA-ES"], overwrite=True)
    assert "4 trials" in told and not path.exists()
    path.write_text("{}")  # beside a finished study, it says nothing
    (told,) = study.tune_suite(RECIPE, plan, tmp_path, ["CMA-ES"])
    assert "kept" in told and not path.exists()


def test_rows_know_nothing_of_a_study_that_is_not_finished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rows, "STUDIES", tmp_path)
    begun = (Trial({}, 5.0), Trial({"epsilon": 2.5}, 3.0))
    StudySummary("REPS", "reps", replace(PLAN, n_trials=3), {}, begun).keep(tmp_path)
    assert rows.tuned_rows("rivals", RECIPE.algorithms) == {}


def test_unsolved_runs_cost_twice_the_budget_and_failed_ones_nothing_known() -> None:
    hopeless = with_settings(RANDOM_SEARCH, {"n_bases": 4})
    plan = TuningPlan.of("rivals", RECIPE, [1000], n_trials=1, budget=1)
    assert study.cost_of("r", hopeless, plan) == pytest.approx(np.log(2))
    assert study.cost_of("r", with_settings(RANDOM_SEARCH, {"n_bases": 1}), plan) is None


def test_the_command_writes_studies_and_keeps_those_that_are_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("optuna")
    arguments = [
        "tune", "--suite", "rivals", "--algorithms", "random search", "--trials", "2",
        "--seeds", "1000,", "--budget", "5", "--out", str(tmp_path),
    ]  # fmt: skip
    assert main(arguments) == 0
    written = json.loads((tmp_path / "rivals" / "random-search.json").read_text())
    assert written["trials"][0]["chosen"] == {}
    assert written["plan"]["n_trials"] == len(written["trials"]) == 2
    assert written["best"] in written["trials"]
    assert "2 trials of 1 runs" in capsys.readouterr().out
    assert main(arguments) == 0
    assert "random search: kept" in capsys.readouterr().out
    (tmp_path / "file").write_text("")
    assert main([*arguments[:-1], str(tmp_path / "file")]) == 2
    assert "file', where nothing can be written" in capsys.readouterr().err
    assert main(["tune", "--seeds", "1000"]) == 2
    assert "the tuning seeds are [0, 1, 2, ...]; reported" in capsys.readouterr().err


def test_a_study_whose_trials_all_failed_is_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("optuna")

    def broken(*_: object) -> object:
        raise BenchmarkError("the engine is cold")

    monkeypatch.setattr(trials, "execute", broken)
    arguments = ["tune", "--suite", "rivals", "--algorithms", "random search", "--trials", "2"]
    assert main([*arguments, "--seeds", "1000,", "--budget", "5", "--out", str(tmp_path)]) == 2
    told = capsys.readouterr().err
    assert told.count("trial of random search failed, BenchmarkError: the engine is cold") == 2
    assert "all 2 trials of random search failed" in told
    assert not list(tmp_path.rglob("*.json"))


def test_a_study_that_cannot_be_done_anew_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("optuna")
    monkeypatch.setattr(study, "cost_of", lambda *_: None)
    old = StudySummary("REPS", "reps", PLAN, {}, (Trial({}, 5.0),) * PLAN.n_trials).write(tmp_path)
    before = old.read_bytes()
    with pytest.raises(BenchmarkError, match="all 4 trials of REPS failed"):
        list(study.tune_suite(RECIPE, PLAN, tmp_path, ["REPS"], overwrite=True))
    assert [old.read_bytes()] == [before]
    assert list(old.parent.iterdir()) == [old]


@pytest.mark.parametrize("budget", ["0", "-5"])
def test_a_budget_is_at_least_one(budget: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["tune", "--budget", budget]) == 2
    assert f"the budget is {budget}; a run needs at least 1" in capsys.readouterr().err


def test_a_folder_holds_studies_of_one_plan(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Else a row with more trials than its rivals would be called equally tuned."""
    made = TuningPlan.of("rivals", RECIPE, [1000], n_trials=2, budget=5)
    StudySummary("GA", "ga", made, {}, (Trial({}, 1.0), Trial({"x": 1}, 0.5))).write(tmp_path)
    asked = ["tune", "--suite", "rivals", "--algorithms", "random search", "--seeds", "1000,"]
    asked += ["--budget", "5", "--out", str(tmp_path)]
    for more in ([], ["--overwrite"]):  # of the one study, and the other would stay as it is
        assert main([*asked, "--trials", "9", *more]) == 2
        told = capsys.readouterr().err
        assert "ga.json' is a study of another plan: n_trials was 2, and 9 is asked" in told
    (tmp_path / "rivals/ga.json").write_text("{}")
    assert main([*asked, "--trials", "2"]) == 2
    assert "no study that can be read" in capsys.readouterr().err
    assert not (tmp_path / "rivals/random-search.json").exists()


def test_what_cannot_be_tuned_is_refused() -> None:
    with pytest.raises(BenchmarkError, match="the suite 'random-push' cannot be tuned"):
        TuningPlan.of("random-push", find_recipe("random-push"), [1000], 3)
    with pytest.raises(BenchmarkError, match="measure is 'luck'; a trial costs rollouts or"):
        TuningPlan.of("rivals", RECIPE, [1000], 3, measure="luck")  # type: ignore[arg-type]
    with pytest.raises(BenchmarkError, match="nmp/Bottles-v0 has no tuning contexts"):
        TuningContext(0).split("nmp/Bottles-v0")
    with pytest.raises(BenchmarkError, match="nmp/Bottles-v0 has no tuning contexts"):
        tuning_contexts("nmp/Bottles-v0")
    for number in (-1, 4):
        with pytest.raises(BenchmarkError, match=f"no tuning context {number}; .* 0 to 3"):
            TuningContext(number).split("nmp/Push-v0")
    with pytest.raises(BenchmarkError, match="n_trials is 0"):
        TuningPlan.of("rivals", RECIPE, [1000], 0)
    best = StudySummary("a", "a", PLAN, {}, (Trial({}, None), Trial({"x": 1}, 2.0))).best
    assert best.chosen == {"x": 1}
    with pytest.raises(ConfigurationError, match="must have low < high"):
        Range(1.0, 1.0)
    with pytest.raises(ConfigurationError, match="give at least two"):
        Choice((1,))
