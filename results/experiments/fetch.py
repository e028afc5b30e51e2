"""gymnasium-robotics' Fetch tasks: ours as trajectory bandits, SB3's SAC with HER and PPO stepwise.

``python -m results.experiments.fetch run FOLDER FetchReach-v4 RC-NMP 0 1 2 3 4`` runs one method on
one task for some seeds and writes a JSON file each, skipping those that are there. ``python -m
results.experiments.fetch draw FOLDER PICTURE.png`` draws their curves and prints a Markdown table.
Simulator steps are counted: a rollout is 50.
"""

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from stable_baselines3 import PPO, SAC, HerReplayBuffer

from baselines import BO, GA
from benchmark_envs import FetchExpert, fetch_env
from results.algorithms import TWINS
from sb3_nmp import ACNMP, RCNMP, Demonstrations

Array = NDArray[Any]
#: rollouts after which a method is evaluated, in the order of the runs
COUNTS: dict[tuple[str, str], tuple[int, ...]] = {
    ("FetchReach-v4", "RC-NMP"): (100, 200, 400, 1000),
    ("FetchReach-v4", "ACNMP"): (0, 200),
}
OTHERWISE = (0, 100, 200, 400, 600)
N_CONTEXTS, N_ON_THE_WAY, N_DEMONSTRATIONS, STEPS = 200, 50, 20, 50
#: what begins with demonstrations and explores near them; the third answers by linear regression
SHOWN = {
    "ACNMP, near": (ACNMP, {}),
    "RC-NMP, shown": (RCNMP, {}),
    "ridge in the loop, shown": (GA, {"policy_kwargs": {"regression": "ridge"}}),
}
#: how far these explore, in m: half the block's size
SHOWN_SCALE = 0.025
#: unseen goals are drawn with these seeds, demonstrated ones with the run's own
FIRST_TEST_SEED, FIRST_EXPERT_SEED = 500_000, 900_000


def unseen_contexts(task: str) -> list[Array]:
    """Return the unseen goals (and objects), the same for all, each of shape (C,).

    :param task: id of the Fetch task
    """
    env = fetch_env(task)
    return [env.reset(seed=FIRST_TEST_SEED + i)[0] for i in range(N_CONTEXTS)]


def successes(task: str, contexts: list[Array], answer: Callable[[Array], Array]) -> list[bool]:
    """Return in which contexts a bandit's greedy answer succeeds.

    :param task: id of the Fetch task
    :param contexts: each of shape (C,)
    :param answer: from a context to a trajectory
    """
    env, found = fetch_env(task), []
    for context in contexts:
        env.reset(options={"context": context})
        found.append(bool(env.step(answer(context))[4]["is_success"]))
    return found


def stepwise_successes(env: gym.Env[Any, Any], n: int, model: Any) -> list[bool]:  # noqa: ANN401
    """Return in which of the first n test seeds a step-based policy succeeds at the last step.

    :param env: the Fetch task itself
    :param n: how many
    :param model: of SB3
    """
    found = []
    for i in range(n):
        # the goals that `unseen_contexts` draws: a bandit resets to a seed drawn from its own
        seed = int(np.random.default_rng(FIRST_TEST_SEED + i).integers(2**31))
        observation, info = env.reset(seed=seed)
        for _ in range(STEPS):
            action, _ = model.predict(observation, deterministic=True)
            observation, *_, info = env.step(action)
        found.append(bool(info["is_success"]))
    return found


def bandit(task: str, method: str, seed: int) -> tuple[Any, Callable[[Array], Array]]:
    """Return one of our models, and its greedy answer.

    :param task: id of the Fetch task
    :param method: ``"RC-NMP"``, ``"ACNMP"``, one of `SHOWN` or of `TWINS`
    :param seed: of the run
    """
    env: Any = fetch_env(task)
    if method == "RC-NMP":
        model: Any = RCNMP("MlpPolicy", env, seed=seed)
    else:
        expert = FetchExpert(task)
        shown = Demonstrations.from_task(expert, N_DEMONSTRATIONS, seed=FIRST_EXPERT_SEED + seed)
        if method in SHOWN:
            kind, settings = SHOWN[method]
            settings = {"demonstrations": shown, "exploration_scale": SHOWN_SCALE, **settings}
            model = kind("MlpPolicy", env, seed=seed, **settings)
            model = model.pretrain() if isinstance(model, ACNMP) else model
        elif method == "ACNMP":
            model = ACNMP("MlpPolicy", env, demonstrations=shown, seed=seed).pretrain()
        else:
            answered = {"regression": TWINS[method]}
            model = BO("MlpPolicy", env, demonstrations=shown, seed=seed, policy_kwargs=answered)
    return model, lambda context: model.predict(context, deterministic=True)[0]


