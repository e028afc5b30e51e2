"""How the common latent space of two arms is formed (thesis 5.2.3, Fig. 5.9), a run per seed.

Shape letters: V views, Z latent. A view is a skill as an encoder sees it in training: a few of the
trajectory's time points.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.manifold import TSNE

from benchmark_envs import make_task
from results.harness.records import ProtocolRecord, SpecificationRecord, SuiteRecord, TaskRecord
from results.harness.training_runs import train_missing
from results.transfer.runs import ARCHITECTURE, TRAINING
from results.transfer.scenes import scenes
from results.transfer.skills import PROXIES, SOURCE, TARGET, button, proxy_contexts, shown
from sb3_nmp import Demonstrations, SkillTransfer, TransferTraining
from sb3_nmp.transfer.skill_transfer import Robot

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int_]

TASK = TaskRecord(("skill", "target x [m]", "target y [m]"), ("joint angles [rad]",), 0.05)
#: at which parts of the training the latent space is looked at
MOMENTS = (0.0, 0.02, 0.1, 0.3, 1.0)
FIRST_SEED = 2  # the settings were chosen on the proxies of seeds 0 and 1
N_VIEWS = 8  # of each skill and arm
N_UNSEEN = 4  # skills of each kind that neither network is shown
PERPLEXITY, N_SHUFFLES = 15, 1000
DECIMALS = 4
ROBOTS: tuple[Robot, Robot] = ("source", "target")
APART = "two networks apart"


@dataclass(frozen=True)
class LatentRun:
    """One training of the two arms' networks.

    :param shared: whether Eq. 5.4's distance between representations is in the loss
    :param seed: of proxies, weights and batches
    :param n_steps: of the training
    """

    shared: bool
    seed: int
    n_steps: int = TRAINING.n_steps

    @property
    def training(self) -> TransferTraining:
        """How the networks are trained."""
        weight = TRAINING.latent_weight if self.shared else 0.0
        return replace(TRAINING, n_steps=self.n_steps, latent_weight=weight)

    @property
    def record(self) -> SpecificationRecord:
        """The specification as records keep it."""
        settings = asdict(self.training)
        settings["conditioning_points"] = list(self.training.conditioning_points)  # as in JSON
        return SpecificationRecord(
            "SkillTransfer" if self.shared else APART, "", "skill-transfer",
            settings, "transfer", {}, self.seed, self.n_steps, True,
            ProtocolRecord("transfer"), SuiteRecord("transfer"),
        )  # fmt: skip


def latent_runs(n_seeds: int, shortened: float = 1.0) -> list[LatentRun]:
    """Return the runs of the figures, with and without the distance.

    :param n_seeds: of each, from `FIRST_SEED` on
    :param shortened: factor on the number of training steps
    """
    n_steps = round(shortened * TRAINING.n_steps)
    seeds = range(FIRST_SEED, FIRST_SEED + n_seeds)
    return [LatentRun(shared, seed, n_steps) for seed in seeds for shared in (True, False)]


def run_latents(
    folder: Path, runs: Sequence[LatentRun], n_workers: int | None, tell: Callable[[str], None]
) -> None:
    """Do the runs that a folder does not hold yet, in parallel processes.

    :param folder: of the runs
    :param runs: those wanted
    :param n_workers: processes; one per core by default
    :param tell: is told the name of each run that has ended
    :raises SettingsClashError: the folder holds one of them with other settings
    """
    train_missing(folder, runs, measure, TASK, n_workers, tell)


def measure(run: LatentRun) -> dict[str, Any]:
    """Train the networks and return their latent spaces on the way, as JSON values.

    :param run: which
    """
    contexts, rng = proxy_contexts(run.seed), np.random.default_rng(run.seed)
    shown_pair = shown(SOURCE, contexts), shown(TARGET, contexts)
    model = SkillTransfer(
        *shown_pair, architecture=ARCHITECTURE, training=run.training, seed=run.seed
    )
    unseen = unseen_contexts(rng)
    tests = [(shown(arm, unseen).trajectories, button(arm)[2]) for arm in (SOURCE, TARGET)]
    moments, snapshots = {round(share * run.n_steps) for share in MOMENTS}, []

    def watch(n_done: int) -> None:
        if n_done in moments:
            snapshots.append({"step": n_done} | _snapshot(model, shown_pair, tests, rng))

    model.fit(watch)
    more = {"kinds": [name for name in PROXIES], "skills": contexts[:, 0].astype(int).tolist()}
    return more | {"snapshots": snapshots} | _transferred(model, shown_pair, run)


def unseen_contexts(rng: np.random.Generator) -> FloatArray:
    """Draw skills that neither network is shown, as `proxy_contexts` gives them.

    They lie anywhere that the tasks put targets, not only near the recordings' ends.

    :param rng: the generator to draw from
    """
    tasks = [make_task(name, n_threads=1, arm=TARGET) for name in PROXIES]
    return np.array(
        [[k, *task.sample_context(rng)] for k, task in enumerate(tasks) for _ in range(N_UNSEEN)]
    )


def _snapshot(
    model: SkillTransfer,
    shown_pair: tuple[Demonstrations, Demonstrations],
    tests: list[tuple[FloatArray, FloatArray]],
    rng: np.random.Generator,
) -> dict[str, Any]:
    source, target = (
        views(model, robot, each.trajectories, rng)
        for robot, each in zip(ROBOTS, shown_pair, strict=True)
    )
    skills = np.repeat(np.arange(len(shown_pair[0])), N_VIEWS)
    unseen, buttons = [], []
    for robot, (trajectories, press) in zip(ROBOTS, tests, strict=True):
        unseen.append(model.encode(trajectories, robot=robot))
        buttons.append(model.encode(press, robot=robot))
    each = np.arange(len(unseen[0]))
    among = np.vstack([buttons[1], model.encode(shown_pair[1].trajectories, robot="target")])
    map_of_both = TSNE(perplexity=PERPLEXITY, init="pca", random_state=0).fit_transform(
        np.vstack([source, target, *buttons])
    )
    return {
        "agreement": agreement(source, target, skills),
        "shuffled": shuffled(source, target, skills, np.random.default_rng(0)),
        "unseen": agreement(unseen[0], unseen[1], each),
        "unseen_shuffled": shuffled(unseen[0], unseen[1], each, np.random.default_rng(0)),
        "button": bool(nearest(buttons[0], among)[0] == 0),
        "map": np.asarray(map_of_both, np.float64).round(2).tolist(),
    }


def views(
    model: SkillTransfer, robot: Robot, trajectories: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Return latents of each skill, from random time points as in training, shape (V, Z).

    :param model: with the encoders
    :param robot: ``"source"`` or ``"target"``
    :param trajectories: shape (N, T, D); V is N times `N_VIEWS`, skill by skill
    :param rng: the generator to draw from
    """
    low, high = model.training.conditioning_points
    n_time_points, found = trajectories.shape[1], []
    for trajectory in trajectories:
        for _ in range(N_VIEWS):
            at = rng.integers(n_time_points, size=rng.integers(low, high + 1))
            seen = trajectory[at], at / (n_time_points - 1)
            found.append(model.encode(*seen, robot=robot)[0])
    return np.stack(found)


