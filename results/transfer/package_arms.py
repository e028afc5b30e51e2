"""Skill transfer between two arms that pip packages ship: Gymnasium's pusher and Fetch.

Both are read from their MJCF files by `benchmark_envs.robots`: seven hinges lead a finger tip of
the pusher, and a slide and seven hinges the gripper of Fetch. Their proxy skills are places in
front of the arm, in units of 0.15 m around where its tip begins. What the pusher is told, ACNMP
refines.
"""

import importlib.util
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from baselines import MomentRegression
from baselines.transfer.moment_regression import Function
from benchmark_envs import TrajectoryEnv
from benchmark_envs.robots import Arm, ArmTask, ViaPose
from results.exceptions import BenchmarkError
from results.transfer.runs import (
    ARCHITECTURE,
    Remembering,
    by_moments,
    first_success,
    nearest_skill,
    refine,
)
from sb3_nmp import Demonstrations, SkillTransfer, TransferTraining

FloatArray = NDArray[np.float64]

UNIT = 0.15  # m
#: the proxy skills; and those that the source alone shows, of a known kind and of a new one
KINDS = ("reach", "lower", "sweep")
TESTS = ("lower", "press")
GRID = np.array([[aside, ahead] for aside in (-0.7, 0.0, 0.7) for ahead in (-0.7, 0.0, 0.7)])
JITTER, N_TESTS = 0.2, 4
TRAINING = TransferTraining(n_steps=3000)
FETCH_JOINTS = (
    "torso_lift", "shoulder_pan", "shoulder_lift", "upperarm_roll", "elbow_flex", "forearm_roll",
    "wrist_flex", "wrist_roll",
)  # fmt: skip


def package_file(package: str, path: str) -> Path:
    """Return a file of an installed package, without importing it.

    :param package: its name
    :param path: of the file inside
    :raises BenchmarkError: it is not installed
    """
    found = importlib.util.find_spec(package)
    if found is None or found.origin is None:
        raise BenchmarkError(
            f"{package} is not installed; install it with 'pip install sb3-nmp[robotics,robots]'."
        )
    return Path(found.origin).parent / path


def fetch() -> Arm:
    """Return Fetch: its torso's slide and the seven hinges of its arm."""
    return Arm(
        package_file("gymnasium_robotics", "envs/assets/fetch/reach.xml"),
        tip="robot0:grip",
        joints=[f"robot0:{name}_joint" for name in FETCH_JOINTS],
        start=[0.2, 0.0, 0.2, 0.0, 1.0, 0.0, 0.6, 0.0],
    )


def pusher() -> Arm:
    """Return Gymnasium's pusher: seven hinges."""
    return Arm(package_file("gymnasium", "envs/mujoco/assets/pusher_v5.xml"), tip="tip_arml")


def way_of(kind: str, place: FloatArray, middle: FloatArray, forward: FloatArray) -> list[ViaPose]:
    """Return the via-poses of a skill.

    :param kind: one of `KINDS`, or ``"press"``
    :param place: to the side and ahead, shape (2,) in `UNIT`
    :param middle: where the tip begins, shape (3,) in m
    :param forward: ahead of the arm, shape (3,)
    """
    side = np.cross([0.0, 0.0, 1.0], forward)

    def at(when: float, height: float = 0.0, aside: float = 0.0) -> ViaPose:
        offset = (place[0] + aside) * side + place[1] * forward + height * np.array([0, 0, 1.0])
        return ViaPose(middle + UNIT * offset, at=when)

    ways = {
        "reach": [at(0.9)],
        "lower": [at(0.45, 0.3), at(0.9, -0.5)],
        "sweep": [at(0.45), at(0.9, aside=0.8)],
        "press": [at(0.4, 0.3), at(0.65, -0.5), at(0.95, 0.3)],
    }
    return ways[kind]


def tasks_of(arm: Arm, forward: FloatArray) -> dict[str, ArmTask]:
    """Return a task for each kind of skill.

    :param arm: that moves
    :param forward: ahead of it, shape (3,)
    """
    middle, kinds = arm.tip_position(arm.start), (*KINDS, "press")

    def task(kind: str) -> ArmTask:
        return ArmTask(
            arm, lambda place: way_of(kind, place, middle, forward),
            context_names=["aside", "ahead"], context_low=[-1, -1], context_high=[1, 1],
            n_threads=1,
        )  # fmt: skip

    return {kind: task(kind) for kind in kinds}


