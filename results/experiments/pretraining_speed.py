"""How much sooner batches reach a validation error than the original code's batches of one.

``python -m results.experiments.pretraining_speed`` trains the same CNMP on 30 demonstrations of
``nmp/Aperture-v0`` twice in one run: as the original code does (Adam, learning rate 1e-4, one
trajectory, 1 to 5 conditioning points and one target point a step) for some minutes, and in
batches. It prints the time that each needs to the lowest validation error that the former reaches.
"""

import time
from collections.abc import Iterator

import numpy as np
import torch as th

import benchmark_envs  # noqa: F401 (registers the tasks)
from sb3_nmp import CNMPSettings, Demonstrations, PretrainingSettings
from sb3_nmp.common.cnmp import CNMP, PointSampler, negative_log_likelihood, pretrain

ARCHITECTURE = CNMPSettings(context_in_decoder=True)
SECONDS = 120.0  # of the original's training
LENGTHS = (50, 100, 200, 400, 800, 1600, 3200)  # of the training in batches, in steps
BATCHES_DRAWN = 100


def validation_error(cnmp: CNMP, unseen: Demonstrations) -> float:
    """Return the root mean square error of the answers, in m.

    :param cnmp: the network
    :param unseen: demonstrations that it was not trained on
    """
    return float(np.sqrt(np.mean((cnmp.trajectories(unseen.contexts) - unseen.trajectories) ** 2)))


def original(shown: Demonstrations, unseen: Demonstrations) -> Iterator[tuple[float, float]]:
    """Train as the original code; yield seconds so far and validation error every 100 steps.

    :param shown: to train on
    :param unseen: to validate on
    """
    th.manual_seed(0)
    cnmp = CNMP(shown.context_dim, shown.trajectory_shape, ARCHITECTURE)
    cnmp.set_scale(shown)
    optimizer = th.optim.Adam(cnmp.parameters(), 1e-4, fused=True)
    values = cnmp.normalise(cnmp.times.new_tensor(shown.trajectories))
    condition = cnmp.condition(cnmp.times.new_tensor(shown.contexts))
    settings = PretrainingSettings(batch_size=1, n_target_points=1)
    sampler = PointSampler(settings, cnmp.times, values, condition, np.random.default_rng(0))
    seconds = 0.0
    while True:
        begin = time.perf_counter()
        for batch in sampler.draw(BATCHES_DRAWN):
            optimizer.zero_grad()
            negative_log_likelihood(cnmp.network, batch).backward()
            optimizer.step()
        seconds += time.perf_counter() - begin
        yield seconds, validation_error(cnmp, unseen)


def batched(shown: Demonstrations, unseen: Demonstrations, wanted: float) -> tuple[float, int]:
    """Return the seconds and steps of the shortest training in batches that reaches an error.

    :param shown: to train on
    :param unseen: to validate on
    :param wanted: validation error in m
    """
    for n_steps in LENGTHS:
        th.manual_seed(0)
        cnmp = CNMP(shown.context_dim, shown.trajectory_shape, ARCHITECTURE)
        begin = time.perf_counter()
        pretrain(shown, PretrainingSettings(n_steps), np.random.default_rng(0), cnmp)
        seconds = time.perf_counter() - begin
        if validation_error(cnmp, unseen) <= wanted:
            return seconds, n_steps
    return float("inf"), LENGTHS[-1]


def main() -> None:
    """Print the two times and their ratio."""
    th.set_num_threads(1)
    shown, unseen = (Demonstrations.from_task("nmp/Aperture-v0", 30, seed) for seed in (0, 1))
    best = np.inf, np.inf
    for seconds, error in original(shown, unseen):
        best = min(best, (error, seconds))
        if seconds > SECONDS:
            break
    ours, n_steps = batched(shown, unseen, best[0])
    print(f"validation error {best[0]:.3f} m: {best[1]:.1f} s in batches of one, {ours:.2f} s in")
    print(f"{n_steps} steps of 30 x 30 points: {best[1] / ours:.0f} times sooner")


if __name__ == "__main__":
    main()
