"""The marbles of `nmp/Pouring-v1`: the model with all of them, their rest, and where they end."""

from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmark_envs.executor import BatchExecutor
from benchmark_envs.rollouts import FloatArray

GRAINS = 150  # as many as the cup can hold with a third of its height to spare
GRAIN = 10.0  # g
RADIUS = 0.01  # m; of a grain
CUP, RECEIVER = np.array([0.0, 0.0, 0.225]), np.array([0.14, 0.0, 0.03])  # m; inner floors' centres
CUP_RADIUS, CUP_HEIGHT, WALL = 0.055, 0.15, 0.012  # m; of both cups, inside; of their walls
PITCH = 0.0205  # m; between the grains that are to settle
JITTER = 3e-4  # m; no grain balances on another
SETTLING = 3.0  # s; then no grain moves faster than 1 mm/s
RESETTLING = 1.5  # s; the same for what remains after the uppermost grains were taken away
PARKED = -100.0  # m; the height from which the grains that are not in play fall, out of sight
QUANTUM = 2.0**-20  # g; shares are whole multiples of it, see `shares`


def load_model() -> mujoco.MjModel:
    """Return the model of ``pouring.xml`` with `GRAINS` grains."""
    spec = mujoco.MjSpec.from_file(str(Path(__file__).with_name("pouring.xml")))
    default = spec.find_default("grain")
    for i in range(GRAINS):
        body = spec.worldbody.add_body(name=f"grain_{i}", pos=[0, 0, 0])
        for axis, direction in zip("xyz", np.eye(3), strict=True):
            body.add_joint(default, name=f"grain_{i}_{axis}", axis=direction)
        body.add_geom(default, name=f"grain_{i}")
    return spec.compile()


def first_grain(model: mujoco.MjModel) -> int:
    """Return where the grains' positions begin in ``qpos``; there they stand in order, x y z."""
    return int(model.joint("grain_0_x").qposadr[0])


def settle(executor: BatchExecutor) -> FloatArray:
    """Let all grains fall into the cup and come to rest, from a fixed loose arrangement.

    It takes 0.2 s of computation.

    :param executor: of the model
    :return: the grains' positions, the lowest first, shape (GRAINS, 3) in m
    """
    grid = np.arange(-2, 3) * PITCH
    layer = np.array([(x, y) for x in grid for y in grid])
    layer = layer[np.linalg.norm(layer, axis=1) <= CUP_RADIUS - RADIUS]
    level, place = np.divmod(np.arange(GRAINS), len(layer))
    loose = np.column_stack([layer[place], RADIUS + (level + 0.1) * PITCH])
    loose[:, :2] += np.random.default_rng(0).normal(0.0, JITTER, (GRAINS, 2))
    return _come_to_rest(executor, CUP + loose, SETTLING)


def settle_lowest(executor: BatchExecutor, settled: FloatArray, n: int) -> FloatArray:
    """Take the uppermost grains away and let the others come to rest again.

    :param executor: of the model
    :param settled: all grains, shape (GRAINS, 3) in m
    :param n: how many remain
    :return: their positions, shape (n, 3) in m
    """
    return _come_to_rest(executor, settled[:n], RESETTLING)


def _come_to_rest(executor: BatchExecutor, positions: FloatArray, seconds: float) -> FloatArray:
    """Hold the cup upright for a time; return the positions, the lowest first, (n, 3) in m."""
    time_points = round(seconds / executor.model.opt.timestep / executor.substeps)
    state = initial_state(executor, positions)
    end = executor.states(state, np.zeros((time_points * executor.substeps, 1)))[-1]
    rest = grain_positions(executor.model, end[None], len(positions))[0]
    return rest[np.argsort(rest[:, 2], kind="stable")]


def initial_state(executor: BatchExecutor, positions: FloatArray) -> FloatArray:
    """Return the full physics state with the cup upright and grains at rest, shape (nstate,).

    :param executor: of the model
    :param positions: of the grains in play, shape (n, 3) in m; the others are parked far below,
        one under the other, where they fall without touching anything
    """
    grains = np.zeros((GRAINS, 3))
    grains[:, 2] = PARKED - 3 * RADIUS * np.arange(GRAINS)
    grains[: len(positions)] = positions
    qpos = np.zeros(executor.model.nq)
    qpos[first_grain(executor.model) :] = grains.ravel()
    return executor.initial_state(qpos)


def grain_positions(model: mujoco.MjModel, states: FloatArray, n: int) -> FloatArray:
    """Return where the first n grains are, shape (N, n, 3) in m.

    :param model: of `load_model`
    :param states: full physics states, shape (N, nstate)
    :param n: grains
    """
    first = 1 + first_grain(model)  # after the time
    return states[:, first : first + 3 * n].reshape(len(states), n, 3)


def count_inside(positions: FloatArray, floor: FloatArray) -> NDArray[np.int_]:
    """Count the grains inside an upright cup, whose centres are over its floor and below its rim.

    :param positions: shape (N, n, 3) in m
    :param floor: the centre of the cup's inner floor, shape (3,) in m
    :return: shape (N,)
    """
    relative = positions - floor
    near = np.hypot(relative[..., 0], relative[..., 1]) < CUP_RADIUS
    return np.sum(near & (relative[..., 2] > 0) & (relative[..., 2] < CUP_HEIGHT), axis=1)


def shares(
    amounts: FloatArray, counts: NDArray[np.int_], poured: NDArray[np.int_], kept: NDArray[np.int_]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what was poured, kept and spilled, which add up to the amounts without rounding.

    Each of n grains counts as an n-th of the amount. The bounds between the three shares are
    rounded to multiples of `QUANTUM`, a millionth of a gram; then no sum or difference of them
    rounds.

    :param amounts: in the cup at first, shape (N,) in g
    :param counts: grains in play, shape (N,)
    :param poured: grains in the receiver, shape (N,)
    :param kept: grains in the cup, shape (N,)
    :return: each of shape (N,) in g
    """

    def bound(grains: NDArray[np.int_]) -> FloatArray:
        rounded = np.round(amounts * grains / counts / QUANTUM) * QUANTUM
        return np.where(grains == counts, amounts, rounded)

    first, second = bound(poured), bound(poured + kept)
    return first, second - first, amounts - second