@dataclass(frozen=True)
class PackageRun:
    """One seed.

    :param seed: of places, networks, batches and searches
    :param training: of the two networks
    :param budget: rollouts of a refinement
    :param population_size: rollouts of an update
    """

    seed: int
    training: TransferTraining = TRAINING
    budget: int = 60
    population_size: int = 2


def shown(tasks: dict[str, ArmTask], skills: list[tuple[str, FloatArray]]) -> Demonstrations:
    """Return an arm's demonstrations; a context is the number of the kind, and the place.

    :param tasks: of the arm, by kind
    :param skills: kinds and places
    """
    kinds = list(tasks)
    contexts = np.array([[kinds.index(kind), *place] for kind, place in skills])
    return Demonstrations(contexts, np.stack([tasks[k].demonstrate(p) for k, p in skills]))


def measure(run: PackageRun, arms: dict[str, dict[str, ArmTask]]) -> dict[str, Any]:
    """Translate skills of Fetch to the pusher, and return what was measured, as JSON values.

    :param run: which
    :param arms: tasks by ``"source"`` and ``"target"``
    """
    rng = np.random.default_rng(run.seed)
    places = [place + rng.uniform(-JITTER, JITTER, 2) for _ in KINDS for place in GRID]
    kinds = np.repeat(KINDS, len(GRID)).tolist()
    proxies = list(zip(kinds, places, strict=True))
    source, target = (shown(arms[robot], proxies) for robot in ("source", "target"))
    model = SkillTransfer(
        source, target, architecture=ARCHITECTURE, training=run.training, seed=run.seed
    ).fit()
    moments = by_moments(source, target, run.seed)
    regression = MomentRegression(source, target).fit()
    found: dict[str, Any] = {"regression": asdict(cast(Function, regression.function))}
    for kind in TESTS:
        tests = [(kind, rng.uniform(-0.7, 0.7, 2)) for _ in range(N_TESTS)]
        told, truth = (shown(arms[robot], tests) for robot in ("source", "target"))
        near = [nearest_skill(each, source.trajectories) for each in told.trajectories]
        answers = {
            "translated": model.translate(told).trajectories,
            "moments": moments.translate(told).trajectories,
            "regression": regression.translate(told).trajectories,
            "nearest": target.trajectories[near],
        }
        task, places = arms["target"][kind], [place for _, place in tests]
        found[kind] = {
            name: compared(task, truth, answer) | {"refined": refined(run, task, places, answer)}
            for name, answer in answers.items()
        }
    return found


def refined(
    run: PackageRun, task: ArmTask, places: list[FloatArray], answers: FloatArray
) -> list[int | None]:
    """Return after how many rollouts ACNMP solves each test that begins with an answer, or None.

    :param run: its seed and budget
    :param task: of the target arm
    :param places: of the tests
    :param answers: shape (N, T, D) in rad, each the only demonstration of its test
    """
    low, high = task.trajectory_space.low, task.trajectory_space.high
    found = []
    for place, answer in zip(places, np.clip(answers, low, high), strict=True):
        env = Remembering(TrajectoryEnv(task, context=place))
        only = Demonstrations(place[None], answer[None])
        refine(env, only, run.seed, run.budget, run.population_size)
        found.append(first_success(env))
    return found


def compared(task: ArmTask, truth: Demonstrations, answers: FloatArray) -> dict[str, Any]:
    """Return how far answers are from the expert's trajectories, and what they do in MuJoCo.

    :param task: of the target arm
    :param truth: the expert's
    :param answers: shape (N, T, D) in rad
    """
    low, high = task.trajectory_space.low, task.trajectory_space.high
    rollouts = task.simulate(truth.contexts[:, 1:], np.clip(answers, low, high))
    square = np.mean((answers - truth.trajectories) ** 2, axis=(0, 1))
    return {
        "rmse": np.sqrt(square).round(4).tolist(),
        "misses": (-rollouts.rewards).round(4).tolist(),
        "solved": rollouts.successes.tolist(),
    }