def nearest(ones: FloatArray, others: FloatArray) -> IntArray:
    """Return for each point which of the others is the nearest, shape (N,).

    :param ones: shape (N, Z)
    :param others: shape (M, Z)
    """
    return np.linalg.norm(ones[:, None] - others[None], axis=2).argmin(axis=1)


def agreement(source: FloatArray, target: FloatArray, skills: IntArray) -> float:
    """Return the share of points whose nearest point of the other arm is of the same skill.

    >>> a, skills = np.array([[0.0], [1.0], [2.0]]), np.arange(3)
    >>> agreement(a, a + 0.1, skills), agreement(a, a[::-1], skills)
    (1.0, 0.3333333333333333)

    :param source: of one arm, shape (V, Z)
    :param target: of the other, shape (V, Z)
    :param skills: which skill each is, of both, shape (V,)
    """
    there, back = nearest(source, target), nearest(target, source)
    agreed = np.concatenate([skills[there] == skills, skills[back] == skills])
    return float(agreed.mean())


def shuffled(
    source: FloatArray, target: FloatArray, skills: IntArray, rng: np.random.Generator
) -> dict[str, float]:
    """Return the agreement where the other arm's skills are shuffled: its mean and 95 % quantile.

    :param source: as in `agreement`
    :param target: as in `agreement`
    :param skills: as in `agreement`
    :param rng: the generator to draw from
    """
    there, back = nearest(source, target), nearest(target, source)
    found = []
    for _ in range(N_SHUFFLES):
        other = rng.permutation(skills.max() + 1)[skills]
        found.append(np.concatenate([other[there] == skills, skills[back] == other]).mean())
    return {"mean": float(np.mean(found)), "high": float(np.quantile(found, 0.95))}


def _transferred(
    model: SkillTransfer, shown_pair: tuple[Demonstrations, Demonstrations], run: LatentRun
) -> dict[str, Any]:
    """Return what the arms do in simulation: proxies, the button press, and its translation."""
    translated = model.translate(button(SOURCE)[2])
    task, context, expert = button(TARGET)
    tried = task.simulate(context, translated)
    is_drawn = run.seed == FIRST_SEED and run.shared
    return {
        "experts": {
            arm: solved(arm, each) for arm, each in zip((SOURCE, TARGET), shown_pair, strict=True)
        },
        "scenes": scenes(shown_pair[0].contexts) if is_drawn else [],
        "translated": translated.round(DECIMALS).tolist(),
        "rmse": np.sqrt(np.mean((translated - expert) ** 2, axis=0)).round(DECIMALS).tolist(),
        "touched": bool(tried.outcomes["touched"][0]),
        "solved": bool(tried.successes[0]),
        "miss": -float(tried.rewards[0]),
    }


def solved(arm: str, proxies: Demonstrations) -> list[bool]:
    """Return whether an arm's demonstrations solve the proxy skills, and last the button press.

    :param arm: ``"3dof"`` or ``"4dof"``
    :param proxies: as `shown` returns them
    """
    tasks = [make_task(name, n_threads=1, arm=arm) for name in PROXIES]
    tries = [
        (tasks[int(context[0])], context[1:], trajectory)
        for context, trajectory in zip(proxies.contexts, proxies.trajectories, strict=True)
    ]
    return [
        bool(task.simulate(context, trajectory).successes[0])
        for task, context, trajectory in [*tries, button(arm)]
    ]
