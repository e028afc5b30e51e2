"""How much sooner small batches reach a validation error than the original code's batches of one.

``python -m results.experiments.pretraining_speed`` trains the same CNMP on 30 demonstrations of
``nmp/Aperture-v0`` in two ways, side by side in one run: as the original code does (Adam, learning
rate 1e-4; each step draws one trajectory, up to 5 conditioning points and one target point) for
some minutes, and as `pretrain` does by default. It prints a Markdown table of the time that each
needs to the lowest validation errors that the former has reached after some of its minutes.
"""

import time
from collections.abc import Iterator

import numpy as np
import torch as th
from torch import nn

import benchmark_envs  # noqa: F401 (registers the tasks)
from sb3_nmp import CNMPArchitecture, CNMPPretraining, Demonstrations
from sb3_nmp.models.cnmp import CNMP
from sb3_nmp.models.cnmp_training import PointSampler, negative_log_likelihood, pretrain

#: all is to learn, by the likelihood alone as in the original
ARCHITECTURE = CNMPArchitecture(fitted_trend=False, activation_fn=nn.ReLU, beta_nll=0.0)
SEEDS = range(2)
SECONDS = (60.0, 120.0, 240.0)  # of the original's training, after which it is compared
LENGTHS = (200, 300, 400, 600, 800, 1100, 1500, 2000, 2500, 3000)  # of ours, in steps
STEPS = 100  # of the original's training between two validations


def new_cnmp(shown: Demonstrations, seed: int) -> CNMP:
    """Return an untrained network.

    :param shown: demonstrations to be trained on
    :param seed: of its weights
    """
    th.manual_seed(seed)
    return CNMP(shown.context_dim, shown.trajectory_shape, ARCHITECTURE)


def validation_error(cnmp: CNMP, unseen: Demonstrations) -> float:
    """Return the root mean square error of the answers, in m.

    :param cnmp: the network
    :param unseen: demonstrations that it was not trained on
    """
    return float(np.sqrt(np.mean((cnmp.trajectories(unseen.contexts) - unseen.trajectories) ** 2)))


def original(
    shown: Demonstrations, unseen: Demonstrations, seed: int
) -> Iterator[tuple[float, float]]:
    """Train as the original code; yield seconds so far and validation error every 100 steps.

    :param shown: to train on
    :param unseen: to validate on
    :param seed: of weights and batches
    """
    cnmp = new_cnmp(shown, seed)
    cnmp.set_scale(shown)
    optimizer = th.optim.Adam(cnmp.parameters(), 1e-4)
    values = cnmp.normalise(cnmp.times.new_tensor(shown.trajectories))
    condition = cnmp.condition(cnmp.times.new_tensor(shown.contexts))
    settings = CNMPPretraining(batch_size=1, n_target_points=1)
    sampler = PointSampler(settings, cnmp.times, values, condition, np.random.default_rng(seed))
    seconds = 0.0
    while True:
        begin = time.perf_counter()
        for _ in range(STEPS):
            optimizer.zero_grad()
            negative_log_likelihood(cnmp.network, sampler.draw(1)[0]).backward()
            optimizer.step()
        seconds += time.perf_counter() - begin
        yield seconds, validation_error(cnmp, unseen)


def lowest_errors(
    shown: Demonstrations, unseen: Demonstrations, seed: int
) -> list[tuple[float, float]]:
    """Return the original's lowest error within each of `SECONDS`, and when it was reached.

    :param shown: to train on
    :param unseen: to validate on
    :param seed: of weights and batches
    :return: pairs of an error in m and seconds
    """
    lowest: list[tuple[float, float]] = []
    best = (np.inf, 0.0)
    for seconds, error in original(shown, unseen, seed):
        best = min(best, (error, seconds))
        if seconds >= SECONDS[len(lowest)]:
            lowest.append(best)
        if len(lowest) == len(SECONDS):
            break
    return lowest


def batched(shown: Demonstrations, unseen: Demonstrations, seed: int) -> list[tuple[float, float]]:
    """Train in batches for each of `LENGTHS`, each from scratch.

    :param shown: to train on
    :param unseen: to validate on
    :param seed: of weights and batches
    :return: pairs of an error in m and seconds
    """
    trained: list[tuple[float, float]] = []
    for n_steps in LENGTHS:
        cnmp = new_cnmp(shown, seed)
        begin = time.perf_counter()
        pretrain(shown, CNMPPretraining(n_steps), np.random.default_rng(seed), cnmp)
        seconds = time.perf_counter() - begin
        trained.append((validation_error(cnmp, unseen), seconds))
    return trained


def main() -> None:
    """Print the table: one row for each seed and each of `SECONDS`."""
    th.set_num_threads(1)
    shown, unseen = (Demonstrations.from_task("nmp/Aperture-v0", 30, seed) for seed in (0, 1))
    print("| seed | validation error [m] | batches of one [s] | default [s] | times sooner |")
    print("|--:|--:|--:|--:|--:|")
    for seed in SEEDS:
        lowest, trained = lowest_errors(shown, unseen, seed), batched(shown, unseen, seed)
        for error, theirs in lowest:
            ours = min((s for e, s in trained if e <= error), default=np.inf)
            row = f"| {seed} | {error:.3f} | {theirs:.1f} | {ours:.2f} | {theirs / ours:.0f} |"
            print(row, flush=True)


if __name__ == "__main__":
    main()
