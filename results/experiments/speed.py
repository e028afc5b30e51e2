"""Speed of the simulator and of training, as ratios within one run.

Run it alone on an idle machine: ``python -m results.experiments.speed``. It prints a Markdown
table: the batched executor against a Python loop over the same model, RC-NMP's training against the
original code's batches of one trajectory with one target point, all tasks on 1 and 2 threads, the
critic of ACNMP and its twins in searches of few and of many rollouts, and RC-NMP's runs side by
side against runs one by one.
"""

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import mujoco
import numpy as np
import torch as th

from benchmark_envs import make_task, task_ids
from benchmark_envs.executor import available_cores
from benchmark_envs.tasks.bottles import BottlesTask
from sb3_nmp import RCNMP, RCNMPTraining, SmoothNoise
from sb3_nmp.bayesian.search import CriticSearch, Subspace
from sb3_nmp.bayesian.shaped_noise import noise_directions
from sb3_nmp.common.lockstep import together
from sb3_nmp.common.rollouts import Generation

N_ROLLOUTS = 128
N_DEMONSTRATED = 32  # rollouts of each task
REPEATS = 5
N_TOGETHER, LENGTH = 25, 200  # runs side by side, and rollouts of each


def rate(amount: int, work: Callable[[], object]) -> float:
    """Return amount per second, the median of some repeats after one that is not counted.

    :param amount: what one call does
    :param work: the call
    """
    work()
    seconds = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - begin)
    return amount / float(np.median(seconds))


def python_loop(task: BottlesTask, context: np.ndarray, trajectories: np.ndarray) -> None:
    """Step the same model in Python: set the controls, call ``mj_step``, read the sensors.

    :param task: the bottles task
    :param context: shape (4,)
    :param trajectories: shape (N, T, 2)
    """
    data = mujoco.MjData(task.model)
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = task._initial_state(context)
    for controls in task._controls(context[None], trajectories):
        mujoco.mj_setState(task.model, data, state, full)
        log = np.empty((len(controls), task.model.nsensordata))
        for step, control in enumerate(controls):
            data.ctrl[:] = control
            mujoco.mj_step(task.model, data)
            log[step] = data.sensordata


def simulator_rows() -> list[tuple[str, float, str]]:
    """Time the ways to run rollouts: name, rate and unit of each."""
    tasks: dict[int, Any] = {n: make_task("nmp/Bottles-v0", n_threads=n) for n in (1, 2)}
    task, rng = tasks[1], np.random.default_rng(0)
    context = task.sample_context(rng)
    noise = SmoothNoise(0.1).sample(rng, N_ROLLOUTS, task.trajectory_space.shape)
    trajectories = task.initial_trajectory(context) + noise
    rows = [
        ("Python step loop", lambda: python_loop(task, context, trajectories)),
        ("one by one, 1 thread", lambda: [task.simulate(context, t) for t in trajectories]),
        ("batched, 1 thread", lambda: task.simulate(context, trajectories)),
    ]
    if available_cores() > 1:
        rows.append(("batched, 2 threads", lambda: tasks[2].simulate(context, trajectories)))
    return [(name, rate(N_ROLLOUTS, work), "rollouts/s") for name, work in rows]


def task_rows() -> list[tuple[str, float, str]]:
    """Time every task's demonstrated trajectories in drawn contexts, on 1 and 2 threads."""
    rows = []
    for task_id in task_ids():
        rng = np.random.default_rng(0)
        task = make_task(task_id)
        contexts = np.stack([task.sample_context(rng) for _ in range(N_DEMONSTRATED)])
        shown = np.stack([task.demonstrate(context) for context in contexts])
        for n_threads in (1, 2):
            threaded = make_task(task_id, n_threads=n_threads)
            speed = rate(N_DEMONSTRATED, partial(threaded.simulate, contexts, shown))
            rows.append((f"{task_id}, threads: {n_threads}", speed, f"rollouts/s of {task_id}"))
    return rows


def training_rows() -> list[tuple[str, float, str]]:
    """Time the training of the network: name, rate and unit of each."""
    n_steps, rows = 200, []
    for batch, points in ((1, 1), (16, 20)):
        name = f"batch of {batch} x {points}"
        settings = RCNMPTraining(n_steps, batch, points)
        model = RCNMP("MlpPolicy", "nmp/Bottles-v0", seed=0).learn(20)
        model.training = settings
        steps = rate(n_steps, model._train)
        rows.append((name, steps, "training steps/s"))
        rows.append((name, steps * batch * points, "target points/s"))
    return rows


def missed(trajectories: np.ndarray) -> Generation:
    """Return rollouts of three costs: the norms of a trajectory at its start, middle and end.

    :param trajectories: shape (N, T, D)
    """
    moments = {"start": 0, "middle": trajectories.shape[1] // 2, "end": -1}
    terms = {
        name: -np.linalg.norm(trajectories[:, at], axis=1).astype(np.float64)
        for name, at in moments.items()
    }
    n = len(trajectories)
    rewards = np.sum(list(terms.values()), axis=0)
    contexts, sent = np.zeros((n, 2), np.float32), trajectories.astype(np.float32)
    return Generation(contexts, sent, rewards, np.zeros(n, bool), terms)


def critic_rows() -> list[tuple[str, float, str]]:
    """Time the critic while the rollouts of a search grow by a tenth: name, rate, unit of each."""
    rng, rows = np.random.default_rng(0), []
    along = noise_directions(np.tile(0.1 * np.eye(3), (300, 1, 1)), 5)
    for n in (50, 200, 600):
        search, n_asked = CriticSearch(Subspace(np.ones((300, 3)), along), radius=0.7), 0
        tried = search.space.trajectories(rng.standard_normal((n, search.space.size)))
        search.tell(missed(tried))
        begin = time.perf_counter()
        while n_asked < n / 10:
            search.tell(missed(search.ask(3, rng)))
            n_asked += 3
        speed = n_asked / (time.perf_counter() - begin)
        rows.append((f"critic of three costs after {n} rollouts", speed, "proposals/s"))
    return rows


def side_by_side_rows() -> list[tuple[str, float, str]]:
    """Time runs of RC-NMP one by one and side by side: name, rate and unit of each."""

    def run(seed: int) -> None:
        RCNMP("MlpPolicy", "nmp/Bottles-v0", seed=seed).learn(LENGTH)

    runs = [partial(run, seed) for seed in range(N_TOGETHER)]
    rows = []
    for name, work in (
        ("RC-NMP, runs one by one", lambda: [each() for each in runs]),
        (f"RC-NMP, {N_TOGETHER} runs side by side", lambda: together(runs)),
    ):
        begin = time.perf_counter()
        work()
        speed = N_TOGETHER * LENGTH / (time.perf_counter() - begin)
        rows.append((name, speed, "rollouts/s of learning"))
    return rows


def main() -> None:
    """Print the table."""
    th.set_num_threads(1)
    print("| what | rate | unit | ratio |\n|---|---|---|---|")
    for rows in (
        simulator_rows(),
        training_rows(),
        critic_rows(),
        side_by_side_rows(),
        task_rows(),
    ):
        first: dict[str, float] = {}
        for name, value, unit in rows:
            base = first.setdefault(unit, value)
            print(f"| {name} | {value:,.0f} | {unit} | {value / base:.2f} |")


if __name__ == "__main__":
    main()