def stepwise(task: str, method: str, seed: int) -> tuple[Any, gym.Env[Any, Any]]:
    """Return a model of SB3 on the step-based task, and a task to evaluate it on.

    :param task: id of the Fetch task
    :param method: ``"SAC+HER"``, sparse rewards, or ``"PPO"``, dense ones
    :param seed: of the run
    """
    fetch_env(task)  # registers it
    if method == "PPO":
        env = gym.make(task, reward_type="dense")
        policy = "MultiInputPolicy"
        model = PPO(policy, env, n_steps=1000, batch_size=100, seed=seed, device="cpu")
        return model, gym.make(task)
    model = SAC(
        "MultiInputPolicy",
        gym.make(task),
        replay_buffer_class=HerReplayBuffer,
        learning_starts=10 * STEPS,
        train_freq=(1, "episode"),
        gradient_steps=STEPS,
        gamma=0.95,
        learning_rate=1e-3,
        batch_size=256,
        seed=seed,
        device="cpu",
    )
    return model, gym.make(task)


def run(task: str, method: str, seed: int) -> dict[str, Any]:
    """Run one method on one task; return its record.

    :param task: id of the Fetch task
    :param method: ``"RC-NMP"``, ``"ACNMP"``, one of `SHOWN` or of `TWINS`, ``"SAC+HER"`` or
        ``"PPO"``
    :param seed: of the run
    """
    begun, ours = time.time(), method in ("RC-NMP", "ACNMP", *SHOWN, *TWINS)
    # what a twin answers from the demonstrations is asked before any rollout
    counts = (0,) if method in TWINS else COUNTS.get((task, method), OTHERWISE)
    contexts, curve = unseen_contexts(task), []
    model, asked = (bandit if ours else stepwise)(task, method, seed)
    asked = cast(Any, asked)
    for count in counts:
        per_rollout = 1 if ours else STEPS
        budget = count * per_rollout - model.num_timesteps
        if budget > 0:
            model.learn(budget, reset_num_timesteps=False)
        if count == 0 and method in ("RC-NMP", *SHOWN) and not isinstance(model, ACNMP):
            continue  # it has seen nothing yet
        n = N_CONTEXTS if count == counts[-1] else N_ON_THE_WAY
        found = (
            successes(task, contexts[:n], asked) if ours else stepwise_successes(asked, n, model)
        )
        curve.append({"rollouts": count, "n_contexts": n, "solved": float(np.mean(found))})
    record = {"task": task, "method": method, "seed": seed, "curve": curve}
    return record | {"minutes": (time.time() - begun) / 60}


def run_all(folder: Path, task: str, method: str, seeds: list[int]) -> None:
    """Run some seeds, each into a file of its own; those that are there are left alone.

    :param folder: of the files
    :param task: id of the Fetch task
    :param method: its name
    :param seeds: of the runs
    """
    folder.mkdir(parents=True, exist_ok=True)
    for seed in seeds:
        path = folder / f"{task}_{method}_{seed}.json"
        if not path.exists():
            record = run(task, method, seed)
            path.write_text(json.dumps(record), encoding="utf-8")
            print(record, flush=True)


def main() -> None:
    """Run or draw, as the command line says."""
    command, folder, *rest = sys.argv[1:]
    if command == "run":
        run_all(Path(folder), rest[0], rest[1], [int(seed) for seed in rest[2:]])
    else:
        from results.experiments.fetch_figure import draw

        print(draw(Path(folder), Path(rest[0])))


if __name__ == "__main__":
    main()
