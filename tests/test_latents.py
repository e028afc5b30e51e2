"""Figures 5.8 and 5.9: the common latent space of two arms, watched while it is formed."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark_envs import make_task
from benchmark_envs.tasks.planar_arm_task import PlanarArmTask
from results.exceptions import SettingsClashError
from results.harness.records import ProtocolRecord, RunRecord
from results.thesis import find_figure
from results.transfer.latents import (
    FIRST_SEED,
    MOMENTS,
    N_VIEWS,
    LatentRun,
    _snapshot,
    agreement,
    latent_runs,
    run_latents,
    shuffled,
    views,
)
from results.transfer.scenes import boxes, scene
from sb3_nmp import SkillTransfer, TransferTraining
from tests.records_fakes import finished_run, specification
from tests.test_transfer import GRID, NEW, SMALL, SOURCE, TARGET, first_robot, second_robot


def watched(n_steps: int, weight: float = 100.0) -> tuple[SkillTransfer, list[int]]:
    training, seen = TransferTraining(n_steps=n_steps, latent_weight=weight), list[int]()
    model = SkillTransfer(SOURCE, TARGET, architecture=SMALL, training=training, seed=0)

    def watch(n_done: int) -> None:
        model.translate(first_robot(NEW))
        seen.append(n_done)

    return model.fit(watch), seen


def test_watching_a_training_sees_every_step_and_changes_nothing() -> None:
    model, seen = watched(4)
    alone = SkillTransfer(
        SOURCE, TARGET, architecture=SMALL, training=TransferTraining(n_steps=4), seed=0
    ).fit()
    assert seen == [0, 1, 2, 3, 4]
    assert np.array_equal(model.translate(first_robot(NEW)), alone.translate(first_robot(NEW)))


def test_agreement_is_of_neighbours_and_shuffling_leaves_chance() -> None:
    rng, skills = np.random.default_rng(0), np.repeat(np.arange(12), 8)
    places = rng.normal(size=(12, 5))[skills]
    one, two = (places + 0.01 * rng.normal(size=places.shape) for _ in range(2))
    assert agreement(one, two, skills) == 1.0
    assert agreement(one, rng.normal(size=one.shape), skills) < 0.2
    by_chance = shuffled(one, two, skills, rng)
    assert by_chance["mean"] == pytest.approx(1 / 12, abs=0.02)
    assert by_chance["mean"] < by_chance["high"] < 0.3


def test_a_snapshot_tells_a_common_space_from_two_apart() -> None:
    """On two synthetic robots, trained with the distance of Eq. 5.4 and without."""
    tests = [(robot(NEW), robot(GRID[:1] * 0.9)[0]) for robot in (first_robot, second_robot)]
    found = []
    for weight in (100.0, 0.0):
        model, _ = watched(150, weight)
        found.append(_snapshot(model, (SOURCE, TARGET), tests, np.random.default_rng(0)))
    shared, apart = found
    assert shared["agreement"] > 0.8 > 0.4 > apart["agreement"]
    assert np.shape(shared["map"]) == (2 * len(GRID) * N_VIEWS + 2, 2)
    seen = views(model, "target", TARGET.trajectories, np.random.default_rng(0))
    assert seen.shape == (len(GRID) * N_VIEWS, SMALL.representation_dim)


def test_runs_have_seeds_that_were_not_tuned_on_and_differ_in_the_distance_alone() -> None:
    runs = latent_runs(2, 0.1)
    assert [(run.seed, run.shared) for run in runs] == [
        (2, True),
        (2, False),
        (3, True),
        (3, False),
    ]
    weights = [run.record.settings.pop("latent_weight") for run in runs[:2]]
    assert weights[0] > 0 == weights[1]
    assert runs[0].record.stem != runs[1].record.stem
    assert LatentRun(True, 2).record.budget == 10 * runs[0].record.budget


def test_runs_that_a_folder_holds_are_kept_and_others_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("results.transfer.latents.measure", lambda run: {"seed": run.seed})
    told: list[str] = []
    for _ in range(2):
        run_latents(tmp_path, latent_runs(1), 1, told.append)
    assert len(told) == len(list(tmp_path.iterdir())) == 2
    with pytest.raises(SettingsClashError, match="other settings"):
        run_latents(tmp_path, [LatentRun(True, 2, n_steps=1)], 1, told.append)


def test_scenes_show_the_arm_at_its_target_and_the_slot_around_it() -> None:
    task = make_task("nmp/PegInsertion-v0", n_threads=1, arm="3dof")
    assert isinstance(task, PlanarArmTask)
    context = np.array([0.43, 0.15])
    drawn = scene(task, context)
    tip = np.array(drawn["arm_lines"][-1][-1])
    assert drawn["solved"] and np.linalg.norm(tip - context) < 0.01
    assert np.linalg.norm(tip - np.array(drawn["path"])[-1]) < 0.01
    slot = np.array(boxes(task.model, context))
    assert slot.shape == (3, 4, 2)
    along = context / np.linalg.norm(context)
    across = (slot - context) @ np.array([-along[1], along[0]])
    assert np.abs(across[:2]).min() == pytest.approx(0.013), "a slot of 26 mm around the target"
    assert ((slot[2] - context) @ along).min() == pytest.approx(0.005), "and its end behind it"


# -- verdicts from records -------------------------------------------------------------------------


def run_of(label: str, seed: int, before: float, after: float, good: bool = True) -> RunRecord:
    chance = {"mean": 1 / 12, "high": 0.2}
    skills = [0, 0, 1, 1, 2, 2]
    snapshots = [
        {
            "step": i,
            "agreement": share,
            "shuffled": chance,
            "unseen": share,
            "unseen_shuffled": chance,
            "button": share > 0.5,
            "map": np.random.default_rng(0).normal(size=(2 * 6 * N_VIEWS + 2, 2)).tolist(),
        }
        for i, share in enumerate(np.linspace(before, after, len(MOMENTS)).tolist())
    ]
    asked = specification(label, seed, "transfer", protocol=ProtocolRecord("transfer"))
    line = [[0.0, 0.0], [0.1, 0.1]]
    drawn = {
        "task": "nmp/ArmPush-v0", "arm": "4dof", "arm_lines": [line] * 3, "thing": line,
        "boxes": [[*line, [0.0, 0.1], [0.1, 0.0]]], "path": line, "target": [0.1, 0.1],
    }  # fmt: skip
    more: dict[str, Any] = {
        "skills": skills, "snapshots": snapshots, "touched": good, "solved": good, "miss": 0.01,
        "experts": {"3dof": [good] * 13, "4dof": [True] * 13},
        "scenes": [drawn] if seed == FIRST_SEED else [],
    }  # fmt: skip
    return finished_run(asked, {"rollouts": [0]}, more=more)


def held(name: str, runs: list[RunRecord]) -> list[bool]:
    figure = find_figure(name)
    assert figure.draw is not None and figure.draw({"transfer": runs}).get_axes()
    return [finding.held for finding in figure.findings({"transfer": runs})]


@pytest.mark.parametrize("good", [True, False])
def test_figure_5_9_holds_where_training_brings_the_arms_together(good: bool) -> None:
    before, after = (0.1, 0.9) if good else (0.5, 0.1)
    seeds = range(FIRST_SEED, FIRST_SEED + 2)
    runs = [run_of("SkillTransfer", seed, before, after) for seed in seeds]
    runs += [run_of("two networks apart", seed, 0.1, 0.15) for seed in seeds]
    assert held("fig-5.9", runs) == [good] * 5


def test_figure_5_9_is_judged_by_the_worst_run() -> None:
    runs = [run_of("SkillTransfer", seed, 0.1, 0.9 - 0.2 * (seed == 4)) for seed in (2, 3, 4)]
    runs += [run_of("two networks apart", 2, 0.1, 0.36)]
    assert held("fig-5.9", runs) == [False, True, False, True, True]


@pytest.mark.parametrize("good", [True, False])
def test_figure_5_8_holds_where_the_arms_do_their_skills(good: bool) -> None:
    runs = [run_of("SkillTransfer", seed, 0.1, 0.9, good or seed != 3) for seed in (2, 3)]
    runs += [run_of("two networks apart", 2, 0.1, 0.1)]
    assert held("fig-5.8", runs) == [good] * 3
