"""The runs of thesis 5.2.3, one for each way to a trajectory of the 4-DoF arm, and seed."""

import time
from dataclasses import dataclass, replace
from typing import Any, Literal

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback

from baselines import MomentRegression
from results.exceptions import BenchmarkError
from results.transfer.skills import BUTTON, SOURCE, TARGET, button, proxy_contexts, shown
from sb3_nmp import (
    ACNMP,
    CNMPArchitecture,
    CNMPPretraining,
    Demonstrations,
    SkillTransfer,
    TransferTraining,
)

FloatArray = NDArray[np.float64]
#: how the 4-DoF arm comes to its first trajectory: by Eq. 5.4, of skills or of moments, by one of
#: the twins, or not at all
Way = Literal["translated", "moments", "regression", "nearest", "scratch"]

ARCHITECTURE = replace(CNMPArchitecture.preset("latent"), encoder_arch=(64,), decoder_arch=(64,))
TRAINING = TransferTraining(n_steps=1500)
MOMENTS = replace(CNMPArchitecture.preset("moment"), encoder_arch=(64,), decoder_arch=(64,))
MOMENT_TRAINING = TransferTraining.preset("moment")
WINDOW = 100  # time points by which the warping may shift
PRETRAINING = CNMPPretraining(n_steps=300)  # on a single trajectory


@dataclass(frozen=True)
class TransferRun:
    """One seed of one way.

    :param way: to the first trajectory
    :param seed: of proxies, networks and search
    :param budget: rollouts of the refinement
    :param population_size: rollouts of an update
    """

    way: Way
    seed: int
    budget: int = 60
    population_size: int = 2


class Remembering(gym.Wrapper):
    """Remembers of each rollout its reward, and whether it touched a cube and succeeded."""

    def __init__(self, env: gym.Env) -> None:
        super().__init__(env)
        self.rollouts: list[tuple[float, bool, bool]] = []

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:  # noqa: ANN401
        """Execute a trajectory; see Gymnasium.

        :param action: the trajectory
        """
        result = self.env.step(action)
        info = result[4]
        entry = float(result[1]), bool(info.get("touched", False)), bool(info["is_success"])
        self.rollouts.append(entry)
        return result


class UntilSolved(BaseCallback):
    """Ends a run once a rollout has solved the task.

    :param env: that remembers its rollouts
    """

    def __init__(self, env: Remembering) -> None:
        super().__init__()
        self.env = env

    def _on_step(self) -> bool:
        return not any(solved for *_, solved in self.env.rollouts)


def first_trajectory(way: Way, seed: int) -> tuple[FloatArray, dict[str, Any]]:
    """Return the trajectory from which the 4-DoF arm starts, shape (T, 4), and what was measured.

    :param way: to it
    :param seed: of proxies and networks
    """
    task, context, expert = button(TARGET)
    if way == "scratch":
        return task.initial_trajectory(context), {}
    contexts = proxy_contexts(seed)
    source, target = shown(SOURCE, contexts), shown(TARGET, contexts)
    demonstrated, more = button(SOURCE)[2], {}
    if way == "translated":
        model = SkillTransfer(
            source, target, architecture=ARCHITECTURE, training=TRAINING, seed=seed
        ).fit()
        answer = model.translate(demonstrated)
    elif way == "moments":
        answer = by_moments(source, target, seed).translate(demonstrated)
    elif way == "regression":
        answer = MomentRegression(source, target).fit().translate(demonstrated)
    else:
        answer = target.trajectories[nearest_skill(demonstrated, source.trajectories)]
    more["rmse"] = np.sqrt(np.mean((answer - expert) ** 2, axis=0)).tolist()
    return answer, more | {"answer": answer.round(4).tolist(), "expert": expert.round(4).tolist()}


def by_moments(source: Demonstrations, target: Demonstrations, seed: int) -> SkillTransfer:
    """Return a trained transfer whose latent space is of moments.

    :param source: proxy skills of the robot that shows
    :param target: those of the robot that is told
    :param seed: of first weights and batches
    """
    return SkillTransfer(
        source,
        target,
        architecture=MOMENTS,
        training=MOMENT_TRAINING,
        seed=seed,
        shared="moment",
    ).fit()


def nearest_skill(demonstrated: FloatArray, proxies: FloatArray) -> int:
    """Return the row of the proxy that is nearest by dynamic time warping.

    :param demonstrated: shape (T, D)
    :param proxies: shape (N, T, D)
    :raises BenchmarkError: the library is not installed
    """
    try:
        from dtaidistance import dtw_ndim
    except ImportError as error:
        raise BenchmarkError(
            "the nearest proxy skill is found by dtaidistance, which is not installed; install it "
            "with 'pip install sb3-nmp[contrib]'."
        ) from error
    # the library takes no read-only arrays
    wanted, each = np.array(demonstrated), [np.array(proxy) for proxy in proxies]
    distances = [dtw_ndim.distance(wanted, proxy, window=WINDOW, use_c=True) for proxy in each]
    return int(np.argmin(distances))


def measure(run: TransferRun) -> dict[str, Any]:
    """Do a run and return what was measured, as JSON values.

    :param run: which
    """
    start = time.perf_counter()
    answer, more = first_trajectory(run.way, run.seed)
    task, context, _ = button(TARGET)
    tried = task.simulate(context, answer)
    env = Remembering(gym.make(BUTTON, context=context, arm=TARGET))
    only = Demonstrations(context[None], answer[None])
    model = refine(env, only, run.seed, run.budget, run.population_size)
    rewards, touched, _ = (list(column) for column in zip(*env.rollouts, strict=True))
    return more | {
        "zero_shot": {
            "error": -float(tried.rewards[0]),
            "touched": bool(tried.outcomes["touched"][0]),
            "solved": bool(tried.successes[0]),
        },
        "errors": [-round(reward, 5) for reward in rewards],
        "first_touch": _first(touched),
        "first_solved": first_success(env),
        "rollouts": model.num_timesteps,
        "seconds": round(time.perf_counter() - start, 1),
    }


def refine(
    env: Remembering, shown: Demonstrations, seed: int, budget: int, population_size: int
) -> ACNMP:
    """Let ACNMP refine a trajectory until a rollout has solved the task.

    :param env: that remembers its rollouts
    :param shown: the trajectory, as the only demonstration
    :param seed: of the search
    :param budget: rollouts
    :param population_size: rollouts of an update
    """
    return ACNMP(
        "MlpPolicy",
        env,
        demonstrations=shown,
        population_size=population_size,
        pretraining=PRETRAINING,
        seed=seed,
    ).learn(budget, UntilSolved(env))


def first_success(env: Remembering) -> int | None:
    """Return the number of the first rollout that solved the task, from 1 on; None: none did.

    :param env: that remembers its rollouts
    """
    return _first([solved for *_, solved in env.rollouts])


def _first(flags: list[bool]) -> int | None:
    """Return the number of the first rollout of which something is true, from 1 on."""
    return flags.index(True) + 1 if any(flags) else None
